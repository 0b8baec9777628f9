"""Frequency grids, the check that two inputs share one, and units of time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lbacal_core.errors import BadInputError

Floats = NDArray[np.float64]

GRID_TOLERANCE_MHZ = 1e-6
"""Two channels are the same when they differ by less than 1 Hz."""
JULIAN_DATE_OF_1970 = 2_440_587.5
"""Julian date at which Unix time begins (1970-01-01 00:00 UTC)."""
DAY_S = 86_400.0
YEAR_S = 365.25 * DAY_S
"""Julian year, s."""
WITHIN_1_SIGMA = (15.87, 84.13)
"""Percentiles between which a normal amount lies within one standard deviation."""


def require_same_grid(place: str, frequency_mhz: Floats, expected_mhz: Floats, expected_from: str) -> None:
    """Refuse channels that differ by more than 1 Hz from those of another input.

    Parameters
    ----------
    place
        What `frequency_mhz` belongs to, for the message.
    frequency_mhz, expected_mhz
        Shape (freq,), MHz.
    expected_from
        What `expected_mhz` belongs to, for the message.
    """
    if frequency_mhz.shape != expected_mhz.shape:
        expected = f"the {expected_mhz.size} channels of {expected_from}"
        found = find_channels(frequency_mhz, expected_mhz)
        without = "" if found is None else f", without {name_channels(expected_mhz[~found])}"
        raise BadInputError(f"{place}: frequency_mhz", expected, f"{frequency_mhz.size} channels{without}")
    off = np.flatnonzero(~(np.abs(frequency_mhz - expected_mhz) <= GRID_TOLERANCE_MHZ))  # NaN is off too
    if off.size:
        k = int(off[0])
        raise BadInputError(
            f"{place}: frequency_mhz, channel {k}",
            f"{expected_mhz[k]:.10g} MHz as in {expected_from}",
            f"{frequency_mhz[k]:.10g} MHz",
        )


def find_channels(frequency_mhz: Floats, expected_mhz: Floats) -> NDArray[np.bool_] | None:
    """Which of the expected channels another input has, shape (expected,); None where it has others, or none of them.

    Parameters
    ----------
    frequency_mhz, expected_mhz
        Rising, MHz.
    """
    near = np.abs(frequency_mhz[:, None] - expected_mhz) <= GRID_TOLERANCE_MHZ
    return np.asarray(near.any(axis=0)) if near.size and near.any(axis=1).all() else None


def name_channels(frequency_mhz: Floats) -> str:
    """Channels in words: ``40, 41 MHz``."""
    more = f" and {frequency_mhz.size - CHANNELS_NAMED} more" if frequency_mhz.size > CHANNELS_NAMED else ""
    return f"{', '.join(f'{one:.10g}' for one in frequency_mhz[:CHANNELS_NAMED])} MHz{more}"


CHANNELS_NAMED = 10
LOWEST_MHZ, HIGHEST_MHZ = 1.0, 1e5
"""Nobody receives the Galaxy at 100 GHz, or below 1 MHz alone: other numbers are Hz or GHz."""
HIGHEST_GALAXY_MHZ = 1e4
"""Channels of an instrument lie below, those of a table of network analysers need not: from 10 MHz on kHz lie above."""


def require_channels(place: str, frequency_mhz: Floats, highest_mhz: float = HIGHEST_MHZ) -> None:
    """Refuse a frequency axis that is empty, not finite, not positive, not rising or in another unit than MHz."""
    if frequency_mhz.ndim != 1 or frequency_mhz.size == 0:
        raise BadInputError(f"{place}: frequency_mhz", "a list of channels", f"shape {frequency_mhz.shape}")
    bad = np.flatnonzero(~(np.isfinite(frequency_mhz) & (frequency_mhz > 0)))
    if bad.size:
        raise BadInputError(f"{place}: frequency_mhz, channel {bad[0]}", "finite MHz > 0", f"{frequency_mhz[bad[0]]:g}")
    if not LOWEST_MHZ <= frequency_mhz[-1] <= highest_mhz:
        unit = "GHz" if frequency_mhz[-1] < LOWEST_MHZ else "Hz" if frequency_mhz[-1] >= 1e6 * LOWEST_MHZ else "kHz"
        raise BadInputError(f"{place}: frequency_mhz", "MHz", f"{frequency_mhz[-1]:g}, which looks like {unit}")
    if np.any(np.diff(frequency_mhz) <= 0):
        k = int(np.flatnonzero(np.diff(frequency_mhz) <= 0)[0])
        raise BadInputError(
            f"{place}: frequency_mhz, channel {k + 1}",
            f"more than {frequency_mhz[k]:g} MHz (channels rise)",
            f"{frequency_mhz[k + 1]:g} MHz",
        )


def guess_widths(frequency_mhz: Floats) -> Floats:
    """Widths of channels of which only the centres are known, shape (freq,), MHz: the distance to the nearer one.

    On the 1 MHz grid of the paper that is 1 MHz; so it is for a single channel.
    """
    if frequency_mhz.size == 1:
        return np.ones(1)
    spacing = np.diff(frequency_mhz)
    return np.asarray(np.minimum(np.append(spacing, np.inf), np.insert(spacing, 0, np.inf)))


def interpolate(nu: Floats, values: Floats, frequency_mhz: Floats, place: str) -> Floats:
    """Values of a table on the channels, shape (freq,), which it must cover, linear between its rows."""
    require_channels(place, nu)
    if nu.shape != values.shape:
        raise BadInputError(place, f"a value for each of {nu.size} frequencies", f"{values.size}")
    if nu[0] > frequency_mhz[0] or nu[-1] < frequency_mhz[-1]:
        expected = f"a table from {frequency_mhz[0]:g} to {frequency_mhz[-1]:g} MHz"
        raise BadInputError(place, expected, f"{nu[0]:g} to {nu[-1]:g} MHz")
    return np.interp(frequency_mhz, nu, values)
