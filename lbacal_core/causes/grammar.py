"""Causes that are plain sentences: a place in the chain, a law along frequency, and a course in time.

The catalogue lists mechanisms that somebody described before. A sentence says what any mechanism of its kind does: *the
gain in front of the receiver changes, alike at all frequencies, in two waves a UTC day*. Place, law and course are data
(names with numbers), so that a report carries a sentence, a model adopts it, and other data are fitted with it.

A form is a name with numbers, as in ``("power", -2.0, 30.0)``; a product of two courses is ``("product", one, other)``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from inspect import signature
from itertools import pairwise, product
from typing import Any

import numpy as np

from lbacal_core.causes.antenna import DipoleSwap
from lbacal_core.causes.cause import BEYOND_SIGMA, RAIN, SCOPES, TEMPERATURE, Cause, Conditions, Template
from lbacal_core.causes.chain import compress
from lbacal_core.causes.sky import NO_DIRECTIONS, SOURCE_KEYS, PointSource, SolarEmission
from lbacal_core.errors import BadInputError
from lbacal_core.foreign import write_instant
from lbacal_core.grids import DAY_S, YEAR_S, Floats
from lbacal_core.instrument.chain import ChainTerms
from lbacal_core.instrument.sidereal import SIDEREAL_DAY_S

SIDEREAL, SOLAR, WEEK, YEAR = "LST", "UTC", "week", "year"
ROTATION, LUNATION = "solar rotation", "lunation"
PERIODS_D = {SOLAR: 1.0, WEEK: 7.0, ROTATION: 27.275, LUNATION: 29.5306, YEAR: 365.25}
"""Periods of clocks that run with UTC, days: the Sun's rotation seen from Earth (Carrington) and the synodic month."""
FEWEST_DAYS = 12
"""Days with events from which a wave of many days is tried: two harmonics and a level have five numbers."""
MONDAY_S = 4 * DAY_S
"""The first Monday of the Unix epoch, which began on a Thursday."""

WEEKDAYS: Sequence[str] = ("Monday", "Tuesday", "Wednesday", "Thursday", "Friday", "Saturday", "Sunday")

Form = tuple[Any, ...]
"""A name with its numbers."""


@dataclass(frozen=True)
class Kind:
    """A kind of law or course.

    Attributes
    ----------
    values
        Its values, from the conditions and its numbers: shape (freq,) or (class, freq) of a law, (event,) of a course.
    grid
        The numbers that a search tries in some data.
    words, equation
        How a sentence says it, and its symbol, with the numbers in braces.
    steps
        Steps of the numbers on that grid, for a finer one; shares of the band where they are MHz, 0 where one stays.
    gates
        Whether it is 0 or 1, so that a product with it says *only when*.
    """

    values: Callable[..., Floats]
    grid: Callable[[Conditions], Sequence[Sequence[Any]]]
    words: str
    equation: str
    steps: Sequence[float] = ()
    gates: bool = False


# Laws along frequency. Each is 1 where it is largest, but for those of the chain's own curves.


def _once(_: Conditions) -> list[tuple[()]]:
    """One form without numbers."""
    return [()]


def _span(conditions: Conditions) -> float:
    """Width of the band, MHz."""
    return float(np.ptp(conditions.frequency_mhz))


def _inside(conditions: Conditions, parts: int) -> list[float]:
    """Frequencies that divide the band into equal parts, MHz."""
    low, high = (float(one) for one in conditions.frequency_mhz[[0, -1]])
    return [float(f"{one:.4g}") for one in np.linspace(low, high, parts + 1)[1:-1]]


def _widths(conditions: Conditions, share: float) -> float:
    """A share of the band, MHz."""
    return float(f"{share * _span(conditions):.3g}")


def _indices(conditions: Conditions) -> list[tuple[float, float]]:
    low, high = (float(one) for one in conditions.frequency_mhz[[0, -1]])
    return [(index, low if index < 0 else high) for index in (-4.0, -3.0, -2.0, -1.0, 1.0, 2.0, 3.0)]


def _along_band(conditions: Conditions) -> Floats:
    """-1 to 1 over the band, linear in ln nu."""
    log = np.log(conditions.frequency_mhz)
    return np.asarray(2.0 * (log - log[0]) / (log[-1] - log[0]) - 1.0)


def _slope_of(curve: Floats, conditions: Conditions) -> Floats:
    """Logarithmic derivative of a curve, 1/MHz."""
    return np.asarray(np.gradient(np.log(curve), conditions.frequency_mhz))


def _edge(away_mhz: Floats, width_mhz: float) -> Floats:
    return np.asarray(0.5 - 0.5 * np.tanh(0.5 * away_mhz / width_mhz))


CURVE, SERIES = "curve", "series"
"""The law and the course whose numbers are estimated all together, where no other describes the data as well."""
CHANNELS = "channels"
"""The law of interference: the frequency of each channel that it has, MHz, with its value there."""


def _never(_: Conditions) -> list[tuple[()]]:
    """No form: a search does not try it, it estimates its numbers."""
    return []


def _polynomials(conditions: Conditions, number: int) -> Floats:
    """Legendre polynomials in ln nu over the band, shape (polynomial, freq)."""
    return np.asarray(np.polynomial.legendre.legvander(_along_band(conditions), number - 1).T)


def _scaled(functions: Floats, numbers: Sequence[float]) -> Floats:
    """A sum of functions over its largest value."""
    values = np.asarray(numbers, dtype=float) @ functions
    return np.asarray(values / max(float(np.abs(values).max()), 1e-300))


def channels_of(conditions: Conditions, at_mhz: Sequence[float]) -> Floats:
    """1 in the channel nearest to each frequency, else 0, shape (frequency, freq); 0 outside the band."""
    frequency = conditions.frequency_mhz
    away = np.abs(frequency - np.asarray(at_mhz, dtype=float)[:, None])
    width = np.abs(np.gradient(frequency))
    return np.asarray((np.arange(frequency.size) == away.argmin(axis=1)[:, None]) & (away <= 0.5 * width + 1e-6), float)


EDGE = 0.03
"""Share of the band within which a law ends at an edge: filters of the field fall within some MHz of 50."""

RIPPLES = np.arange(2.0, 20.5, 1.5).tolist()
"""Periods of a ripple along the band. One half way between two of them shows 0.3 of itself in each, the sinc of 3/4."""

LAWS: dict[str, Kind] = {
    "flat": Kind(lambda c: np.ones(c.frequency_mhz.size), _once, "alike at all frequencies", "1"),
    "power": Kind(
        lambda c, index, at: (c.frequency_mhz / at) ** index,
        _indices,
        "as frequency to the power {0:g} (size at {1:g} MHz)",
        "(nu / {1:g} MHz)^{0:g}",
        (1.0, 0.0),
    ),
    "bow": Kind(lambda c: 1.5 * _along_band(c) ** 2 - 0.5, _once, "bowed along the band", "P2(ln nu)"),
    "tilt": Kind(_along_band, _once, "tilted along the band", "P1(ln nu)"),
    "band": Kind(
        lambda c, middle, width, power: np.exp(-0.5 * (np.abs(c.frequency_mhz - middle) / (0.5 * width)) ** power),
        lambda c: [
            *product(_inside(c, 12), (_widths(c, 0.1),), (4, 2)),
            *product(_inside(c, 6), (_widths(c, 0.24),), (4, 2)),
        ],
        "in {1:g} MHz about {0:g} MHz",
        "exp(-|nu - {0:g} MHz|^{2:g} / 2 ({1:g} MHz / 2)^{2:g})",
        (1 / 12, 1 / 12, 0.0),
    ),
    "below": Kind(
        lambda c, edge, width: _edge(c.frequency_mhz - edge, width),
        lambda c: list(product(_inside(c, 8), (_widths(c, EDGE),))),
        "below {0:g} MHz",
        "1 / (1 + exp((nu - {0:g} MHz) / {1:g} MHz))",
        (1 / 8, EDGE),
    ),
    "above": Kind(
        lambda c, edge, width: _edge(edge - c.frequency_mhz, width),
        lambda c: list(product(_inside(c, 8), (_widths(c, EDGE),))),
        "above {0:g} MHz",
        "1 / (1 + exp(({0:g} MHz - nu) / {1:g} MHz))",
        (1 / 8, EDGE),
    ),
    "ripple": Kind(
        lambda c, delay_us, turns: np.cos(2.0 * np.pi * (delay_us * c.frequency_mhz - turns)),
        lambda c: list(product((float(f"{one / _span(c):.3g}") for one in RIPPLES), (0.0, 0.25))),
        "as a ripple with a delay of {0:g} µs",
        "cos 2 pi ({0:g} µs nu - {1:g})",
        (0.03, 0.25),
    ),
    "resonance": Kind(
        lambda c: _slope_of(c.antenna_gain, c),
        _once,
        "as the antenna's resonance moves (size per MHz)",
        "d ln G_ant / d nu",
    ),
    "filter": Kind(
        lambda c: _slope_of(c.receiver_gain, c),
        _once,
        "as the receiver's filter moves (size per MHz)",
        "d ln G_RCU / d nu",
    ),
    "cable": Kind(lambda c: c.cable_log_loss, _once, "as if the cable's loss in dB grew by this share", "ln L_coax"),
    CURVE: Kind(
        lambda c, *numbers: _scaled(_polynomials(c, len(numbers)), numbers),
        _never,
        "along a curve that is estimated",
        "",
    ),
    CHANNELS: Kind(
        lambda c, *numbers: np.asarray(numbers[1::2], dtype=float) @ channels_of(c, numbers[::2]),
        _never,
        "as interference in single channels, at {at_mhz} MHz",
        "",
    ),
}
"""Laws along frequency by name."""


# Courses in time.


def _phase(conditions: Conditions, clock: str) -> Floats:
    """Turns of a clock at each event, shape (event,)."""
    if clock == SIDEREAL:
        return np.asarray(conditions.lst_hours / 24.0)
    since = conditions.time_unix - (MONDAY_S if clock == WEEK else 0.0)
    return np.asarray(since / (PERIODS_D[clock] * DAY_S))


def _wave(conditions: Conditions, clock: str, number: float, highest: float) -> Floats:
    return np.asarray(np.cos(2.0 * np.pi * number * (_phase(conditions, clock) - highest)))


def harmonics(turns: Floats, number: int) -> Floats:
    """Cosines and sines of the first harmonics of a phase in turns, shape (2 number, event)."""
    angles = 2.0 * np.pi * np.arange(1, number + 1)[:, None] * turns
    return np.stack([np.cos(angles), np.sin(angles)], axis=1).reshape(2 * number, -1)


MOST_CYCLES, CYCLES_PER_STEP = 40.0, 0.5
"""Cycles in the data up to which a free period is tried, and how many of them lie between two periods: half way between
two a wave keeps 0.9 of itself, the sinc of 1/4."""


def _days_of(conditions: Conditions) -> tuple[float, float]:
    """Length and middle of the data, days since 1970."""
    return float(np.ptp(conditions.time_unix)) / DAY_S, float(np.mean(conditions.time_unix)) / DAY_S


def _cycle(conditions: Conditions, days: float, highest: float) -> Floats:
    return np.asarray(np.cos(2.0 * np.pi * (conditions.time_unix / (days * DAY_S) - highest)))


def _cycles(conditions: Conditions) -> list[tuple[float, float]]:
    """Free periods, from two and a half cycles on: those of clocks, and of the whole, are waves."""
    if not conditions.has_dates or np.unique(conditions.time_unix // DAY_S).size < FEWEST_DAYS:
        return []
    span_d, middle_d = _days_of(conditions)
    periods = [float(f"{span_d / k:.6g}") for k in np.arange(2.5, MOST_CYCLES, CYCLES_PER_STEP)]
    return [(days, float(f"{(middle_d / days + phase / 6.0) % 1.0:.4g}")) for days in periods for phase in range(3)]


HOURS = np.arange(0.0, 1.0, 1 / 240)
"""Phases over which a series is largest somewhere, turns."""


def _series(conditions: Conditions, clock: str, *numbers: float) -> Floats:
    """Fourier series over its largest value, the numbers those of cos and sin of each harmonic."""
    number = len(numbers) // 2
    whole = np.asarray(numbers) @ harmonics(HOURS, number)
    values = np.asarray(numbers) @ harmonics(_phase(conditions, clock), number)
    return np.asarray(values / max(float(np.abs(whole).max()), 1e-300))


def _near(conditions: Conditions, clock: str, middle: float, width: float) -> Floats:
    away = (_phase(conditions, clock) - middle + 0.5) % 1.0 - 0.5
    return np.asarray(np.exp(-0.5 * (away / width) ** 2))


def _clocks(conditions: Conditions) -> list[str]:
    """Clocks that a search tries: of those with long periods only what many days show twice, and a year as a whole."""
    span_d = float(np.ptp(conditions.time_unix)) / DAY_S
    most = np.inf if np.unique(conditions.time_unix // DAY_S).size >= FEWEST_DAYS else 1.0
    clocks = {name: days for name, days in PERIODS_D.items() if days <= most}
    return [SIDEREAL, *(name for name, days in clocks.items() if span_d > (0.8 if name == YEAR else 2.0) * days)]


def _waves(conditions: Conditions) -> list[tuple[str, int, float]]:
    most = {SIDEREAL: 3, SOLAR: 3, WEEK: 2, YEAR: 2}
    return [
        (clock, number, phase / (12.0 * number))
        for clock in _clocks(conditions)
        for number in range(1, most.get(clock, 1) + 1)
        for phase in range(6)
    ]


def _spells(conditions: Conditions) -> list[tuple[str, float, float]]:
    middles = [k / 12.0 for k in range(12)]
    return [one for clock in _clocks(conditions) for one in product((clock,), middles, (0.04, 0.1))]


def _columns(conditions: Conditions) -> list[str]:
    return sorted(name for name in conditions.covariates if name != RAIN and conditions.covariate(name) is not None)


def _quantiles(conditions: Conditions, name: str) -> tuple[list[float], float]:
    """Quantiles of a column, and half of the range of most of its values."""
    known = conditions.covariates[name][np.isfinite(conditions.covariates[name])]
    low, *inner, high = np.quantile(known, [0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.95]).tolist()
    return [float(f"{one:.3g}") for one in inner], float(f"{max(0.5 * (high - low), 1e-9):.3g}")


def _powers(conditions: Conditions) -> list[tuple[str, int, float, float]]:
    found = []
    for name in _columns(conditions):
        middles, half = _quantiles(conditions, name)
        found += [(name, 1, middles[2], half), *((name, 2, middle, half) for middle in middles)]
    return found


def _column(conditions: Conditions, name: str, power: float, middle: float, scale: float) -> Floats:
    return np.asarray(np.nan_to_num((conditions.covariates[name] - middle) / scale) ** power)


def _sky(conditions: Conditions, low_mhz: float, high_mhz: float) -> Floats:
    """Simulated power of the sky in a band over its mean, less 1.

    Raises
    ------
    BadInputError
        Where no channel lies in the band.
    """
    frequency = conditions.frequency_mhz
    inside = (frequency >= low_mhz) & (frequency <= high_mhz)
    if not inside.any():
        found = f"{low_mhz:g}-{high_mhz:g} MHz"
        raise BadInputError("sentence: sky", "a band in which these data have a channel", found)
    power = np.mean([sky[:, inside].mean(axis=1) for sky in conditions.sky_of.values()], axis=0)
    return np.asarray(power / power.mean() - 1.0)


def _contrast(conditions: Conditions) -> Floats:
    """Difference of the simulated power of the sky in the first polarisation and in the others over its mean."""
    first, *others = (conditions.sky_of[letter].mean(axis=1) for letter in sorted(conditions.sky_of))
    power = np.mean([first, *others], axis=0)
    return np.asarray((first - np.mean(others, axis=0)) / power.mean())


def _bands(conditions: Conditions) -> list[tuple[float, float]]:
    """The whole band and its fifths, where they hold a channel."""
    frequency = conditions.frequency_mhz
    edges = np.linspace(frequency[0], frequency[-1], 6).round(6).tolist()
    parts = [(edges[0], edges[-1]), *pairwise(edges)]
    return [(low, high) for low, high in parts if np.any((frequency >= low) & (frequency <= high))]


def _where_days(conditions: Conditions) -> list[tuple[()]]:
    return [()] if conditions.has_day_and_night else []


def _where_weeks(conditions: Conditions) -> list[tuple[()]]:
    return [()] if WEEK in _clocks(conditions) else []


def _levels(conditions: Conditions, form: Form) -> list[float]:
    """Levels about that of a course above or below one: between the quantiles beside it."""
    if form[0] not in ("over", "under"):
        return []
    known = conditions.covariates[form[1]][np.isfinite(conditions.covariates[form[1]])]
    at = float(np.mean(known < form[2]))
    return [float(f"{one:.4g}") for one in np.quantile(known, np.clip(at + np.linspace(-0.12, 0.12, 9), 0.0, 1.0))]


def _rank(conditions: Conditions) -> Floats:
    return np.asarray(np.argsort(np.argsort(conditions.time_unix, kind="stable"), kind="stable"))


def _unix(instant: str) -> float:
    at = datetime.fromisoformat(instant)
    return (at if at.tzinfo else at.replace(tzinfo=UTC)).timestamp()


COURSES: dict[str, Kind] = {
    "always": Kind(lambda c: np.ones(c.time_unix.size), _once, "at all times", "1"),
    "step": Kind(
        lambda c, at: c.after(_unix(at))[:, 0],
        lambda c: [(write_instant(at),) for at in c.step_dates(40)] if c.has_dates else [],
        "from {0} on",
        "step(t - {0})",
        gates=True,
    ),
    "between": Kind(
        lambda c, begin, days: c.after(_unix(begin))[:, 0] - c.after(_unix(begin) + days * DAY_S)[:, 0],
        lambda c: (
            [(write_instant(at), days) for days in (10, 20, 30, 45, 65, 90) for at in c.step_dates(36)]
            if c.has_dates
            else []
        ),
        "for {1:g} days from {0} on",
        "({0} <= t < {0} + {1:g} d)",
        (0.0, 20.0),
        gates=True,
    ),
    "ramp": Kind(
        lambda c, middle: (c.time_unix - _unix(middle)) / YEAR_S,
        lambda c: [(write_instant(c.time_unix.mean()),)] if c.has_dates else [],
        "linearly with time (size per year)",
        "(t - {0}) / yr",
    ),
    "since": Kind(
        lambda c, at: np.maximum(c.time_unix - _unix(at), 0.0) / YEAR_S,
        lambda c: [(write_instant(at),) for at in c.step_dates(40)] if c.has_dates else [],
        "linearly with time from {0} on (size per year)",
        "max(t - {0}, 0) / yr",
    ),
    "wave": Kind(_wave, _waves, "", "cos 2 pi {1:g} ({0} - {2:.3g})", (0.0, 0.0, 1 / 12)),
    "cycle": Kind(_cycle, _cycles, "", "cos 2 pi (t / {0:g} d - {1:.3g})", (CYCLES_PER_STEP, 1 / 6)),
    SERIES: Kind(_series, _never, "", ""),
    "near": Kind(_near, _spells, "", "exp(-({0} - {1:.3g})^2 / 2 {2:.2g}^2)", (0.0, 1 / 12, 0.06)),
    "hours": Kind(
        lambda c, begin, hours: c.in_hours(begin, (begin + hours) % 24.0)[:, 0],
        lambda c: list(product(np.arange(0.0, 24.0, 1.5).tolist(), (3.0, 6.0, 9.0, 12.0))) if c.has_all_hours else [],
        "for {1:g} h from {0:g} h UTC on",
        "gate(UTC; {0:g} h, {1:g} h)",
        (3.0, 2.0),
        gates=True,
    ),
    "day": Kind(lambda c: (c.sun_altitude > 0).astype(float), _where_days, "while the Sun is up", "day", gates=True),
    "night": Kind(
        lambda c: (c.sun_altitude <= 0).astype(float), _where_days, "while the Sun is down", "night", gates=True
    ),
    "sun": Kind(
        lambda c: np.maximum(np.sin(c.sun_altitude), 0.0),
        _where_days,
        "with the height of the Sun",
        "sin(height of the Sun)",
    ),
    "high sun": Kind(
        lambda c: np.maximum(np.sin(c.sun_altitude), 0.0) ** 2,
        _where_days,
        "with the square of the height of the Sun, as a dipole hears it",
        "sin^2(height of the Sun)",
    ),
    "working days": Kind(
        lambda c: (_phase(c, WEEK) % 1.0 < 5 / 7).astype(float),
        _where_weeks,
        "from Monday to Friday",
        "Monday-Friday",
        gates=True,
    ),
    "weekend": Kind(
        lambda c: (_phase(c, WEEK) % 1.0 >= 5 / 7).astype(float),
        _where_weeks,
        "on Saturdays and Sundays",
        "Saturday-Sunday",
        gates=True,
    ),
    "weekday": Kind(
        lambda c, name: (7.0 * _phase(c, WEEK) // 1.0 % 7.0 == WEEKDAYS.index(name)).astype(float),
        lambda c: list(product(WEEKDAYS)) if _where_weeks(c) else [],
        "on {0}s",
        "{0}",
        gates=True,
    ),
    "column": Kind(_column, _powers, "with ({0} - {2:g})^{1:g}", "(({0} - {2:g}) / {3:g})^{1:g}", (0, 0, 0.2, 0)),
    "over": Kind(
        lambda c, name, level: (np.nan_to_num(c.covariates[name], nan=-np.inf) > level).astype(float),
        lambda c: [(name, one) for name in _columns(c) for one in _quantiles(c, name)[0]],
        "where {0} exceeds {1:g}",
        "({0} > {1:g})",
        gates=True,
    ),
    "under": Kind(
        lambda c, name, level: (np.nan_to_num(c.covariates[name], nan=np.inf) < level).astype(float),
        lambda c: [(name, one) for name in _columns(c) for one in _quantiles(c, name)[0]],
        "where {0} is below {1:g}",
        "({0} < {1:g})",
        gates=True,
    ),
    "late": Kind(
        lambda c, hours: c.warmth(hours)[:, 0],
        lambda c: [] if c.covariate(TEMPERATURE) is None or not c.has_dates else [(1.0,), (2.0,), (3.0,)],
        "with the temperature {0:g} h before (size per 10 K)",
        "T(t - {0:g} h) / 10 K",
        (1.0,),
    ),
    "wet": Kind(
        lambda c, kind: c.wetness(kind)[:, 0],
        lambda c: [] if c.covariate(RAIN) is None else [("flag",), ("saturating",), ("linear",)],
        "in rain ({0})",
        "rain({0})",
        gates=True,
    ),
    "sky": Kind(
        _sky, _bands, "with the power of the sky between {0:g} and {1:g} MHz", "P_sky({0:g}-{1:g} MHz) / mean - 1"
    ),
    "contrast": Kind(
        _contrast,
        lambda c: [()] if len(c.sky_of) > 1 else [],
        "with the difference between the polarisations in the power of the sky",
        "(P_sky,1 - P_sky,2) / mean",
    ),
    "every": Kind(
        lambda c, number, first: (_rank(c) % number == first).astype(float),
        lambda _: [(number, first) for number in range(2, 8) for first in range(number)],
        "in every event of {0}, number {1}",
        "(event mod {0} = {1})",
        gates=True,
    ),
}
"""Courses in time by name."""
PRODUCT = "product"


def law_of(conditions: Conditions, law: Form) -> Floats:
    """Values of a law, shape (class or 1, 1, freq)."""
    values = np.atleast_2d(LAWS[law[0]].values(conditions, *law[1:]))
    return np.asarray(values[:, None, :])


def size_at_mhz(conditions: Conditions, template: Template) -> float | None:
    """The frequency at which the size of a sentence holds; None where it holds at all, or as a curve of the chain."""
    law = parts_of(template)[1]
    if law[0] in ("flat", "resonance", "filter", "cable"):
        return None
    return float(conditions.frequency_mhz[int(np.argmax(law_of(conditions, law)[0, 0]))])


def course_of(conditions: Conditions, course: Form) -> Floats:
    """Values of a course, shape (event,)."""
    if course[0] == PRODUCT:
        return course_of(conditions, course[1]) * course_of(conditions, course[2])
    return COURSES[course[0]].values(conditions, *course[1:])


def columns_of(course: Form) -> tuple[str, ...]:
    """Columns of `env` that a course reads."""
    if course[0] == PRODUCT:
        return tuple(sorted({*columns_of(course[1]), *columns_of(course[2])}))
    return {
        "late": (TEMPERATURE,),
        "wet": (RAIN,),
        "column": course[1:2],
        "over": course[1:2],
        "under": course[1:2],
    }.get(course[0], ())


def axis_of(course: Form) -> str:
    """Name of the axis, or of the column, along which a course varies most; of a product its first."""
    name, *numbers = course
    if name == PRODUCT:
        return axis_of(numbers[0])
    if name in ("column", "over", "under"):
        return str(numbers[0])
    periods = {SIDEREAL: "lst", SOLAR: "utc", WEEK: 7, ROTATION: 27.3, LUNATION: 29.53}
    by_name = {"working days": 7, "weekend": 7, "weekday": 7, "late": TEMPERATURE, "wet": RAIN, "always": "lst"}
    by_name |= dict.fromkeys(("sky", "contrast"), "lst")
    by_name |= dict.fromkeys(("hours", "day", "night", "sun", "high sun"), "utc")
    found = periods.get(numbers[0], "date") if name in ("wave", "near", SERIES) else by_name.get(name, "date")
    return found if isinstance(found, str) else f"date, period {found:g} d"


def rough_laws(conditions: Conditions) -> list[Form]:
    """Laws with which all courses are tried first; those by which sentences are noticed come first."""
    low, high = (float(one) for one in conditions.frequency_mhz[[0, -1]])
    at = _inside(conditions, 5)
    wide, edge = _widths(conditions, 0.24), _widths(conditions, EDGE)
    noticed: list[Form] = [("flat",), ("power", -2.0, low), ("power", 2.0, high), ("below", at[0], edge)]
    noticed.append(("band", at[2], wide, 2))
    return [*noticed, ("tilt",), ("band", at[1], wide, 2), ("resonance",), ("filter",)]


def list_laws(conditions: Conditions) -> list[Form]:
    """Every law that a search of these data tries."""
    return [(name, *numbers) for name, kind in LAWS.items() for numbers in kind.grid(conditions)]


def list_courses(conditions: Conditions) -> list[Form]:
    """Every course that a search of these data tries."""
    return [(name, *numbers) for name, kind in COURSES.items() for numbers in kind.grid(conditions)]


def smooth_along_band(conditions: Conditions) -> list[tuple[Form, Floats, Sequence[int]]]:
    """Laws whose numbers are estimated: how they begin, functions, (function, freq), and how many of them one tries."""
    return [((CURVE,), _polynomials(conditions, 7), (3, 4, 5, 7))]


def smooth_in_time(conditions: Conditions) -> list[tuple[Form, Floats, Sequence[int]]]:
    """Courses whose numbers are estimated, as `smooth_along_band`: harmonics of clocks."""
    can = {SIDEREAL, YEAR, *([SOLAR] if conditions.has_all_hours else [])}
    clocks = [one for one in _clocks(conditions) if one in can]
    return [((SERIES, clock), harmonics(_phase(conditions, clock), 4), (4, 6, 8)) for clock in clocks]


FINER = (-0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75)
"""Parts of a step of the grid by which a number is moved on a finer one."""


IN_MHZ = ("band", "below", "above")
"""Laws whose numbers are frequencies."""
DATED = ("step", "since", "between")
"""Courses that begin at a date."""


def finer(kinds: Mapping[str, Kind], form: Form, conditions: Conditions, share: float = 1.0) -> list[Form]:
    """Forms about one that was found, itself the first, whose numbers differ by parts of this share of a step."""
    if form[0] == PRODUCT:
        _, one, other = form
        first, second = (finer(kinds, own, conditions, share) for own in (one, other))
        return [*((PRODUCT, same, other) for same in first), *((PRODUCT, one, same) for same in second[1:])]
    moved: list[Form] = []
    if form[0] in DATED:  # in the middle of a gap between events: an effect begins anywhere in it
        gaps = pairwise(conditions.dates_about(_unix(form[1])))
        moved += [(form[0], write_instant(sum(pair) / 2.0), *form[2:]) for pair in gaps]
    moved += [(*form[:2], level) for level in _levels(conditions, form)]
    unit = _span(conditions) if form[0] in IN_MHZ else form[4] if form[0] == "column" else 1.0
    for k, step in enumerate(kinds[form[0]].steps, start=1):
        own = form[1] ** 2 / _days_of(conditions)[0] if (form[0], k) == ("cycle", 1) else unit
        for part in FINER if step else ():
            value = form[k] + part * share * step * own / (form[2] if form[0] == "wave" else 1.0)
            moved.append((*form[:k], float(f"{value:.10g}"), *form[k + 1 :]))
    if form[0] in ("between", "hours"):  # beginning and length together: one number undoes what another does
        moved = [(form[0], *both) for both in product(*(dict.fromkeys(one[k] for one in moved) for k in (1, 2)))]
    low, high = conditions.frequency_mhz[[0, -1]]
    if form[0] == "ripple":  # the phase in the middle of the band stays likewise
        middle = 0.5 * (low + high)
        moved = [(*one[:2], float(f"{(one[2] + (one[1] - form[1]) * middle) % 1.0:.10g}")) for one in moved]
    if form[0] == "cycle":  # and so does that in the middle of the data
        middle = _days_of(conditions)[1]
        moved = [(*one[:2], float(f"{(one[2] + middle / one[1] - middle / form[1]) % 1.0:.10g}")) for one in moved]
    return [form, *(one for one in dict.fromkeys(moved) if one != form and _is_sensible(one, low, high))]


def _is_sensible(form: Form, low_mhz: float, high_mhz: float) -> bool:
    if form[0] in ("below", "above"):
        return bool(form[2] > 0 and low_mhz + 2 * form[2] < form[1] < high_mhz - 2 * form[2])
    positive = {"band": 2, "near": 3, "hours": 2, "ripple": 1, "between": 2, "late": 1, "cycle": 1}
    return form[:2] != ("power", 0.0) and (form[0] not in positive or form[positive[form[0]]] > 0)


def is_of_dates(course: Sequence[Any]) -> bool:
    """Whether a course is one of dates or of the number of an event, which do not recur, or of the season."""
    if course[0] == PRODUCT:
        return is_of_dates(course[1]) or is_of_dates(course[2])
    return course[0] in (*DATED, "ramp", "every") or (course[0] in ("wave", "near", SERIES) and course[1] == YEAR)


# Places in the chain. What each does is linear in the change, shape (class or 1, event, freq).


Act = Callable[[ChainTerms, Conditions, Floats], ChainTerms]
RATE_H = 0.05
"""Step of the difference by which the rate of P_sky along LST is taken, h."""


def _scale(*names: str) -> Act:
    """Multiply terms of the chain by 1 + change."""
    return lambda terms, _, change: replace(terms, **{name: getattr(terms, name) * (1.0 + change) for name in names})


def _add_to_sky(terms: ChainTerms, conditions: Conditions, change: Floats) -> ChainTerms:
    """Add power in front of the first amplifier, in units of the mean sky power."""
    return replace(terms, n_lna=terms.n_lna + change * conditions.mean_sky[:, None, :])


def _scale_apart(terms: ChainTerms, conditions: Conditions, change: Floats) -> ChainTerms:
    """Multiply the sky by 1 + change in the first polarisation and by 1 - change in any other."""
    is_first = np.array(conditions.dipoles) == min(conditions.sky_of)
    return replace(terms, sky=terms.sky * (1.0 + change * np.where(is_first, 1.0, -1.0)[:, None, None]))


def _move_in_time(terms: ChainTerms, conditions: Conditions, change: Floats) -> ChainTerms:
    """Take the sky of a later sidereal time, by hours to first order."""
    earlier, later = (conditions.later(terms.sky, np.array([hours])) for hours in (-RATE_H, RATE_H))
    return replace(terms, sky=terms.sky + change * (later - earlier) / (2.0 * RATE_H))


def _add_from_sun(terms: ChainTerms, conditions: Conditions, change: Floats) -> ChainTerms:
    """Add power of the Sun through the antenna's pattern, in units of the mean sky power at 55 MHz."""
    if conditions.sun_response is None:
        raise BadInputError("sentence: Sun", "channels that an antenna model covers", NO_DIRECTIONS)
    return replace(terms, sky=terms.sky + change * conditions.sky_at_55[:, None, None] * conditions.sun_response)


def _knows(name: str, conditions: Conditions) -> bool:
    """Whether the own sky and antenna model say how a source is received."""
    return name in conditions.sky_ratio


def _vary_source(name: str) -> Act:
    """Multiply the power of a source by 1 + change."""

    def act(terms: ChainTerms, conditions: Conditions, change: Floats) -> ChainTerms:
        if not _knows(name, conditions):
            raise BadInputError(f"sentence: {name}", "channels that sky and antenna models cover", NO_DIRECTIONS)
        return replace(terms, sky=terms.sky * conditions.sky_ratio[name](change))

    return act


@dataclass(frozen=True)
class Place:
    """A place in the chain.

    Attributes
    ----------
    act
        What a change there does to the terms of the chain.
    words, equation
        What happens there, and what it does to eq. full_chain, the change in braces.
    confirm
        How other means could tell it from other places.
    moves
        Whether it changes from event to event by itself, so that its course says no more than when it acts.
    needs_both
        Whether one polarisation alone does not tell it from another place.
    is_there
        Whether some data can show it.
    ends
        The least and the largest change that are physical.
    """

    act: Act
    words: str
    equation: str
    confirm: str
    moves: bool = False
    needs_both: bool = False
    is_there: Callable[[Conditions], bool] = lambda _: True
    ends: tuple[float, float] = (-np.inf, np.inf)


DOWN_TO_NOTHING = (-1.0, np.inf)
"""Changes of a gain, a noise or a power, none of which is negative."""

PLACES: dict[str, Place] = {
    "sky": Place(
        _scale("sky"),
        "the power of the sky changes",
        "P_sky -> P_sky (1 + {0})",
        "compare with a station elsewhere",
        ends=DOWN_TO_NOTHING,
    ),
    "antenna": Place(
        _add_to_sky,
        "power is added in front of the first amplifier (size over the mean sky power)",
        "N_LNA -> N_LNA + mean(P_sky) {0}",
        "put a dummy load in the place of an antenna: noise of the amplifier stays, what comes through the air goes",
    ),
    "front": Place(
        _scale("front"),
        "the gain in front of the receiver's noise changes",
        "G_ant A L_coax -> G_ant A L_coax (1 + {0})",
        "feed a tone into the cable of an antenna, and another into its receiver",
        ends=DOWN_TO_NOTHING,
    ),
    "receiver": Place(
        _scale("receiver_noise"),
        "the noise of the receiver changes",
        "N_RCU -> N_RCU (1 + {0})",
        "terminate the input of a receiver and watch its noise",
        ends=DOWN_TO_NOTHING,
    ),
    "behind": Place(
        _scale("front", "receiver_noise"),
        "the gain of the receiver changes",
        "G_RCU -> G_RCU (1 + {0})",
        "feed a tone into a receiver and watch it through the same course",
        ends=DOWN_TO_NOTHING,
    ),
    "converter": Place(
        _scale("adc_noise"),
        "the noise of the converter changes",
        "N_ADC -> N_ADC (1 + {0})",
        "switch the receivers off and watch what the converter counts",
        ends=DOWN_TO_NOTHING,
    ),
    "record": Place(
        _scale("front", "receiver_noise", "adc_noise"),
        "all of the recorded power changes",
        "P -> P (1 + {0})",
        "look for a change of the scaling in the digital processing",
        ends=DOWN_TO_NOTHING,
    ),
    "polarisation": Place(
        _scale_apart,
        "the power of the sky changes by opposite amounts in the polarisations (size of the first)",
        "P_sky -> P_sky (1 ± {0}), + in the first polarisation",
        "survey the azimuths of the arms, and follow the cable of each dipole to its receiver",
        needs_both=True,
        ends=(-1.0, 1.0),
    ),
    "letters": Place(
        lambda terms, c, change: DipoleSwap().act(terms, c, Template(), change),
        f"{DipoleSwap.meaning} ({DipoleSwap.unit})",
        "P_X -> P_X + (P_Y - P_X) {0}",
        DipoleSwap.confirm,
        needs_both=True,
        is_there=lambda c: bool(c.dipole_pairs),
    ),
    "time": Place(
        _move_in_time,
        "the sky is that of a later sidereal time, or the antenna leans to the east (size in hours)",
        "P_sky -> P_sky + dP_sky/dLST {0}",
        "compare the transit of a bright source in interferometric data with its right ascension",
        moves=True,
    ),
    "level": Place(
        lambda terms, c, change: compress(terms, c, -change),
        "the gain of the receiver changes with the total power at the converter (size where that is twice its mean)",
        "G_RCU -> G_RCU (1 + {0} (power at the converter / its mean - 1))",
        "insert an attenuator and look whether the ratio of strong to weak sky changes",
        moves=True,
    ),
    "Sun": Place(
        _add_from_sun,
        "power of the Sun is added (size over the mean sky power at 55 MHz, Sun overhead)",
        "P_sky -> P_sky + P_sky(55 MHz) D(Sun) {0}",
        SolarEmission().confirm,
        moves=True,
        is_there=lambda c: c.sun_response is not None and c.has_day_and_night,
    ),
    **{
        source: Place(
            _vary_source(source),
            f"the power of {source} changes (size over its flux)",
            f"P_sky -> P_sky + P({source}) {{0}}",
            PointSource().confirm,
            moves=True,
            is_there=partial(_knows, source),
        )
        for source in SOURCE_KEYS
    },
}
"""Places in the chain by name, from the sky to the record; those that act by polarisation, time, and power; sources."""


@dataclass(frozen=True)
class Sentence(Cause):
    """A place, a law and a course, as the parameters of its template; its size is a fraction where both are 1.

    Attributes
    ----------
    share_of_step
        Share of a step of the grid about which finer templates lie.
    by_channel
        Whether all of its templates are of one place, in single channels: they are then scored together.
    """

    identifier: str = "sentence"
    unit: str = "fraction"
    meaning: str = "a plain sentence of place, law and course"
    confirm: str = "look for what follows this course at this place"
    scopes: Sequence[str] = SCOPES
    spectral_parameters: Sequence[str] = ("place", "law")
    share_of_step: float = 1.0
    by_channel: bool = False

    def factor(self, conditions: Conditions, template: Template) -> Floats | None:
        """Its law, where its templates are of single channels, shape (freq,)."""
        return law_of(conditions, parts_of(template)[1])[0, 0] if self.by_channel else None

    def flat(self, template: Template) -> Template:
        """The same alike at all frequencies."""
        place, _, course = parts_of(template)
        return sentence(place, ("flat",), course)

    def templates(self, conditions: Conditions) -> list[Template]:  # noqa: ARG002
        """None by itself: a scan of the catalogue does not try it."""
        return []

    def covariates(self, template: Template) -> Sequence[str]:
        """The columns that its course reads."""
        return columns_of(_as_form(template.parameters["course"]))

    def time_profile(self, conditions: Conditions, template: Template) -> Floats:
        """Its course, shape (event, 1)."""
        return course_of(conditions, _as_form(template.parameters["course"]))[:, None]

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:
        """Its place changes by the amount times its law."""
        change = amount * law_of(conditions, _as_form(template.parameters["law"]))
        return PLACES[template.parameters["place"]].act(terms, conditions, change)

    def is_physical(
        self, conditions: Conditions, template: Template, size: float, sigma: float, *, is_first_order: bool = False
    ) -> bool:
        """Whether what it describes stays physical in all of the data; the error may have carried the size beyond.

        A size to first order is relative to chains that took up the mean of the change.
        """
        place, law, course = parts_of(template)
        in_time = course_of(conditions, course)
        least = np.sign(size) * max(abs(size) - BEYOND_SIGMA * sigma, 0.0)
        change = least * np.outer(in_time - is_first_order * in_time.mean(), law_of(conditions, law))
        lowest, highest = PLACES[place].ends
        return bool(change.min() >= lowest and change.max() <= highest)

    def split_factor(self, conditions: Conditions, template: Template) -> tuple[Template, Floats]:
        """The same place alike at all frequencies, and the law, shape (freq,).

        The recorded power is linear in what a place changes.
        """
        place, law, course = parts_of(template)
        return sentence(place, ("flat",), course), law_of(conditions, law)

    def finer_templates(self, conditions: Conditions, template: Template) -> list[Template]:
        """Other numbers of its law, and of its course."""
        place, law, course = parts_of(template)
        laws, courses = (
            finer(kinds, form, conditions, self.share_of_step) for kinds, form in ((LAWS, law), (COURSES, course))
        )
        return [sentence(place, one, course) for one in laws] + [sentence(place, law, one) for one in courses[1:]]

    def say(self, template: Template) -> str:
        """The sentence itself."""
        return in_words(template)

    def is_another(self, template: Template, earlier: Template) -> bool:
        """Whether the sentences differ."""
        return parts_of(template) != parts_of(earlier)

    def spectral_key(self, template: Template) -> tuple[Any, ...]:
        """Place and law."""
        return parts_of(template)[:2]


def sentence(place: str, law: Form, course: Form) -> Template:
    """The template of a sentence."""
    return Template({"place": place, "law": law, "course": course})


def parts_of(template: Template) -> tuple[str, Form, Form]:
    """Place, law and course of a template, whether they come from a search or from a file."""
    own = template.parameters
    return str(own["place"]), _as_form(own["law"]), _as_form(own["course"])


def numbers_of(template: Template) -> int:
    """How many numbers the law and the course of a sentence have."""

    def count(form: Form) -> int:
        return sum(count(one) if isinstance(one, tuple) else isinstance(one, int | float) for one in form)

    _, law, course = parts_of(template)
    return count(law) + count(course)


def require_sentence(place: str, parameters: Mapping[str, Any]) -> None:
    """Refuse parameters that are no sentence.

    Raises
    ------
    BadInputError
        Where place, law or course is missing, unknown, or has other numbers than its kind.
    """
    try:
        template = Template(dict(parameters))
        _, law, course = parts_of(template)
        _check(LAWS, law)
        _check(COURSES, course)
        in_words(template)
        as_equation(template)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        names = f"a place of {', '.join(PLACES)}, a law of {', '.join(LAWS)}, and a course of {', '.join(COURSES)}"
        raise BadInputError(f"{place}: sentence", f"{names}, each with its numbers", repr(dict(parameters))) from error


def _check(kinds: Mapping[str, Kind], form: Form) -> None:
    """Raise where a form has not the numbers of its kind, or none that can be read."""
    name, *numbers = form
    if name == PRODUCT and kinds is COURSES:
        _, one, other = form
        _check(kinds, one)
        _check(kinds, other)
        return
    signature(kinds[name].values).bind(None, *numbers)
    if name in (*DATED, "ramp"):
        _unix(numbers[0])
    is_even = len(numbers) % 2 == 0
    if (name == SERIES and is_even) or (name == CHANNELS and not (numbers and is_even)):
        raise ValueError(numbers)
    if name in (SERIES, CURVE, CHANNELS) and not any(numbers[1:]):
        raise ValueError(numbers)
    if name == "cycle" and not numbers[0] > 0.0:
        raise ValueError(numbers[0])
    if name == "wet" and numbers[0] not in ("flag", "saturating", "linear"):
        raise ValueError(numbers[0])


def _as_form(value: Sequence[Any]) -> Form:
    return tuple(_as_form(one) if isinstance(one, list | tuple) else one for one in value)


_PAIRS = (("working days", "weekend"), ("day", "night"), ("over", "under"))
COMPLEMENTS = {**dict(_PAIRS), **{other: one for one, other in _PAIRS}}
"""Courses of which one is 1 where the other is 0."""


def opposite(template: Template) -> Template | None:
    """The sentence whose course has the other sign, up to a constant; None where no form has."""
    place, law, course = parts_of(template)
    if course[0] in COMPLEMENTS:
        return sentence(place, law, (COMPLEMENTS[course[0]], *course[1:]))
    if course[0] == SERIES:
        return sentence(place, law, (*course[:2], *(-one for one in course[2:])))
    if course[0] == "cycle":
        return sentence(place, law, (*course[:2], (course[2] + 0.5) % 1.0))
    if course[0] != "wave":
        return None
    _, clock, number, highest = course
    return sentence(place, law, ("wave", clock, number, (highest + 0.5 / number) % (1.0 / number)))


def in_words(template: Template) -> str:
    """A sentence without whom it concerns and without its size."""
    place, law, course = parts_of(template)
    return f"{PLACES[place].words}, {_say(LAWS, law)}, {_say(COURSES, course)}"


def as_equation(template: Template) -> str:
    """What the sentence does to the chain of eq. full_chain, a its size."""
    place, law, course = parts_of(template)
    factors = [one for one in (_write(LAWS, law), _write(COURSES, course)) if one != "1"]
    return PLACES[place].equation.format(" ".join(["a", *factors]))


def _say(kinds: Mapping[str, Kind], form: Form) -> str:
    name, *numbers = form
    if name == PRODUCT:
        only = "only" if kinds[form[2][0]].gates else "that"
        return f"{_say(kinds, form[1])}, and {only} {_say(kinds, form[2])}"
    if name == "wave":
        clock, number, highest = numbers
        several = "a wave" if number == 1 else f"{number:g} waves"
        return f"in {several} a {_CALLED[clock]}, highest at {_time_of(clock, highest % (1.0 / number))}"
    if name == "cycle":
        days, highest = numbers
        return f"in a wave of {days:.4g} days, highest at day {days * highest:.1f} of it ({_SINCE.format(days)})"
    if name == SERIES:
        clock, *of_harmonics = numbers
        highest = HOURS[np.argmax(np.asarray(of_harmonics) @ harmonics(HOURS, len(of_harmonics) // 2))]
        called = f"{len(of_harmonics) // 2} harmonics a {_CALLED[clock]}"
        return f"in a course that is estimated, {called}, highest at {_time_of(clock, float(highest))}"
    if name == "near":
        clock, middle, width = numbers
        within = width * (SIDEREAL_DAY_S / DAY_S if clock == SIDEREAL else PERIODS_D[clock])
        said = f"{24.0 * within:.1f} h" if within < 1.0 else f"{within:.1f} d"
        return f"near {_time_of(clock, middle % 1.0)}, a Gaussian of {said}"
    at_mhz = _join_mhz(numbers[::2]) if name == CHANNELS else ""
    return kinds[name].words.format(*numbers, at_mhz=at_mhz)


def _join_mhz(at_mhz: Sequence[float]) -> str:
    """Frequencies in words, MHz."""
    *others, last = (f"{one:g}" for one in sorted(at_mhz))
    return " and ".join([*([", ".join(others)] if others else []), last])


_SINCE = "days since 1970-01-01 modulo {0:g}"
_CALLED = {SIDEREAL: "sidereal day", SOLAR: "UTC day"}
_CALLED |= {name: name for name in (WEEK, YEAR, ROTATION, LUNATION)}


def _time_of(clock: str, turns: float) -> str:
    """A phase of a clock in its own units."""
    if clock in (SIDEREAL, SOLAR):
        return f"{24.0 * turns:.1f} h {clock}"
    since = {WEEK: "of the week, from Monday", YEAR: "of the year"}
    day = PERIODS_D[clock] * turns
    return f"day {day:.1f} {since.get(clock, f'of the {clock} ({_SINCE.format(PERIODS_D[clock])})')}"


def _write(kinds: Mapping[str, Kind], form: Form) -> str:
    if form[0] == PRODUCT:
        return f"{_write(kinds, form[1])} {_write(kinds, form[2])}"
    if form[0] == CURVE:
        return f"({_sum_of([f'P{k}(ln nu)' for k in range(len(form) - 1)], form[1:])})"
    if form[0] == CHANNELS:
        return f"({_sum_of([f'[{one:g} MHz]' for one in form[1::2]], form[2::2])})"
    if form[0] == SERIES:
        waves = [f"{kind} 2 pi {k + 1} {form[1]}" for k in range(len(form) // 2 - 1) for kind in ("cos", "sin")]
        return f"({_sum_of(waves, form[2:])})"
    return kinds[form[0]].equation.format(*form[1:])


def _sum_of(functions: Sequence[str], numbers: Sequence[float]) -> str:
    """A sum of functions with their numbers, relative to the largest value of the sum."""
    return " ".join(f"{one:+.2g} {function}" for one, function in zip(numbers, functions, strict=True))
