"""How far two calibration curves differ, channel by channel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lbacal_core.curves import CalibrationCurve
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats, require_same_grid


@dataclass(frozen=True)
class CurveChange:
    """Change of C from one curve to another, shape (freq,): as a fraction, and in standard deviations of both."""

    frequency_mhz: Floats
    fraction: Floats
    sigma: Floats

    @property
    def max_fraction(self) -> float:
        """The largest change of any channel, as a fraction."""
        return float(np.max(np.abs(self.fraction)))

    @property
    def max_sigma(self) -> float:
        """The largest change of any channel, in standard deviations."""
        return float(np.max(np.abs(self.sigma)))


def compare_curves(before: CalibrationCurve, after: CalibrationCurve) -> CurveChange:
    """Compare two converged curves on the same channels; their errors count as independent."""
    if before.c is None or after.c is None or before.c_sigma_stat is None or after.c_sigma_stat is None:
        raise BadInputError("calibrations", "two converged curves", f"{before.status} and {after.status}")
    require_same_grid(after.name, after.frequency_mhz, before.frequency_mhz, before.name)
    sigma = np.hypot(before.c_sigma_stat, after.c_sigma_stat)
    return CurveChange(before.frequency_mhz, after.c / before.c - 1.0, (after.c - before.c) / sigma)
