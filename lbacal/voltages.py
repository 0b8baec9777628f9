"""A trace in volts with what `lbacal.effective` answered."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from lbacal_core.curves.covariance import Budget, parse_budget, parse_covariance
from lbacal_core.curves.curves import CONVERGED, CalibrationCurve
from lbacal_core.curves.galcal import name_path
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats, require_channels

if TYPE_CHECKING:
    from astropy.table import QTable

    from lbacal_core.traces.voltage import CalibratedTrace


def calibrate_trace(samples: Any, sample_rate_mhz: Any, effective: QTable) -> CalibratedTrace:
    """Apply the calibration in effect to a trace: volts at the antenna, with errors, and flags outside the band.

    Parameters
    ----------
    samples
        Shape (sample,), ADC units (numbers, or a Quantity in adu or without a unit), cleaned of interference.
    sample_rate_mhz
        200 for LOFAR; MHz or a Quantity.
    effective
        The answer of `lbacal.effective` for the one path that recorded the trace.
    """
    from astropy import units as u

    from lbacal.units import convert_number
    from lbacal_core.traces.voltage import calibrate_trace as calibrate

    curve = curve_of(effective)
    unit = getattr(samples, "unit", None)
    if unit not in (None, u.adu, u.dimensionless_unscaled):
        raise BadInputError("samples", "ADC units: adu, or numbers without a unit", f"a Quantity in {unit}")
    values, rate_mhz = getattr(samples, "value", samples), convert_number(sample_rate_mhz, u.MHz, "sample_rate_mhz")
    return calibrate(values, rate_mhz, curve, budget_of(effective, curve))


def budget_of(effective: QTable, curve: CalibrationCurve) -> Budget | None:
    """The systematic terms that the curve's covariance names, from the meta of its table; None where it names none."""
    named = None if curve.covariance is None else effective.meta.get("budgets", {}).get(curve.covariance.budget)
    return None if named is None else parse_budget(named)


def curve_of(effective: QTable) -> CalibrationCurve:
    """The curve in the rows of one path."""
    if not hasattr(effective, "colnames"):
        expected = 'the table of lbacal.effective, or one curve of a fit such as found["CS002", 17, "X"]'
        raise BadInputError("effective", expected, type(effective).__name__)
    paths = {(str(row["station"]), int(row["antenna"]), str(row["dipole"])) for row in effective}
    if len(paths) != 1:
        raise BadInputError(
            "effective", "the rows of one path: name station, antenna and dipole", f"{len(paths)} paths"
        )
    ((station, antenna, dipole),) = paths

    def column(name: str) -> Floats | None:
        values = np.asarray(effective[name].to_value("V"), dtype=float)
        return values if np.any(np.isfinite(values)) else None

    covariance = effective.meta.get("covariances", {}).get(name_path(effective[0]))
    c = column("c")
    if c is None:
        raise BadInputError("effective", "a C in some channel", "none")
    known = None if covariance is None else parse_covariance(covariance)
    if known is not None and known.diagonal.size != len(effective):
        expected = f"all {known.diagonal.size} channels of the curve, as its covariance has them"
        raise BadInputError("effective", expected, f"{len(effective)} rows (mean(low, high) takes a part of them)")
    return CalibrationCurve(
        station=station or None,
        antenna=None if antenna < 0 else antenna,
        dipole=dipole or None,
        status=CONVERGED,
        events=0,
        frequency_mhz=np.asarray(effective["frequency_mhz"].to_value("MHz"), dtype=float),
        c=c,
        c_sigma_stat=column("c_sigma_stat"),
        c_sigma_sys=column("c_sigma_sys"),
        chi2_per_dof=None,
        lst_coverage=0.0,
        parameters={},
        flag=tuple(str(flag) for flag in effective["flag"]),
        covariance=known,
    )


# C belongs to the antenna gain that it was fitted with: carry it to another.


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
        Channels and |H_zenith|^2 = |J_theta|^2 + |J_phi|^2 of the antenna table at zenith, shape (freq,), MHz and
        m^2 or Quantities; every channel of `table` must be among them.

    Returns
    -------
    A copy; `c_over_h` is as it was, `antenna_gain` the one given.

    Raises
    ------
    BadInputError
        Where the table does not say with which G_ant it was made, or a channel is missing: such a C is not to be used
        with another antenna.
    """
    from astropy import units as u

    from lbacal.units import convert_numbers

    channels, gains = convert_numbers(frequency_mhz, u.MHz), convert_numbers(antenna_gain, u.m**2)
    require_channels("carry_to_antenna", np.sort(channels))
    if gains.shape != channels.shape:
        raise BadInputError("antenna_gain", f"a number for each of {channels.size} frequencies", f"{gains.size}")
    wrong = ~(np.isfinite(gains) & (gains > 0))
    if np.any(wrong):
        raise BadInputError("antenna_gain", "finite m^2 > 0", f"{gains[wrong][0]:g} at {channels[wrong][0]:g} MHz")
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
