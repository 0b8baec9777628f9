"""Carry a curve through the cable that a path has, with the error of the conversion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lbacal_core.curves import OK, UNCERTAIN, CalibrationCurve
from lbacal_core.grids import Floats
from lbacal_core.reference_chain import ReferenceChain


@dataclass(frozen=True)
class ToldCurve:
    """A curve as a path is told it.

    Attributes
    ----------
    curve
        Named after the path; C and its errors are those of its own cable.
    factor
        C told over C stored, shape (freq,).
    cable
        The path's cable at the instant asked for; None where it is not known.
    flag, reason
        ``ok``, or ``uncertain`` and why.
    """

    curve: CalibrationCurve
    factor: Floats
    cable: str | None
    flag: str
    reason: str | None


def carry_to_path(
    curve: CalibrationCurve,
    chain: ReferenceChain | None,
    station: str,
    antenna: int,
    dipole: str,
    time_unix: float,
) -> ToldCurve:
    """Carry a curve through the cable that a path has at an instant: C_path = C (L_ref / L_path)^1/2.

    Half the root mean square departure of A g among paths with that cable, as a fraction of C, is added to
    `c_sigma_sys` if it was measured. Otherwise `c_sigma_sys` is unknown, and the flag is ``uncertain``. A path's own
    curve is unchanged as long as its cable is.

    Parameters
    ----------
    chain
        What the curve belongs to; None where that is not known.
    time_unix
        When the data to be calibrated were taken, s UTC: cables change.
    """
    path = f"{station} antenna {antenna} {dipole}"
    is_own = curve.antenna is not None
    named = replace(curve, station=station, antenna=antenna, dipole=dipole)
    ones = np.ones_like(curve.frequency_mhz)
    if chain is None:
        reason = None if is_own else "the cables behind this curve are not known: it is that of a mean of paths"
        return ToldCurve(named, ones, None, OK if is_own else UNCERTAIN, reason)
    cable = chain.cables.cable_of(station, antenna, time_unix)
    if cable is None:
        when = np.datetime64(round(time_unix), "s").astype("datetime64[D]")
        return ToldCurve(named, ones, None, UNCERTAIN, f"no cable of {path} is on record at {when}")
    if is_own and np.array_equal(chain.cables.cables[cable], chain.mean_loss):
        return ToldCurve(named, ones, cable, OK, None)
    factor = np.sqrt(chain.mean_loss / chain.cables.cables[cable])
    variance, reason = _departure(chain, station, cable, is_own=is_own)
    told = _scaled(named, factor, variance)
    reasons = [text for text in (reason, chain.doubt) if text]
    return ToldCurve(told, factor, cable, UNCERTAIN if reasons else OK, "; ".join(reasons) or None)


def tell_reference(curve: CalibrationCurve) -> ToldCurve:
    """A curve as that of its reference chain, which is nobody's cable."""
    return ToldCurve(curve, np.ones_like(curve.frequency_mhz), None, OK, None)


def _departure(chain: ReferenceChain, station: str, cable: str, *, is_own: bool) -> tuple[Floats | None, str | None]:
    """Mean square departure of A g that a path may have, shape (freq,), and what is doubtful about it."""
    if is_own:
        return None, f"fitted with another cable than the {cable} that the path has then"
    has_station = station in chain.stations
    missing = None if has_station else f"there are no data of {station}: this is the mean of other stations"
    if chain.spreads is None:
        unknown = "how far single paths depart from their mean is not known: too few were fitted by themselves"
        return None, f"{missing}; {unknown}" if missing else unknown
    variance = chain.spreads.variance_of(cable, has_station=has_station)
    if variance is None:
        return None, f"{missing}, and how far stations differ is not known from one"
    return variance, missing


def _scaled(curve: CalibrationCurve, factor: Floats, variance: Floats | None) -> CalibrationCurve:
    if curve.c is None or curve.c_sigma_stat is None:
        return curve
    c, sigma, covariance = curve.c * factor, None, None
    if variance is not None:
        departure = np.sqrt(variance) / 2.0
        known = np.zeros_like(c) if curve.c_sigma_sys is None else curve.c_sigma_sys / curve.c
        sigma = c * np.hypot(known, departure)
        covariance = None if curve.covariance is None else curve.covariance.with_own(departure)
    return replace(curve, c=c, c_sigma_stat=curve.c_sigma_stat * factor, c_sigma_sys=sigma, covariance=covariance)
