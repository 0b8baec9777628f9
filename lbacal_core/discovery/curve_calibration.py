"""What causes found in an LST curve do to C: the chain fitted to a station-year of data that contain them.

At one channel recorded power is a line in P_sky, but the intercepts of all channels are tied by three noise levels. A
wrong sky makes the channels disagree, and the change of C depends on how the fit weighs them: it is quoted for the mean
of a station's 48 antennas in a year of 900 events. A single path, whose radiometer noise is larger, changes by more.
"""

from __future__ import annotations

import numpy as np

from lbacal_core.calibration.lines import fit_lines
from lbacal_core.calibration.separable import solve_separable
from lbacal_core.grids import Floats
from lbacal_core.intercepts import Intercepts

RADIOMETER, EVENT_GAIN = 0.044 / 48**0.5, 0.03
"""Noise per MHz of the mean of a station's paths, and the event gain that they share (docs/explanation/the-fit.md)."""
DRAWS = 14
"""Pairs of events at each of 32 LSTs: 896 events. The two of a pair scatter oppositely, so that the slopes do not."""


def fit_station_year(power: Floats, sky: Floats, terms: Intercepts) -> Floats:
    """Slopes of the chain of each dipole, shape (dipole, freq), fitted to power with the scatter of a station-year.

    Parameters
    ----------
    power, sky
        Recorded power without scatter and P_sky of the simulation, shape (dipole, lst, freq).
    terms
        The noise constants of the chain.
    """
    rng = np.random.default_rng(0)
    half = DRAWS * power.shape[1]
    drawn = EVENT_GAIN * rng.standard_normal((half, 1)) + RADIOMETER * rng.standard_normal((half, power.shape[2]))
    scatter = 1.0 + np.concatenate([drawn, -drawn])
    lst = np.arange(2 * half) % power.shape[1]
    slopes = []
    for own, simulated in zip(power, sky, strict=True):
        lines = fit_lines((own[lst] * scatter)[None], simulated[lst], np.ones((1, lst.size)))
        slopes.append(solve_separable(lines.slope, lines.intercept, lines.information, terms).x[0])
    return np.stack(slopes)
