"""How far single paths depart from their reference chain, measured on paths that were fitted by themselves.

Departure of a path: d_p = (s_p / s_ref) (L_ref / L_p) - 1, the power gain A g of the path over that of the reference
chain, less 1. Slopes have errors, so what scatters is d_p plus its error: mean and spread are those of a random effect
(Paule & Mandel 1982, J. Res. NBS 87, 377), the weight of a path being 1 / (spread^2 + error^2).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.curves.curves import OK, UNCERTAIN, CalibrationCurve
from lbacal_core.curves.reference_chain import GainSpread, GainSpreads, ReferenceChain
from lbacal_core.grids import Floats

FEWEST_PATHS = 3
"""From two paths a spread is known to a factor of two only."""
ROUNDS = 50


@dataclass(frozen=True)
class SinglePaths:
    """Paths fitted by themselves.

    Attributes
    ----------
    stations, cables
        Shape (path,), names.
    slope, sigma
        s and its standard deviation, shape (path, freq); NaN where a channel was not determined.
    loss
        L_coax, shape (path, freq).
    """

    stations: NDArray[np.str_]
    cables: NDArray[np.str_]
    slope: Floats
    sigma: Floats
    loss: Floats


def join_paths(parts: Sequence[SinglePaths]) -> SinglePaths:
    """Join all paths of several fits."""
    return SinglePaths(
        stations=np.concatenate([part.stations for part in parts]),
        cables=np.concatenate([part.cables for part in parts]),
        slope=np.concatenate([part.slope for part in parts]),
        sigma=np.concatenate([part.sigma for part in parts]),
        loss=np.concatenate([part.loss for part in parts]),
    )


def measure_spreads(paths: SinglePaths, reference_slope: Floats, mean_loss: Floats) -> GainSpreads | None:
    """Mean and spread of the departures by cable, over all paths, and between stations; None for fewer than 3 paths.

    Parameters
    ----------
    reference_slope, mean_loss
        s_ref and L_ref of the reference chain, shape (freq,).
    """
    expected = reference_slope * paths.loss / mean_loss
    departure, sigma = paths.slope / expected - 1.0, paths.sigma / expected
    everything = np.ones(len(paths.cables), dtype=bool)
    all_paths = _spread_of(departure, sigma, everything)
    if all_paths is None:
        return None
    by_cable = {
        str(cable): spread
        for cable in sorted(set(paths.cables))
        if (spread := _spread_of(departure, sigma, paths.cables == cable)) is not None
    }
    between = _spread_between(departure, sigma, paths, by_cable, all_paths)
    return GainSpreads(by_cable, all_paths, len(set(paths.stations)), between)


def _spread_of(departure: Floats, sigma: Floats, rows: NDArray[np.bool_]) -> GainSpread | None:
    """Mean and spread of some paths; None where a channel has too few."""
    fewest = int(np.min(np.isfinite(departure[rows]).sum(axis=0), initial=np.iinfo(np.int64).max))
    if not np.any(rows) or fewest < FEWEST_PATHS:
        return None
    effect = fit_random_effect(departure[rows], sigma[rows])
    return GainSpread(int(rows.sum()), effect.mean, effect.spread)


def _spread_between(
    departure: Floats, sigma: Floats, paths: SinglePaths, by_cable: Mapping[str, GainSpread], all_paths: GainSpread
) -> Floats | None:
    """Standard deviation of the mean departures of stations, beyond what the spread of their paths explains."""
    names: Sequence[str] = sorted(set(paths.stations))
    if len(names) < 2:
        return None
    of_path = [by_cable.get(str(cable), all_paths) for cable in paths.cables]
    centred = departure - np.array([spread.offset for spread in of_path])
    variance = np.array([spread.spread**2 for spread in of_path]) + sigma**2
    weight = np.where(np.isfinite(centred), 1.0 / variance, 0.0)
    centred = np.where(np.isfinite(centred), centred, 0.0)
    totals = np.array([weight[paths.stations == name].sum(axis=0) for name in names])
    sums = np.array([(weight * centred)[paths.stations == name].sum(axis=0) for name in names])
    with np.errstate(divide="ignore", invalid="ignore"):
        effect = fit_random_effect(sums / totals, totals**-0.5)
    return effect.spread


@dataclass(frozen=True)
class RandomEffect:
    """A random effect in many channels.

    Attributes
    ----------
    mean, variance
        Shape (freq,).
    information
        About the variance, at the typical variance, shape (freq,).
    """

    mean: Floats
    variance: Floats
    information: Floats

    @property
    def spread(self) -> Floats:
        """The standard deviation, shape (freq,).

        The variance of a channel departs from that of the band by the part of its own departure that noise does not
        make (empirical Bayes: Morris 1983, J. Am. Stat. Assoc. 78, 47).
        """
        total = float(np.sum(self.information))
        beyond = self.variance - np.sum(self.information * self.variance) / total
        own = max(float(np.sum(self.information * beyond**2) - beyond.size) / total, 0.0)
        return np.asarray(np.sqrt(self.variance - beyond / (1.0 + own * self.information)))


def fit_random_effect(values: Floats, sigma: Floats) -> RandomEffect:
    """Mean and variance of values of known error, channel by channel.

    The variance v solves sum((x - mean)^2 / (v + sigma^2)) = n - 1; the left side falls and is convex in v, so Newton's
    steps from 0 rise to the solution and never pass it. v is 0 where the errors explain the scatter.

    Parameters
    ----------
    values, sigma
        Shape (path, freq); NaN where absent.
    """
    is_known = np.isfinite(values) & np.isfinite(sigma)
    x, of_noise = np.where(is_known, values, 0.0), np.where(is_known, sigma, 1.0) ** 2
    freedom = is_known.sum(axis=0) - 1
    variance = np.zeros(x.shape[1])
    for _ in range(ROUNDS):
        mean, weight = _mean_with(variance, x, of_noise, is_known)
        excess = np.sum(weight * (x - mean) ** 2, axis=0) - freedom
        slope = np.sum(weight**2 * (x - mean) ** 2, axis=0)
        variance = np.maximum(variance + np.where(slope > 0, excess / np.where(slope > 0, slope, 1.0), 0.0), 0.0)
    mean, _ = _mean_with(variance, x, of_noise, is_known)
    _, typical = _mean_with(np.median(variance), x, of_noise, is_known)
    return RandomEffect(mean, variance, np.sum(typical**2, axis=0) / 2.0)


def _mean_with(
    variance: Floats | np.floating[Any], x: Floats, of_noise: Floats, is_known: NDArray[np.bool_]
) -> tuple[Floats, Floats]:
    """The weighted mean, shape (freq,), and its weights, shape (path, freq)."""
    weight = is_known / (variance + of_noise)
    return np.asarray(np.sum(weight * x, axis=0) / np.sum(weight, axis=0)), weight


# Carry a curve through the cable that a path has, with the error of the conversion.


@dataclass(frozen=True)
class ServedCurve:
    """A curve as a path is served it.

    Attributes
    ----------
    curve
        Named after the path; C and its errors are those of its own cable.
    factor
        C served over C stored, shape (freq,).
    cable
        The path's cable at the instant asked for; None where it is not known.
    flag, reason
        ``ok``, or ``uncertain`` and why.
    error
        Standard deviation, as a fraction, of what follows the date in `factor`.
    """

    curve: CalibrationCurve
    factor: Floats
    cable: str | None
    flag: str
    reason: str | None
    error: float = 0.0


def carry_to_path(
    curve: CalibrationCurve, chain: ReferenceChain | None, station: str, antenna: int, dipole: str, time_unix: float
) -> ServedCurve:
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
        return ServedCurve(named, ones, None, OK if is_own else UNCERTAIN, reason)
    cable = chain.cables.cable_of(station, antenna, time_unix)
    if cable is None:
        when = np.datetime64(round(time_unix), "s").astype("datetime64[D]")
        return ServedCurve(named, ones, None, UNCERTAIN, f"its cable is not known: {path} is not on record at {when}")
    if is_own and np.array_equal(chain.cables.cables[cable], chain.mean_loss):
        return ServedCurve(named, ones, cable, OK, None)
    factor = np.sqrt(chain.mean_loss / chain.cables.cables[cable])
    variance, reason = _departure(chain, station, cable, is_own=is_own)
    served = _scaled(named, factor, variance)
    reasons = [text for text in (reason, chain.doubt) if text]
    return ServedCurve(served, factor, cable, UNCERTAIN if reasons else OK, "; ".join(reasons) or None)


def serve_reference(curve: CalibrationCurve) -> ServedCurve:
    """A curve as that of its reference chain, which is nobody's cable."""
    return ServedCurve(curve, np.ones_like(curve.frequency_mhz), None, OK, None)


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
