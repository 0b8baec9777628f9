"""Events with anomalous power, and why: thunderstorms, failing receivers, saturation (section 3.1 of the paper).

Each path's band power is compared with its own median after the sky's daily variation, common to a station's dipoles of
one polarisation, has been taken out. The residual scatters by about 5 % (gain from event to event); an event or path
that is off by more than `CUT_SIGMA` robust standard deviations, and by at least a fifth, is left out.
"""

from __future__ import annotations

import numpy as np

from lbacal_core.grids import Floats
from lbacal_core.screening import CUT_SIGMA, FEWEST_EVENTS, SMALLEST_DEPARTURE, predict_daily_variation, robust_sigma
from lbacal_core.spectra import Spectra
from lbacal_core.spectra_blocks import SpectraBlock, split_into_blocks


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
            spread = float(robust_sigma(values.reshape(1, -1))[0])
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
    everywhere = np.ones((1, common.size), dtype=bool)
    return np.asarray(level - predict_daily_variation(common[None], block.time_unix, everywhere, longitude_deg))
