"""Antennas against the others of a station: what is dead or clipped, bears the other letter or has another cable."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from lbacal_core.audit.station import MEDIAN, SKY_HOURS, AuditedStation, as_power, spread
from lbacal_core.audit.verdict import UNDECIDED, WRONG, Line
from lbacal_core.calibration.singles import SMALLEST_SHARE
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.sky.table import harmonics_at
from lbacal_core.spectra.spectra import NO_POWER

# Paths that do not receive as the others of their station do: dead, insensitive, oscillating, clipped, outlying.
#
# Every path is compared with the median of its station's polarisation, each through its own cable: by its level, by its
# spectrum, and by how much of the others' change with time it follows. Thresholds are wide of what working antennas do:
# gains of a station's receivers spread by 3-5 % (its gain tables), shapes by less.

DECIBEL = 10 / np.log(10)
DEAD_LEVEL = -np.log(10.0)
"""A path with less than a tenth of the others' power sends nothing of the sky."""
DEAF_SHARE, DEAF_LEVEL = 0.6, -0.25
"""An insensitive path follows less than this of the others' spectrum or of their change with time, and lies lower."""
PEAK, PEAK_SHARE = np.log(2.0), 1 / 3
"""An oscillating path exceeds its own level by a factor 2 in fewer than a third of its channels, and there by more than
the antennas of its station differ; or it is loud."""
RISE = 2.0
"""By what factor more a path must exceed there that is still high at an end of the band. So rises what an antenna hands
over with its impedance (lbacal_twin/mismatch.csv), and more upwards than downwards where noise dilutes it."""
LOUD = np.log(3.0)
CLIPPED_SHARE = 0.7
"""A clipped path is loud and follows less than this of the others' change with time."""
OUTLYING_SIGMA, OUTLYING = 6.0, 0.2
"""An outlying path is this many robust standard deviations and this factor from the others."""
SMALLEST_SPREAD = 0.01
NINTH = 0.9
CLASS = 3
"""Antennas of one cable name that are compared among themselves; of a rarer name, with all."""
MEASURABLE = 0.03
"""Change with time of the median path, r.m.s. of ln P, that a comparison needs."""


@dataclass(frozen=True)
class Comparison:
    """Each path against the median of its polarisation, shape (antenna, dipole) and for the profile (..., freq).

    Attributes
    ----------
    level, profile
        Median of ln P over the others' in time and frequency, and what is left of it along frequency.
    follows
        Slope of a path's change with time on that of the median path; NaN where it does not change enough.
    most
        The largest such slope that chance leaves likely, on the median path of any polarisation.
    shares
        Slope of a path's spectrum on the others', both about their means: 1 for a working path, 0 for a flat one.
    """

    level: Floats
    profile: Floats
    follows: Floats
    most: Floats
    shares: Floats


def compare_paths(station: AuditedStation) -> Comparison:
    """Compare every path with the median of its polarisation and cable name."""
    power = station.before_cable()
    typical = np.nanmedian(power, axis=0)
    difference = np.nanmedian(power - typical, axis=2)
    for cable in np.unique(station.cables):  # noise behind long cables lifts them where the sky is weak
        rows = station.cables == cable
        if rows.sum() >= CLASS:
            difference[rows] -= np.nanmedian(difference[rows], axis=0)
    level = np.nanmedian(difference, axis=-1)
    seen = typical.mean(axis=-1)
    change = seen - seen.mean(axis=-1, keepdims=True)
    own = np.nanmean(power, axis=-1)
    own = np.where(np.isfinite(own), own, np.nan)
    own = own - np.nanmean(own, axis=-1, keepdims=True)
    is_known = np.isfinite(own)
    own = np.where(is_known, own, 0.0)[:, :, None]
    change = np.where(is_known[:, :, None], change, 0.0)  # (antenna, dipole, dipole that is followed, time)
    variance = np.maximum(np.sum(change**2, axis=-1), TINY)
    slope = np.sum(own * change, axis=-1) / variance
    left = np.sum((own - slope[..., None] * change) ** 2, axis=-1) / np.maximum(is_known.sum(axis=-1), 1)[..., None]
    slope[:, :, seen.std(axis=-1) < MEASURABLE] = np.nan
    follows = np.diagonal(slope, axis1=1, axis2=2)
    most = np.max(slope + FITS_SIGMA * np.sqrt(left / variance), axis=-1)
    shape = np.median(typical, axis=1) + np.log(station.loss).mean(axis=0)
    shape = shape - shape.mean(axis=-1, keepdims=True)
    contrast = np.sum(shape**2, axis=-1)
    shares = 1.0 + np.sum((difference - level[..., None]) * shape, axis=-1) / np.where(contrast > 0, contrast, 1.0)
    return Comparison(level, difference - level[..., None], follows, most, shares)


def find_ill_paths(station: AuditedStation, comparison: Comparison) -> tuple[list[Line], NDArray[np.bool_]]:
    """Name the paths that do not work; shape (antenna, dipole) of those that must not count among the others."""
    lines = []
    is_ill = np.zeros(comparison.level.shape, dtype=bool)
    names, counts = np.unique(station.cables, return_counts=True)
    is_comparable = counts[np.searchsorted(names, station.cables)] >= CLASS
    rms = np.sqrt(np.mean(comparison.profile**2, axis=-1))
    typical_rms = np.maximum(np.nanmedian(rms, axis=0), SMALLEST_SPREAD)
    # antennas that are unlike along frequency are so in the mean of their bands as well
    level_spread = np.hypot(np.maximum(spread(comparison.level), SMALLEST_SPREAD), typical_rms)
    # unlike antennas scatter more upwards; the one that is asked about must not say by how much
    typical = np.nanmedian(comparison.profile, axis=0)
    others = np.sort(np.where(np.isfinite(comparison.profile), comparison.profile, typical), axis=0)[:-1]
    middle, high = np.quantile(others, [0.5, NINTH], axis=0)
    above = np.maximum((high - middle) / ndtri(NINTH), spread(comparison.profile))
    tallest = np.maximum(PEAK, OUTLYING_SIGMA * above)
    # few forms of unlike antennas add up to an r.m.s. that scatters as the modulus of one normal number does
    of_others = np.sort(np.where(np.isfinite(rms), rms, np.nanmedian(rms, axis=0)), axis=0)[:-1]
    oddest = OUTLYING_SIGMA * np.maximum(typical_rms, np.quantile(of_others, NINTH, axis=0) / ndtri((1 + NINTH) / 2))
    centre = np.nanmedian(comparison.level, axis=0)
    for a, d in np.ndindex(*comparison.level.shape):
        level = comparison.level[a, d] - centre[d]
        if not np.isfinite(level):
            continue
        is_odd = bool(rms[a, d] > max(oddest[d], OUTLYING / 2))
        kind = _name(comparison, a, d, float(level), float(level / level_spread[d]), tallest[d], is_odd=is_odd)
        if kind == "outlying" and not is_comparable[a]:
            kind = None
        is_ill[a, d] = kind is not None
        parts = _find_dead(station, a, d) if kind in (None, "dead") else []
        if kind is not None and len(parts) != 1:
            parts = [(None, None, float(level))]
        for since, until, depth in parts:
            check, when = kind or "dead", _describe_part(since, until)
            told = f"antenna {station.antennas[a]} {station.dipoles[d]} {_SENTENCES[check]}{when}"
            lines.append(
                Line(
                    check=check,
                    verdict=WRONG,
                    station=station.name,
                    sentence=f"{told}: {DECIBEL * depth:+.1f} dB from the others",
                    antennas=(int(station.antennas[a]),),
                    dipole=station.dipoles[d],
                    value=DECIBEL * depth,
                    unit="dB",
                    since_unix=None if since is None else since.at,
                    until_unix=None if until is None else until.at,
                )
            )
    return lines, is_ill


def _find_dead(station: AuditedStation, a: int, d: int) -> list[tuple[Edge | None, Edge | None, float]]:
    """When a path, by its row, begins and ceases to be dead, None where that is no date in the data; and its level."""
    power, found = station.before_cable()[:, d], list[tuple[Edge | None, Edge | None, float]]()
    level = np.nanmean(power[a] - np.nanmedian(power, axis=0), axis=-1)
    known = np.flatnonzero(~np.isnan(level))
    is_dead = level[known] < DEAD_LEVEL
    for run in np.flatnonzero(np.diff(is_dead, prepend=False, append=False)).reshape(-1, 2).tolist():
        if run[1] - run[0] >= FEWEST_BESIDE:
            since, until = (
                find_edge(station.time_unix[known], at, np.array([at]))
                if min(at, known.size - at) >= FEWEST_BESIDE
                else None
                for at in run
            )
            found.append((since, until, float(np.mean(level[known[slice(*run)]]))))
    return found


_SENTENCES = {
    "dead": "is dead (a tenth of the others' power at most)",
    "deaf": "is insensitive (its receiver works, its antenna does not, or its power does not follow the sky)",
    "oscillating": "oscillates (strong in part of the band)",
    "clipped": "is clipped (loud, and follows the others' change too little)",
    "outlying": "lies outside what the others do",
}


def _name(
    comparison: Comparison, a: int, d: int, level: float, sigma: float, tallest: Floats, *, is_odd: bool
) -> str | None:
    """The first kind whose description a path meets, or None."""
    follows = float(np.nan_to_num(comparison.follows[a, d], nan=1.0))
    receives = min(float(comparison.shares[a, d]), follows)
    profile = comparison.profile[a, d]
    is_far = abs(sigma) > OUTLYING_SIGMA
    is_rise = max(profile[0], profile[-1]) > profile.max() / 2
    highest = profile / RISE if is_rise else profile
    is_peaked = bool(np.any(highest > tallest)) and np.mean(profile > PEAK / 2) < PEAK_SHARE
    kinds = {
        "dead": level < DEAD_LEVEL,
        "deaf": (level < DEAF_LEVEL and is_far and receives < DEAF_SHARE)
        or (level < LOUD and float(comparison.most[a, d]) < SMALLEST_SHARE),
        "clipped": level > LOUD and follows < CLIPPED_SHARE,
        "oscillating": level > LOUD or is_peaked,
        "outlying": (abs(level) > OUTLYING and is_far) or is_odd,
    }
    return next((kind for kind, is_met in kinds.items() if is_met), None)


# Channels that hold no sky in any path: far below the others, or the same number all the time.

NO_CHANGE = 0.01
"""Change with time over that of the median channel: even interference changes with the gain."""
SHOWN = 10
"""Channels that are told; more are counted."""


def find_empty_channels(station: AuditedStation) -> list[Line]:
    """Tell the channels without sky, which spoil the fit of all others; empty where there are none."""
    power = np.nanmedian(np.log(station.power), axis=(0, 1))
    level, change = np.median(power, axis=0), power.std(axis=0)
    is_empty = level < np.median(level) + np.log(NO_POWER)
    if np.median(change) > MEASURABLE:
        is_empty |= change < NO_CHANGE * np.median(change)
    if not is_empty.any():
        return []
    empty = [f"{frequency:g}" for frequency in station.frequency_mhz[is_empty]]
    more = f" and {len(empty) - SHOWN} more" if len(empty) > SHOWN else ""
    sentence = (
        f"{len(empty)} of {is_empty.size} channels hold no sky in any path (one number, or 1e-6 of the others' power): "
        f"{', '.join(empty[:SHOWN])} MHz{more}; take them out of the spectra"
    )
    return [Line("channels", WRONG, station.name, sentence)]


COPIED = 3
"""Events from which on one spectrum in two paths is no chance: numbers so coarse that paths agree by chance so often
agree in other events too, of which there are more pairs, and a spectrum that another event holds does not count."""


def find_copies(station: AuditedStation) -> list[Line]:
    """Tell paths that hold spectra of another, whose noise is never the same, in some of their events or in all."""
    paths = [(int(antenna), dipole) for antenna in station.antennas for dipole in station.dipoles]
    power, time = station.power.reshape(len(paths), *station.power.shape[2:]), station.time_unix
    is_known = np.isfinite(power[..., 0])
    holders, shared = defaultdict[int, list[tuple[int, int]]](list), defaultdict[tuple[int, int], list[int]](list)
    for path, event in np.argwhere(is_known).tolist():
        holders[hash(power[path, event].tobytes())].append((path, event))
    for (first, event), *others in holders.values():
        if all(at == event for _, at in others):
            for path, _ in others:
                shared[first, path].append(event)
    lines = []
    for (first, own), events in sorted(shared.items()):
        known = np.flatnonzero(is_known[own])
        if len(events) < min(COPIED, known.size) or np.ptp(power[own, events]) == 0:
            continue
        is_whole, begin, end = len(events) == known.size, events[0], events[-1]
        (antenna, dipole), (other, letter) = paths[own], paths[first]
        days = [f"{datetime.fromtimestamp(float(time[at]), UTC):%Y-%m-%d}" for at in (begin, end)]
        part = "" if is_whole else f" in {len(events)} of {known.size} events, {' to '.join(days)}"
        told = f"antenna {antenna} {dipole} holds the same numbers as antenna {other} {letter}{part}"
        lines.append(
            Line(
                "copy",
                WRONG,
                station.name,
                f"{told}: one is a copy, or both were read from one receiver",
                (antenna,) if is_whole or other == antenna else (other, antenna),
                dipole,
                since_unix=None if begin == known[0] else float(time[begin - 1 : begin + 1].mean()),
                until_unix=None if end == known[-1] else float(time[end : end + 2].mean()),
            )
        )
    return lines


# Antennas whose cable is not the one on record: level and slope against every cable that the instrument has.

LEAST_LOG_ODDS = np.log(1e4)
"""One antenna in a hundred has a wrong entry at most, and every other cable name is tried for each."""
FITS_SIGMA = 4.0
"""The cable that is named must describe the antenna within this many standard deviations."""
BEHIND_CABLE = 0.2
"""Share of the loss that noise behind the cable hides, at most."""
SKY_INDEX = -0.55
"""Exponent of P_sky along frequency, W m^-2 MHz^-1: that of the brightness (-2.55; Mozdzen et al. 2019) plus 2."""
CORRECTION, BANDS, BAND_SAYS = 0.7, 4, 1.5
"""Ln A(nu), what nobody knows of antenna gains: a factor 2, independent in as many parts of the band; and the most that
one of them says: spectra from which the pass band was divided out exist."""
SMALLEST = np.array([0.03, 0.01])
"""Scatter of level and slope that working antennas have at least: 3-5 % of gain (station gain tables of 2013)."""


def find_wrong_cables(
    station: AuditedStation, comparison: Comparison, instrument: Instrument
) -> tuple[list[Line], dict[int, str]]:
    """Name antennas that another cable describes far better; and the cable of each, by its row.

    A cable name that other antennas have is represented by their median: it holds the noise behind the cable too. Where
    none has it, its loss must do, with what that noise hides of the loss as an error. Both dipoles of an antenna have
    one cable: where one of them by itself speaks against another, something is wrong with a path.
    """
    axis = station.frequency_mhz - station.frequency_mhz.mean()
    axis = axis / np.sqrt(np.mean(axis**2)) if axis.size > 1 else axis
    power = np.log(station.power)
    recorded = np.nanmedian(power - np.nanmedian(power, axis=0), axis=2)  # half of the time one may be dead
    sigma = np.maximum(spread(_level_and_slope(comparison.level[..., None] + comparison.profile, axis)), SMALLEST)
    distances = {}
    for name, loss in instrument.cables.items():
        rows = station.cables == name
        lost = np.log(station.loss / loss)[:, None, :]
        expected = comparison.level[..., None] + comparison.profile + lost
        if not rows.any():
            distances[name] = _distance(expected, axis, np.hypot(sigma, BEHIND_CABLE * _level_and_slope(lost, axis)))
            continue
        of_others = _distance(recorded - np.nanmedian(recorded[rows], axis=0), axis, sigma) / (1 + MEDIAN / rows.sum())
        distances[name] = np.where(rows & (rows.sum() < CLASS), _distance(expected, axis, sigma), of_others)
    lines = []
    found = {}
    for a, own in enumerate(station.cables):
        best = min((name for name in distances if name != own), key=lambda name: distances[name][0, a], default=None)
        if best is None or not np.isfinite(distances[best][0, a]):
            continue
        odds, *of_dipoles = ((distances[own] - distances[best])[:, a] / 2).tolist()
        if odds < LEAST_LOG_ODDS or distances[best][0, a] > FITS_SIGMA**2 or min(of_dipoles) < 0:
            continue
        found[a] = best
        sentence = f"antenna {station.antennas[a]} has the cable {best}, not {own} as on record"
        lines.append(Line("cable", WRONG, station.name, sentence, antennas=(int(station.antennas[a]),), log_odds=odds))
    return lines, found


def _distance(difference: Floats, axis: Floats, sigma: Floats) -> Floats:
    """Squared distance of level and slope in standard deviations (shape (2,) or (antenna, 2)), (1 + dipole, antenna).

    The first is that of the mean over the dipoles, of which one that is not there is as the other.
    """
    own = np.where(np.isnan(difference), np.nanmean(difference, axis=1, keepdims=True), difference)
    parts = [difference, *np.split(own, own.shape[1], axis=1)]
    return np.stack([np.sum((_level_and_slope(part, axis) / sigma) ** 2, axis=1) for part in parts])


def _level_and_slope(difference: Floats, axis: Floats) -> Floats:
    """Mean over both polarisations of ln P, and its slope along frequency; shape (antenna, 2)."""
    seen = np.nanmean(difference, axis=1)
    return np.stack([seen.mean(axis=-1), seen @ axis / axis.size], axis=-1)


def fits_cables(station: AuditedStation, rows: NDArray[np.int64], unit: str) -> bool:
    """Whether values in a unit of `as_power` differ between cable names as cables do, not only better than power.

    `rows` are rows of the station, not antenna numbers.
    """
    return _of_cables(station, rows, np.log(as_power(station.power[rows], unit))) > -(FITS_SIGMA**2) / 2


def log_likelihood_of_unit(
    station: AuditedStation, rows: NDArray[np.int64], unit: str, instrument: Instrument
) -> float:
    """Ln L that values of some antennas are in a unit of `as_power`, by how cable names and frequencies differ.

    A longer cable takes from the power, in dB; and the power runs as the sky does, through antenna and receiver.
    """
    power = np.log(as_power(station.power[rows], unit))
    return _of_cables(station, rows, power) + _of_spectrum(station, rows, power, instrument)


def _of_spectrum(station: AuditedStation, rows: NDArray[np.int64], power: Floats, instrument: Instrument) -> float:
    """Ln L of the median spectrum of the antennas, shape (antenna, dipole, time, freq), but for its level."""
    expected = np.log(instrument.antenna_gain * instrument.receiver_gain)
    expected = expected + SKY_INDEX * np.log(station.frequency_mhz)
    rest = np.nanmedian(power - np.log(station.loss[rows])[:, None, None, :], axis=(0, 1, 2)) - expected
    rest -= rest.mean()
    bands = [float(np.mean(band**2)) for band in np.array_split(rest, BANDS) if band.size]
    return -float(np.sum(np.minimum(np.array(bands) / (2 * CORRECTION**2), BAND_SAYS)))


def _of_cables(station: AuditedStation, rows: NDArray[np.int64], power: Floats) -> float:
    """Ln L of the levels of cable names; 0 where the antennas have one."""
    _, rest, sigma = levels_of_cables(station, rows, power)
    return float(-np.sum((rest / sigma) ** 2) / 2)


def levels_of_cables(
    station: AuditedStation, rows: NDArray[np.int64], power: Floats
) -> tuple[NDArray[np.str_], Floats, Floats]:
    """Cable names, ln P of their antennas over what loss and the other names say, and its error, shape (name,) each.

    All are empty where there is one name. `rows` are rows of the station, not antenna numbers; `power` is theirs,
    shape (row, dipole, event, freq).
    """
    own = np.nanmean(power, axis=1)
    level = np.nanmedian(np.nanmedian(own - np.nanmedian(own, axis=0), axis=1), axis=1)
    expected = np.log(station.loss[rows]).mean(axis=-1)
    names, name_at = np.unique(station.cables[rows], return_inverse=True)
    if names.size == 1:
        return names[:0], np.zeros(0), np.ones(0)
    seen = np.array([np.nanmedian(level[name_at == k]) for k in range(names.size)])
    count = np.bincount(name_at)
    scatter = max(float(spread(level - seen[name_at])), SMALLEST[0])
    loss = np.array([expected[name_at == k][0] for k in range(names.size)])
    variance = MEDIAN * scatter**2 / count + (BEHIND_CABLE * (loss - loss.mean())) ** 2
    return names, (seen - loss) - np.average(seen - loss, weights=1 / variance), np.sqrt(variance)


# Antennas whose dipoles bear each other's letter, against the others of their station.
#
# ln P_X - ln P_Y changes with sidereal time alike for all antennas; of an exchanged one it changes the other way round.
# Where the data are too short for that its value itself must do: the sky is not equally bright in both polarisations,
# and gains of dipoles scatter by a few per cent.

CERTAIN = np.log(1e3)
"""Odds of 1000 to 1 either way; between them the data cannot say."""
FEWEST_TIMES = 3
PAIR = 2
"""Dipoles of an antenna whose letters can be told apart by their ratio; of one or three the sky alone can tell."""
ABOVE_NOISE = 1.5
"""Singular value of a common change over the largest that noise alone has, sigma (sqrt(antennas) + sqrt(times))."""
SMALLEST_SCATTER = 0.03
"""Scatter of ln P_X - ln P_Y from antenna to antenna at least."""
TAIL = 4.0
"""Degrees of freedom of Student's t."""
SMALLEST_SLOPE_ERROR = 0.1
"""Antennas do not follow the median closer than this: coupling between neighbours, sky noise."""
DATE_SIGMA, TINY = 3.0, 1e-12
"""Standard deviations by which instants before and after a date are told to lie on the wrong side of it."""


class Edge(NamedTuple):
    """When a part of the time begins or ends, and between which instants, s UTC."""

    at: float
    first: float
    last: float

    def __str__(self) -> str:
        """Write between which instants it lies."""
        first, last = (f"{datetime.fromtimestamp(at, UTC):%Y-%m-%d %H:%M}" for at in self[1:])
        return f"a date between {first} and {last} UTC"


@dataclass(frozen=True)
class ExchangedPart:
    """Log odds that the dipoles of an antenna, by its row, are exchanged since a date, until one, or between two.

    They are those of the less certain of the two parts of the time.
    """

    row: int
    since: Edge | None
    until: Edge | None
    odds: float


@dataclass(frozen=True)
class ExchangeOdds:
    """Log odds that the dipoles of an antenna are exchanged relative to most of the station.

    Attributes
    ----------
    rows
        Rows of the antennas that were compared.
    odds
        The odds of these antennas, shape (antenna,); the sky decides which of the two groups is exchanged.
    dated
        Antennas that differ from most before or after a date only, which are none of `rows`.
    """

    rows: NDArray[np.int64]
    odds: Floats
    dated: Sequence[ExchangedPart] = ()

    def exchanged(self) -> NDArray[np.int64]:
        """Select those of `rows`, shape (exchanged,), whose antennas differ from most."""
        return np.asarray(self.rows[self.odds > CERTAIN])

    def flipped(self) -> ExchangeOdds:
        """Reverse the odds, for a station of which most antennas are exchanged."""
        dated = [
            one if one.since and one.until else replace(one, since=one.until, until=one.since) for one in self.dated
        ]
        return ExchangeOdds(self.rows, -self.odds, dated)


def compare_polarisations(station: AuditedStation, is_usable: NDArray[np.bool_]) -> ExchangeOdds:
    """Sort the antennas into those that agree with most of the station and those that are exchanged against it.

    Parameters
    ----------
    is_usable
        Shape (antenna,): both dipoles work.
    """
    rows = np.flatnonzero(is_usable)
    if rows.size == 0 or len(station.dipoles) != PAIR:
        return ExchangeOdds(rows, np.zeros(0))
    ratio = np.nanmean(np.log(station.power[rows, 0]) - np.log(station.power[rows, 1]), axis=-1)
    common = _find_common_change(ratio)
    if common is None:
        odds, is_with = np.zeros(rows.size), np.ones(rows.size, dtype=bool)
    else:
        odds, is_with = -2.0 * common.slope / common.error**2, common.slope > 0
    odds = odds + _odds_of_values(ratio, is_with)
    dated = [] if common is None else _find_dated(rows, ratio, common, station.time_unix)
    is_whole = ~np.isin(rows, [one.row for one in dated])
    exchange = ExchangeOdds(rows[is_whole], odds[is_whole], dated)
    return exchange if np.sum(exchange.odds > 0) <= is_whole.sum() / 2 else exchange.flipped()


def tell_exchanged(station: AuditedStation, exchange: ExchangeOdds) -> list[Line]:
    """The exchanged antennas, and those of which these data cannot say."""
    lines: list[Line] = []
    if len(station.dipoles) != PAIR:
        return lines
    exchanged = exchange.exchanged()
    if exchanged.size:
        found = tuple(int(a) for a in station.antennas[exchanged])
        sentence = f"X and Y are exchanged at {_list_antennas(found)}{_describe(station, exchange)}"
        least = float(exchange.odds[exchange.odds > CERTAIN].min())
        lines.append(Line("exchange", WRONG, station.name, sentence, found, log_odds=least, kind="exchange"))
    lines += [_tell_dated(station, one) for one in exchange.dated]
    unknown = np.abs(exchange.odds) <= CERTAIN
    if unknown.any():
        silent = tuple(int(a) for a in station.antennas[exchange.rows[unknown]])
        sentence = f"{station.length} not tell X from Y at {_list_antennas(silent)}; some hours would"
        likeliest = float(exchange.odds[unknown].max())
        lines.append(Line("exchange", UNDECIDED, station.name, sentence, antennas=silent, log_odds=likeliest))
    return lines


def _tell_dated(station: AuditedStation, one: ExchangedPart) -> Line:
    """The exchange of an antenna in a part of the time."""
    antenna = int(station.antennas[one.row])
    return Line(
        "exchange",
        WRONG,
        station.name,
        f"X and Y are exchanged at antenna {antenna}{_describe_part(one.since, one.until)}",
        antennas=(antenna,),
        log_odds=one.odds,
        kind="exchange",
        since_unix=None if one.since is None else one.since.at,
        until_unix=None if one.until is None else one.until.at,
    )


def _describe_part(since: Edge | None, until: Edge | None) -> str:
    """When a part of the time begins and ends, for the end of a clause; empty for all of it."""
    when = " and ".join(f"{word} {edge}" for word, edge in (("since", since), ("until", until)) if edge is not None)
    return when and f" {when}"


@dataclass(frozen=True)
class CommonChange:
    """The change of ln P_X - ln P_Y with time that antennas share, and how each follows it.

    Attributes
    ----------
    change
        Shape (time,), of a typical antenna.
    slope
        Slope of each antenna on it, shape (antenna,): negative for those that run against it.
    likeness, error
        How closely working antennas follow it; and that with the noise of each, shape (antenna,).
    """

    change: Floats
    slope: Floats
    likeness: float
    error: Floats


def _find_common_change(ratio: Floats) -> CommonChange | None:
    """The first principal component of a ratio of shape (antenna, time); None where noise alone could be as large.

    It does not care how many antennas run against it. An antenna that changes by itself, by far more, has no say.
    """
    own = ratio - np.nanmean(ratio, axis=1, keepdims=True)
    own = np.where(np.isfinite(own), own, 0.0)
    size = own.std(axis=1, keepdims=True)
    whole, own = own, own * np.minimum(1.0, np.median(size) / np.maximum(size, TINY))
    if ratio.shape[1] < FEWEST_TIMES or not own.any():
        return None
    loadings, strengths, changes = np.linalg.svd(own, full_matrices=False)
    rest = own - strengths[0] * np.outer(loadings[:, 0], changes[0])
    noise = float(np.median(spread(rest, axis=1)))
    if strengths[0] < ABOVE_NOISE * noise * (own.shape[0] ** 0.5 + own.shape[1] ** 0.5):
        return None
    along = whole @ changes[0]
    changes[0] *= np.sign(np.median(along)) or 1.0  # as most antennas see it
    along = whole @ changes[0]
    typical = float(np.median(np.abs(along)))
    slope = along / typical
    likeness = max(SMALLEST_SLOPE_ERROR, float(spread(np.abs(slope))))
    left = np.maximum(np.std(whole - np.outer(along, changes[0]), axis=1), noise)
    return CommonChange(typical * changes[0], slope, likeness, np.hypot(likeness, left / typical))


def _find_dated(rows: NDArray[np.int64], ratio: Floats, common: CommonChange, time: Floats) -> list[ExchangedPart]:
    """Antennas that run with the common change before a date and against it after, or the other way round.

    Each has a level and a slope before and after every instant; the date is where they leave the least. A slope says
    less where the common change is small in one of the parts. One that runs against it for a spell, and with it before
    and after, is exchanged between two dates: there the sum of its products with the change falls most.
    """
    found = []
    for row, values in zip(rows, ratio, strict=True):
        known = np.flatnonzero(np.isfinite(values))
        splits = np.arange(FEWEST_BESIDE, known.size - FEWEST_BESIDE + 1)
        if splits.size == 0:
            continue
        seen, own, when = common.change[known], values[known], time[known]
        before, after = _fit_lines(seen, own)[:, splits - 1], _fit_lines(seen[::-1], own[::-1])[:, -splits - 1]
        left = before[2] + after[2]
        k = int(np.argmin(left))
        odds, variance = _odds_of_parts(common, seen, own, np.arange(known.size) >= splits[k])
        if odds.prod() < 0 and np.abs(odds).min() > CERTAIN + np.log(splits.size):
            edge = find_edge(when, splits[k], splits[left - left[k] <= DATE_SIGMA**2 * variance])
            since, until = (edge, None) if odds[1] > 0 else (None, edge)
            found.append(ExchangedPart(int(row), since, until, float(np.abs(odds).min())))
            continue
        walk = np.append(0.0, np.cumsum(seen * np.median(own) - seen * own))
        end = int(np.argmax(walk - np.minimum.accumulate(walk)))
        begin = int(np.argmin(walk[: end + 1]))
        if min(begin, end - begin, known.size - end) < FEWEST_BESIDE:
            continue
        at = np.arange(known.size)
        odds, variance = _odds_of_parts(common, seen, own, (at >= begin) & (at < end))
        if odds[0] < 0 < odds[1] and np.abs(odds).min() > CERTAIN + 2.0 * np.log(splits.size):
            reach, inner = 0.5 * DATE_SIGMA**2 * variance, np.arange(1, known.size)
            since = find_edge(when, begin, inner[(inner < end) & (walk[inner] - walk[begin] <= reach)])
            until = find_edge(when, end, inner[(inner > begin) & (walk[end] - walk[inner] <= reach)])
            found.append(ExchangedPart(int(row), since, until, float(np.abs(odds).min())))
    return found


def _odds_of_parts(common: CommonChange, seen: Floats, own: Floats, is_in: NDArray[np.bool_]) -> tuple[Floats, float]:
    """Log odds of an exchange out of a part of the time and in it, 0 where neither follows; and what lines leave."""
    slope, power, left = np.stack([_fit_lines(seen[part], own[part])[:, -1] for part in (~is_in, is_in)], axis=-1)
    count, variance = np.array([np.sum(~is_in), np.sum(is_in)]), max(float(left.sum()), 0.0) / own.size
    error = np.sqrt((common.likeness**2 * np.var(seen) * count + variance) / np.maximum(power, TINY))
    follows = np.all(np.abs(np.abs(slope) - 1.0) < FITS_SIGMA * error)
    return np.where(follows, -2.0 * slope / error**2, 0.0), variance


def find_edge(when: Floats, at: int, near: NDArray[np.int64]) -> Edge:
    """The edge before an instant, by its number, and those before others that it may be as well."""
    last, first, earliest, latest = when[[at - 1, at, near[0] - 1, near[-1]]].tolist()
    return Edge((last + first) / 2, earliest, latest)


def _fit_lines(x: Floats, y: Floats) -> Floats:
    """Slope of y on x in the first values, for each number of them, shape (3, value); sum of squares of x; and left."""
    n = np.arange(1, x.size + 1)
    xx, xy, yy = (np.cumsum(a * b) - np.cumsum(a) * np.cumsum(b) / n for a, b in ((x, x), (x, y), (y, y)))
    slope = xy / np.maximum(xx, TINY)
    return np.stack([slope, xx, yy - slope * xy])


def _odds_of_values(ratio: Floats, is_with: NDArray[np.bool_]) -> Floats:
    """Log odds that the mean in time has the other sign, of gains that scatter as those of the station do.

    The scatter is that of Student's t: one odd gain in a hundred antennas is no exchanged one.
    """
    mean = np.nanmean(ratio, axis=1)
    sign = np.where(is_with, 1.0, -1.0)
    typical = float(np.nanmedian(sign * mean))
    error = max(float(spread(sign * mean)), SMALLEST_SCATTER)

    def penalty(expected: float) -> Floats:
        return np.asarray((TAIL + 1) / 2 * np.log1p(((mean - expected) / error) ** 2 / TAIL))

    return penalty(typical) - penalty(-typical)


def _describe(station: AuditedStation, exchange: ExchangeOdds) -> str:
    """Whether they are just the even or the odd antennas: then it is a whole antenna field."""
    parity = station.antennas % 2
    for value, word in ((0, "even"), (1, "odd")):
        of_field = exchange.rows[parity[exchange.rows] == value]
        if of_field.size > 1 and np.array_equal(exchange.exchanged(), of_field):
            return f": all {word} antennas, an antenna field whose inputs are wired the other way round"
    return ""


def _list_antennas(numbers: tuple[int, ...]) -> str:
    shown = ", ".join(str(number) for number in numbers[:8])
    more = f" and {len(numbers) - 8} more" if len(numbers) > 8 else ""
    return f"antenna{'s' if len(numbers) > 1 else ''} {shown}{more}"


# Power that steps as no sky does: of all paths at one instant, or between antennas of different cables.

STEPPED = "stepped"
LEAST_IN_TIME, LEAST_OF_CABLE = np.log(1.5), np.log(2.0)
"""Ln of the power: the sky does not change by as much in an instant, nor what stands behind a cable by its length."""
SURE_SIGMA = 8.0
FEWEST_BESIDE = 6
"""Instants before and after a step."""
HARMONICS = 3


def find_steps(station: AuditedStation, rows: NDArray[np.int64]) -> list[Line]:
    """Steps of antennas, given by their rows in the station: in time, and between cable names.

    Empty where there are none.
    """
    return [*_find_in_time(station, rows), *_find_between_cables(station, rows)] if rows.size else []


def _find_in_time(station: AuditedStation, rows: NDArray[np.int64]) -> list[Line]:
    """The instant at which most paths step together, beside what changes with sidereal time."""
    paths = np.nanmean(np.log(station.power[rows]), axis=-1).reshape(-1, station.time_unix.size)
    course = np.nanmedian(paths - np.nanmedian(paths, axis=1, keepdims=True), axis=0)
    known = np.flatnonzero(np.isfinite(course))
    course, time = course[known], station.time_unix[known]
    if course.size < 2 * FEWEST_BESIDE:
        return []
    smooth = np.stack([np.ones(course.size), time - time.mean()], axis=1)
    if station.hours >= SKY_HOURS:
        smooth = harmonics_at(station.lst_hours[known], HARMONICS)
    axes, size, _ = np.linalg.svd(smooth / np.linalg.norm(smooth, axis=0), full_matrices=False)
    axes = axes[:, size > 1e-6 * size[0]]
    splits = np.arange(FEWEST_BESIDE, course.size - FEWEST_BESIDE + 1)
    after = (np.arange(course.size)[:, None] >= splits).astype(float)
    own, rest = after - axes @ (axes.T @ after), course - axes @ (axes.T @ course)
    information = np.maximum(np.sum(own**2, axis=0), 1e-9)
    amount = own.T @ rest / information
    k = int(np.argmax(amount**2 * information))
    left = rest - amount[k] * own[:, k]
    sigma = float(np.std(left)) / information[k] ** 0.5
    beside = left + amount[k] * after[:, k]
    jump = float(np.median(beside[splits[k] :][:FEWEST_BESIDE]) - np.median(beside[: splits[k]][-FEWEST_BESIDE:]))
    if min(abs(amount[k]), 2 * jump * np.sign(amount[k])) < LEAST_IN_TIME or abs(amount[k]) < SURE_SIGMA * sigma:
        return []
    when = datetime.fromtimestamp(float(time[splits[k] - 1 : splits[k] + 1].mean()), UTC)
    sentence = (
        f"the power of all paths steps by {DECIBEL * amount[k]:+.1f} dB about {when:%Y-%m-%d %H:%M} UTC: two chains, "
        "to be fitted separately (--until and --since)"
    )
    return [_tell(STEPPED, station, sentence, float(amount[k]), sigma)]


def _find_between_cables(station: AuditedStation, rows: NDArray[np.int64]) -> list[Line]:
    """The cable whose antennas lie farthest from what its loss and the others say."""
    names, rest, sigma = levels_of_cables(station, rows, np.log(station.power[rows]))
    if names.size == 0:
        return []
    weight = sigma**-2
    others = weight.sum() - weight
    apart, error = rest - (weight @ rest - weight * rest) / others, np.sqrt(sigma**2 + 1 / others)
    k = int(np.argmax(np.abs(apart)))
    if abs(apart[k]) < max(LEAST_OF_CABLE, FITS_SIGMA * error[k]):
        return []
    sentence = f"antennas with the cable {names[k]} lie {DECIBEL * apart[k]:+.1f} dB from what loss and others say"
    return [_tell("cable", station, sentence, float(apart[k]), float(error[k]))]


def _tell(check: str, station: AuditedStation, sentence: str, amount: float, sigma: float) -> Line:
    return Line(check, WRONG, station.name, sentence, value=DECIBEL * amount, sigma=DECIBEL * sigma, unit="dB")
