"""What is concluded from the likelihoods of a record and of everything that may be wrong in it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.grids import Floats
from lbacal_core.provenance import as_json

# One line of an audit: what was asked, of whom, the answer and how sure it is.

WRONG, UNDECIDED, RIGHT = "wrong", "undecided", "right"


@dataclass(frozen=True)
class Line:
    """One question and its answer.

    Attributes
    ----------
    check
        What was asked: `dead`, `exchange`, `clock`, ...
    verdict
        `wrong`, `right`, or `undecided`: these data cannot say.
    station, antennas, dipole
        The path or paths; no antennas for the whole station, None for both polarisations.
    log_odds
        Natural logarithm of the odds against the claim on record: of what is wrong, or else of the likeliest mistake.
        None where nothing was compared.
    value, sigma, unit
        Size, where there is one; its error covers that of other possibilities that the data do not tell apart.
    candidates
        Checks of which the data cannot say which one is wrong, where there are several.
    sentence
        The answer in words, and for `undecided` what would decide.
    kind
        The `Possibility` that is better than the record.
    since_unix, until_unix
        When it begins or ends, s UTC, where that lies within the data.
    seasons_h
        Size of a clock in Europe's summer time and else, h, where they differ; `value` is the more significant one.
    """

    check: str
    verdict: str
    station: str
    sentence: str
    antennas: tuple[int, ...] = ()
    dipole: str | None = None
    log_odds: float | None = None
    value: float | None = None
    sigma: float | None = None
    unit: str = ""
    candidates: tuple[str, ...] = ()
    kind: str = ""
    since_unix: float | None = None
    until_unix: float | None = None
    seasons_h: tuple[float, float] | None = None

    def is_during(self, time_unix: Floats) -> NDArray[np.bool_]:
        """Whether it concerns instants, same shape, s UTC."""
        since, until = self.since_unix, self.until_unix
        return (time_unix >= (-np.inf if since is None else since)) & (time_unix < (np.inf if until is None else until))

    def as_dict(self) -> dict[str, Any]:
        """Describe the line as JSON values, all but `kind` under their names here."""
        told = {name: as_json(value) for name, value in vars(self).items() if name != "kind"}
        return told | {
            "log_odds": None if self.log_odds is None else round(self.log_odds, 1),
            "value": None if self.value is None else float(f"{self.value:.4g}"),
            "sigma": None if self.sigma is None else float(f"{self.sigma:.2g}"),
        }


LEAST_GAIN = 10.0
"""ln L by which another possibility must be better than what is on record: odds of 150 after prior odds of 1 in 150."""
ALIKE, ALIKE_IN_HOURS, LONG_H = 5.0, LEAST_GAIN, 6.0
"""Possibilities whose ln L differ by less cannot be told apart; and in data shorter than this, where an error of a sky
model looks like a turned arm or another clock: of 800 faults in drawn hours three were 5-6 below the best."""
RIGHT_ANGLE, NEAR_RIGHT = 90.0, 10.0
SAME_SIGMAS, SAME_H = 2.5, 1 / 30
"""A size this near to that of a fault that has none is this fault: nothing else puts it just there."""
TELLING = {"clock": 1.0, "arms": 20.0}
"""Errors (h, deg) above which data cannot be said to confirm a clock or arms."""
CONFIRMS_SIGMAS = 4.0
"""A size that is farther from none is no confirmation."""
ZONE_SIGMA_H = 0.1
"""A clock must be known this well before its error is called that of a time zone."""
RECORD = "record"
SHIFTS = {"clock", "longitude sign"}
"""What does nothing but shift sidereal time."""
SUMMER_TIME = "summer time"
HOURS, HOUR_DEG = 24, 15.0
"""Time zones, of which a wrong one is one; and the turn of the sky in an hour."""
LEANING_H = 45.0 / HOUR_DEG
"""A mast that leans by 45 degrees has fallen."""
WHAT_DECIDES = (
    "The sky does not tell a clock from a longitude: the Sun in data of the day, the local hours of broadcasts, or a "
    "second station on the same clock would"
)
NOTHING_FITS = (
    "neither the record nor anything else that was tried describes these data: the antenna may be another than the "
    "model, or the receiver changes with the hour; lbacal fit shows where along frequency"
)
_CHECKS = {
    "latitude": "place",
    "latitude sign": "place",
    "longitude sign": "place",
    "latitude for longitude": "place",
    "dB": "unit",
    "volt": "unit",
    "arm": "arms",
}


@dataclass(frozen=True)
class Possibility:
    """One way in which a record may differ from what was seen.

    Attributes
    ----------
    log_likelihood
        Averaged over all sizes that the possibility may have.
    value, sigma
        Size of a clock (h), of turned arms or of a latitude (deg); of other places, the clock that would look like it
        (h).
    fits
        Whether it describes the data, and not only better than the record does.
    dipole
        The arm that is turned alone.
    """

    kind: str
    log_likelihood: float
    value: float | None = None
    sigma: float | None = None
    fits: bool = True
    dipole: str | None = None

    @property
    def check(self) -> str:
        """Which question of the audit it answers."""
        return _CHECKS.get(self.kind, self.kind)

    @property
    def checks(self) -> tuple[str, ...]:
        """The questions that it may answer: power of X and Y that is mixed looks like one arm along the other."""
        is_along = self.kind == "arm" and self.is_right_angle
        return ("exchange", self.check) if is_along else (self.check,)

    @property
    def is_right_angle(self) -> bool:
        """Whether its size is that of arms turned by a right angle."""
        return RIGHT_ANGLE - abs(self.value or 0.0) < max(NEAR_RIGHT, SAME_SIGMAS * (self.sigma or 0.0))

    def is_chance_of(self, other: Possibility) -> bool:
        """Whether its size is just that which another possibility, which has no free size, explains."""
        value, sigma = self.value or 0.0, self.sigma or 0.0
        if self.kind == "arms" and other.kind == "exchange":
            return self.is_right_angle
        if self.kind == "latitude":
            return other.kind == "latitude sign"
        if self.kind == "clock" and other.check == "place" and other.value:
            is_near = abs(value - other.value) < max(SAME_H, SAME_SIGMAS * sigma)
            return is_near and other.log_likelihood >= self.log_likelihood
        return False


def conclude(
    station: str,
    base: float,
    possibilities: Sequence[Possibility],
    hours: float = float("inf"),
    base_fits: bool = True,
    least_doubt: float = ALIKE,
) -> list[Line]:
    """Conclude which record is wrong, if any; else which parts of the record the data confirm.

    Parameters
    ----------
    base
        ln L of the record.
    hours
        Sidereal time that the data cover.
    base_fits
        Whether the record describes the data.
    least_doubt
        ln L over that of the record above which another unit is told as undecided.
    """
    if not possibilities:
        return []
    alike_below = ALIKE if hours >= LONG_H else ALIKE_IN_HOURS
    best = max(possibilities, key=lambda one: one.log_likelihood)
    gain = best.log_likelihood - base
    if not (base_fits if gain < LEAST_GAIN else best.fits):
        return [Line(one.kind, UNDECIDED, station, NOTHING_FITS) for one in possibilities if one.kind in TELLING]
    if gain < LEAST_GAIN:
        told = [_confirm(station, one, base) for one in possibilities if one.kind in TELLING]
        return [*told, *doubt_unit(station, base, possibilities, least_doubt)]
    near = [one for one in possibilities if best.log_likelihood - one.log_likelihood < alike_below]
    alike = [one for one in near if not any(one.is_chance_of(other) for other in near)]
    alike.sort(key=lambda one: -one.log_likelihood)
    clock = next((one for one in possibilities if one.kind == "clock"), None)
    if clock is not None and {one.kind for one in alike} <= SHIFTS:
        return [_tell_shift(station, clock, [one for one in alike if one is not clock], gain)]
    kinds = tuple(dict.fromkeys(check for one in alike for check in one.checks))
    if len(kinds) > 1:
        words = "; or ".join(describe(one) for one in alike)
        sentence = f"the record is wrong, and these data do not say where: {words}; a sidereal day would"
        return [Line(RECORD, WRONG, station, sentence, log_odds=gain, candidates=kinds)]
    best = alike[0]
    sentence = "; or ".join(describe(one) for one in alike)
    unit = {"clock": "h", "arms": "deg", "arm": "deg", "latitude": "deg"}.get(best.kind, "")
    value = best.value if unit else None
    turns = [(one.value or 0.0) - (best.value or 0.0) for one in alike]
    apart = max(abs((turn + RIGHT_ANGLE) % (2 * RIGHT_ANGLE) - RIGHT_ANGLE) for turn in turns)
    return [
        Line(
            best.check,
            WRONG,
            station,
            sentence,
            dipole=best.dipole,
            log_odds=gain,
            value=value,
            sigma=math.hypot(best.sigma or 0.0, apart) if unit else None,
            unit=unit,
            kind=best.kind,
        )
    ]


def doubt_unit(station: str, base: float, possibilities: Sequence[Possibility], least: float) -> list[Line]:
    """A line on the likeliest other unit where its ln L is that of the record and so much more, else none."""
    units = (one for one in possibilities if one.check == "unit")
    likeliest = max(units, key=lambda one: one.log_likelihood, default=None)
    if likeliest is None or likeliest.log_likelihood - base <= least:
        return []
    sentence = f"perhaps {describe(likeliest)}: antennas on two kinds of cable would tell"
    return [Line("unit", UNDECIDED, station, sentence, log_odds=likeliest.log_likelihood - base)]


def _tell_shift(station: str, clock: Possibility, signs: Sequence[Possibility], gain: float) -> Line:
    """Sidereal time that is off: a clock and a longitude do the same to it, and what would just make this shift."""
    value, sigma = clock.value or 0.0, clock.sigma or 0.0
    known = [(_far(value - (one.value or 0.0), sigma), one.check, describe(one), one.value or 0.0) for one in signs]
    zone = _zone_of(value, sigma)
    if zone:
        rare = _far(value + zone, sigma) - math.log(HOURS)
        known.append((rare, "clock", f"the times are of UTC{zone:+d} instead of UTC", -float(zone)))
    known.sort(key=lambda one: -one[0])
    named = [f"{words} ({60 * shift:+.0f} min)" for _, _, words, shift in known]
    size, of_clock, of_longitude = abs(value), *(("ahead", "east") if value < 0 else ("behind", "west"))
    any_other = f"a clock that is {60 * size:.0f} min {of_clock}, or a longitude that is "
    any_other += f"{HOUR_DEG * size:.1f} deg too far {of_longitude}"
    if size < LEANING_H:
        any_other += f", or masts that all lean to the {'west' if value < 0 else 'east'}"
    sentence = f"{describe(clock)}: {'; or '.join([*named, any_other])}. {WHAT_DECIDES}"
    check = known[0][1] if known else clock.check
    return Line(
        check, WRONG, station, sentence, log_odds=gain, value=value, sigma=clock.sigma, unit="h", kind=clock.kind
    )


def tell_summer(line: Line, summer: Possibility, winter: Possibility) -> Line:
    """The line of a clock, or one of local time with both values, where summer is an hour later."""
    values = [(one.value or 0.0, one.sigma or float("inf")) for one in (summer, winter)]
    half_day, sigma = HOURS / 2, math.hypot(values[0][1], values[1][1])
    apart = (values[0][0] - values[1][0] + half_day) % HOURS - half_day
    if abs(apart + 1.0) > SAME_SIGMAS * sigma or abs(apart) < CONFIRMS_SIGMAS * sigma:
        return line
    each = (f"{60 * value:+.0f} +- {60 * error:.0f} min" for value, error in values)
    sentence = f"sidereal time is {next(each)} in Europe's summer time and {next(each)} else from that of clock and "
    sentence += "longitude on record: local time with summer time?"
    value, sigma = max(values, key=lambda one: abs(one[0]) / one[1])
    return Line(
        "clock", WRONG, line.station, sentence, log_odds=line.log_odds, value=value, sigma=sigma, unit="h",
        kind=SUMMER_TIME, seasons_h=(values[0][0], values[1][0]),
    )  # fmt: skip


def tell_drift(line: Line, before: Possibility, after: Possibility, date: str) -> Line:
    """The line of a clock, or one of a clock that drifts where the two halves of the time, parted at a date, differ.

    Two values must be as much better than one as any possibility than the record: ln L averaged over all that the
    second may be. Its sigma covers both.
    """
    sigma, half_day = math.hypot(before.sigma or 0.0, after.sigma or 0.0), HOURS / 2
    apart = ((after.value or 0.0) - (before.value or 0.0) + half_day) % HOURS - half_day
    gain = math.log((2 * math.pi) ** 0.5 * sigma / HOURS) - _far(apart, sigma)
    if not (before.fits and after.fits) or gain < LEAST_GAIN:
        return line
    first, second = (f"{60 * (one.value or 0.0):+.0f} +- {60 * (one.sigma or 0.0):.0f} min" for one in (before, after))
    sentence = f"sidereal time is {first} before {date} and {second} after from that of clock and longitude on record: "
    sentence += "a clock that drifts or steps, or masts that lean more and more"
    return replace(line, check="clock", sentence=sentence, sigma=math.hypot(line.sigma or 0.0, apart / 2))


def _far(hours: float, sigma: float) -> float:
    """Ln L of a shift that is so far from the one seen."""
    return -0.5 * (hours / sigma) ** 2


def _zone_of(value: float, sigma: float) -> int:
    """Time zone that makes this shift, 0 for none."""
    zone = round(-value)
    return zone if sigma < ZONE_SIGMA_H and abs(value + zone) < max(SAME_H, SAME_SIGMAS * sigma) else 0


def describe(one: Possibility) -> str:
    """Describe a possibility in words."""
    value, sigma = one.value or 0.0, one.sigma or 0.0
    if one.kind == "clock":
        return f"sidereal time is {60 * value:+.0f} +- {60 * sigma:.0f} min from that of clock and longitude on record"
    if one.check == "arms":
        turned = "both arms are" if one.dipole is None else f"the arm of {one.dipole} alone is"
        mixed = "power of X and Y is mixed, or " if len(one.checks) > 1 else ""
        return f"{mixed}{turned} turned by {value:+.0f} +- {sigma:.0f} deg (north through east) from the record"
    return {
        "exchange": "X and Y are exchanged at every antenna, or both arms are turned by 90 deg",
        "latitude": f"the latitude is {value:+.1f} +- {sigma:.1f} deg from the record",
        "latitude sign": "the latitude has the wrong sign",
        "longitude sign": "the longitude has the wrong sign",
        "latitude for longitude": "latitude and longitude are exchanged",
        "dB": "the power is in decibels",
        "volt": "the power is an amplitude (volts), not its square",
    }[one.kind]


def _confirm(station: str, one: Possibility, base: float) -> Line:
    """Whether the data confirm a clock or arms, and how well."""
    value, sigma = one.value or 0.0, one.sigma or float("inf")
    unit = {"clock": "h", "arms": "deg"}[one.kind]
    if not sigma < TELLING[one.kind]:
        return Line(one.kind, UNDECIDED, station, f"these hours do not determine the {one.kind}; a whole day would")
    if abs(value) > CONFIRMS_SIGMAS * sigma:
        sentence = f"not confirmed, and not enough to call it wrong: {describe(one)}"
        return Line(one.kind, UNDECIDED, station, sentence, log_odds=one.log_likelihood - base)
    words = describe(one) if one.kind == "clock" else f"the arms are {value:+.0f} +- {sigma:.0f} deg from the record"
    return Line(
        one.kind, RIGHT, station, words, log_odds=one.log_likelihood - base, value=value, sigma=sigma, unit=unit
    )
