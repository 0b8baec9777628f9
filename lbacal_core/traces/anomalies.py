"""Events with anomalous power, and why: thunderstorms, failing receivers, saturation (section 3.1 of the paper).

Each path's band power is compared with its own median after the sky's daily variation, common to a station's dipoles of
one polarisation, has been taken out. The residual scatters by about 5 % (gain from event to event); an event or path
that is off by more than `CUT_SIGMA` robust standard deviations, and by at least a fifth, is left out.
"""

from __future__ import annotations

import numpy as np
from astropy.stats import mad_std
from numpy.typing import NDArray

from lbacal_core.grids import Floats
from lbacal_core.sidereal import local_sidereal_time
from lbacal_core.spectra import Spectra
from lbacal_core.spectra_blocks import SpectraBlock, split_into_blocks

CUT_SIGMA = 6.0
SMALLEST_DEPARTURE = np.log(1.2)
FEWEST_EVENTS = 20
"""With fewer events a path's usual power is not known, and nothing is cut."""

_HARMONICS = 3
_ROUNDS = 5


def find_anomalous_spectra(spectra: Spectra, longitude_deg: float) -> dict[tuple[str, str, int, str], str]:
    """Find spectra whose power is anomalous: (event_id, station, antenna, dipole) to the reason."""
    reasons: dict[tuple[str, str, int, str], str] = {}
    for block in split_into_blocks(spectra):
        if block.power.shape[1] < FEWEST_EVENTS:
            continue
        departure = power_departure(block, longitude_deg)
        of_event = np.nanmedian(departure, axis=0)
        of_path = departure - of_event
        for values, words in ((of_event[None, :], "the station's"), (of_path, "this path's")):
            spread = float(mad_std(values, ignore_nan=True))
            is_off = np.abs(np.nan_to_num(values)) > max(CUT_SIGMA * spread, SMALLEST_DEPARTURE)
            for antenna, event in zip(*np.nonzero(np.broadcast_to(is_off, departure.shape)), strict=True):
                if block.is_present[antenna, event]:
                    factor = float(np.exp(np.broadcast_to(values, departure.shape)[antenna, event]))
                    key = (str(block.event_id[event]), block.station, int(block.antennas[antenna]), block.dipole)
                    reasons.setdefault(key, f"anomalous power: {words} is {factor:.2f} times the usual")
    return reasons


def power_departure(block: SpectraBlock, longitude_deg: float) -> Floats:
    """Logarithm of band power over the path's median and the station's daily variation, shape (antenna, event)."""
    level = np.where(block.is_present, np.log(np.median(block.power, axis=2)), np.nan)
    level = level - np.nanmedian(level, axis=1)[:, None]
    common = np.nanmedian(level, axis=0)
    angle = 2 * np.pi * local_sidereal_time(block.time_unix, longitude_deg) / 24.0
    order = np.arange(1, _HARMONICS + 1)
    design = np.hstack([np.ones((angle.size, 1)), np.cos(angle[:, None] * order), np.sin(angle[:, None] * order)])
    return np.asarray(level - design @ _robust_fit(design, common))


def _robust_fit(design: Floats, values: Floats) -> Floats:
    """Least squares with outliers taken away: Tukey's biweight at 4.685 robust sigma, starting from the median."""
    solution: Floats = np.zeros(design.shape[1])
    solution[0] = np.median(values)
    for round_number in range(_ROUNDS):
        residual = values - design @ solution
        scale = max(float(mad_std(residual)), 1e-6)
        reach = (4.685 if round_number else 9.0) * scale
        weight: NDArray[np.float64] = np.clip(1.0 - (residual / reach) ** 2, 0.0, None)
        solution = np.asarray(np.linalg.lstsq(design * weight[:, None], values * weight, rcond=None)[0], dtype=float)
    return np.asarray(solution)
