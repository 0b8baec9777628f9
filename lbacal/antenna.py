"""C belongs to the antenna gain that it was fitted with: carry it to another."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from lbacal_core.errors import BadInputError

if TYPE_CHECKING:
    from astropy.table import QTable

SAME_CHANNEL_MHZ = 1e-6


def carry_to_antenna(table: QTable, frequency_mhz: Any, antenna_gain: Any) -> QTable:
    """C for fields that are unfolded with another antenna table: C sqrt(G_ant' / G_ant), errors alike.

    A field is E = C ADC / H. With C of one antenna table and H of another it is off by the root of the ratio of their
    gains; C/|H| is not, because the fit determines C^2 / G_ant (eq. cal_equation).

    Parameters
    ----------
    table
        From `lbacal.effective`, or the calibration table of `lbacal fit`.
    frequency_mhz, antenna_gain
        Channels and |H_zenith|^2 = |J_theta|^2 + |J_phi|^2 of the antenna table at zenith, m^2, shape (freq,); every
        channel of `table` must be among them.

    Returns
    -------
    A copy; `c_over_h` is as it was, `antenna_gain` the one given.

    Raises
    ------
    BadInputError
        Where the table does not say with which G_ant it was made, or a channel is missing: such a C is not to be used
        with another antenna.
    """
    channels, gains = np.asarray(frequency_mhz, dtype=float), np.asarray(antenna_gain, dtype=float)
    if channels.ndim != 1 or gains.shape != channels.shape or not (np.all(np.isfinite(gains)) and np.all(gains > 0)):
        raise BadInputError("antenna_gain", "a finite number > 0 for each frequency", f"shape {gains.shape}")
    own = _values(table, "antenna_gain")
    if own is None or not np.all(np.isfinite(own)):
        found = "versions made before it was kept: refit them" if own is not None else "no such column"
        raise BadInputError("table: antenna_gain", "the G_ant that C was made with", found)
    wanted = _values(table, "frequency_mhz")
    order = np.argsort(channels)
    at = np.clip(np.searchsorted(channels[order], wanted - SAME_CHANNEL_MHZ), 0, channels.size - 1)
    nearest = order[at]
    missing = np.abs(channels[nearest] - wanted) > SAME_CHANNEL_MHZ
    if np.any(missing):
        raise BadInputError("frequency_mhz", "every channel of the table", f"none at {wanted[missing][0]:g} MHz")
    factor = np.sqrt(gains[nearest] / own)
    carried = table.copy()
    for name in ("c", "c_sigma_stat", "c_sigma_sys"):
        carried[name] = table[name] * factor
    carried["antenna_gain"] = gains[nearest] * (getattr(table["antenna_gain"], "unit", None) or 1.0)
    return carried


def _values(table: QTable, name: str) -> Any:
    """The plain numbers of a column, or None where there is none."""
    return np.asarray(getattr(table[name], "value", table[name]), dtype=float) if name in table.colnames else None
