"""Charts of the service's pages, from values of the use cases. Instants become seconds; every link keeps the span."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING
from urllib.parse import urlencode

import numpy as np

from lbacal.instants import SECOND_US, format_instant, parse_instant
from lbacal.pages.chart import (
    BAND,
    BARS,
    BLUE,
    GREEN,
    IMAGE,
    INK,
    LINE,
    MARK,
    OF_DIPOLE,
    ORANGE,
    POINTS,
    PURPLE,
    RED,
    SKY,
    WIDE,
    Chart,
    Series,
)
from lbacal_core.causes.cause import RAIN, TEMPERATURE
from lbacal_core.curves.validity import Instant
from lbacal_core.errors import BadInputError, name_path
from lbacal_core.grids import WITHIN_1_SIGMA, Floats
from service.storage.changes import KeptChange
from service.usecases.drift import HALF_A_MONTH_S, DriftSeries, MonthPoint, VersionPoint
from service.usecases.life import Life
from service.usecases.status import StationState

if TYPE_CHECKING:
    from lbacal_core.calibration.one_event import OverLst  # half a second to import

# The time range of an address (`?since=&until=`), which every page obeys and every link of a page keeps.


@dataclass(frozen=True)
class Span:
    """A half-open range of time; None is open."""

    since: Instant | None = None
    until: Instant | None = None

    def __post_init__(self) -> None:
        if self.since is not None and self.until is not None and self.until <= self.since:
            raise BadInputError("until", "an instant after since", format_instant(self.until))

    def has(self, instant: Instant) -> bool:
        """Whether an instant lies in it."""
        return (self.since is None or self.since <= instant) and (self.until is None or instant < self.until)

    @property
    def limits(self) -> tuple[float, float] | None:
        """Both ends in seconds, for an axis; None where one of them is open."""
        return None if self.since is None or self.until is None else (self.since / SECOND_US, self.until / SECOND_US)

    @property
    def days(self) -> dict[str, str]:
        """The ends `since` and `until` as dates, as the form of a page shows them; empty where open."""
        ends = {"since": self.since, "until": self.until}
        return {name: "" if at is None else format_instant(at)[:10] for name, at in ends.items()}

    @property
    def query(self) -> str:
        """The query by which the next page has the same range of time; empty where both ends are open."""
        return self.with_more()

    def with_more(self, **more: str) -> str:
        """Add further parameters."""
        given = {name: value for name, value in {**self.days, **more}.items() if value}
        return f"?{urlencode(given)}" if given else ""


EVERYTHING = Span()

# The charts.

PERCENT = 100.0
LANES = ("in effect", "versions", "changes", "causes", "alarms", "investigations")
ROW, FOR_AXIS = 18, 70
"""Height of a row of bars, and of the axis below them."""
MATRIX_ROW, LEFT = 9, 120.0
COLOURS = (INK, RED, BLUE, GREEN, PURPLE, ORANGE, SKY)


def draw_coverage(stations: Sequence[StationState], span: Span) -> Chart:
    """How many paths of each station have a calibration, and by what."""
    rows = [one.name for one in stations]
    counts = {
        "served the mean of others": [one.in_effect + one.without_data for one in stations],
        "by a mean that holds their data": [one.in_effect for one in stations],
        "by their own version": [one.own for one in stations],
    }
    links = [f"/stations/{one.name}{span.query}" for one in stations]
    series = [
        Series(
            BARS, numbers, range(len(rows)), name=name, colour=colour, links=links,
            titles=[f"{row}: {n} of {one.paths} paths" for row, n, one in zip(rows, numbers, stations, strict=True)],
        )
        for (name, numbers), colour in zip(counts.items(), (ORANGE, SKY, GREEN), strict=True)
    ]  # fmt: skip
    most = max((one.paths for one in stations), default=1)
    title, height = "paths with a calibration at the last event", FOR_AXIS + 34 + ROW * len(rows)
    return Chart(title, "paths", "", series, x_limits=(0.0, float(most)), rows=rows, height=height)


def name_members(kept: KeptChange, most: int = 3) -> str:
    """Whose change it is, in a few words."""
    one = kept.change
    antennas = [str(number) for number in one.antennas]
    more = f" and {len(antennas) - most} more" if len(antennas) > most else ""
    plural = "s" if len(antennas) > 1 else ""
    return f"{one.station or 'array'}" + (f" antenna{plural} {', '.join(antennas[:most])}{more}" if antennas else "")


def address_of(kept: KeptChange, span: Span) -> str:
    """Where a change is told in full: the life of its first path, of its station, or the drift."""
    one = kept.change
    if one.station is None:
        return f"/drift{span.query}#changes"
    if not one.paths:
        return f"/stations/{one.station}{span.query}"
    antenna, dipole = one.paths[0]
    at = format_instant(one.date)[:10]
    return f"/paths/{one.station}/{antenna}/{dipole or 'X'}{span.with_more(at=at)}"


def draw_changes(changes: Sequence[KeptChange], span: Span, ends: Sequence[Instant | None]) -> Chart:
    """Size and date of the changes that have a size, between the first and the last event unless the span says more."""
    known = [(one, *sizes) for one in changes if None not in (sizes := (one.change.size, one.change.size_sigma))]
    series = []
    for decision, colour in (("in_force", RED), ("proposed", BLUE), ("dismissed", GREEN)):
        own = [one for one in known if one[0].decision == decision]
        size = PERCENT * np.array([one[1] for one in own], dtype=float)
        sigma = PERCENT * np.array([one[2] for one in own], dtype=float)
        titles = [
            f"{name_members(one)}, {format_instant(one.change.date)[:10]}: {s:+.1f} ± {e:.1f} %"
            for (one, *_), s, e in zip(own, size, sigma, strict=True)
        ]
        dates, links = [one.change.date / SECOND_US for one, *_ in own], [address_of(one, span) for one, *_ in own]
        name = decision.replace("_", " ")
        series.append(Series(POINTS, dates, size, size - sigma, size + sigma, name, colour, titles=titles, links=links))
    instants = [*(one.change.date for one in changes), *(at for at in ends if at is not None)]
    low, high = min(instants, default=0) / SECOND_US, max(instants, default=0) / SECOND_US
    limits = span.limits or (low, high if high > low else low + 1.0)
    series.append(Series(LINE, limits, (0.0, 0.0)))
    return Chart("changes of C", "date (UTC)", "change of C (%)", series, ("time", "linear"), limits)


def draw_counts(counts: dict[str, tuple[int, str]]) -> Chart:
    """How much of each kind waits; by its name the number, and the address of the page with them."""
    titles = [f"{number} {name}" for name, (number, _) in counts.items()]
    numbers = [number for number, _ in counts.values()]
    bars = Series(BARS, numbers, range(len(counts)), colour=SKY, titles=titles, links=[to for _, to in counts.values()])
    limits = 0.0, float(max(*numbers, 4))
    rows = [f"{name}: {number}" for name, (number, _) in counts.items()]
    return Chart("what waits", "number", "", [bars], x_limits=limits, rows=rows, height=FOR_AXIS + ROW * len(rows))


def draw_drift(series: Sequence[DriftSeries], versions: Sequence[Sequence[VersionPoint]], span: Span) -> Chart:
    """C of every month and of every version over that of the first year; a band is the middle 68 % of the paths."""
    parts: list[Series] = []
    for k, (one, own) in enumerate(zip(series, versions, strict=True)):
        parts += _draw_months(one, COLOURS[(k + 1) % len(COLOURS)], own, span)
    shown = [part for part in parts if part.kind in (LINE, POINTS)]
    values = [v for part in shown for v in (*part.y, *(part.low if part.low is not None else ()))]
    # an insensitive path may widen a band by a factor: what is shown are medians and versions
    low, high = min([0.98, *values]), max([1.02, *values])
    limits = low - 0.08 * (high - low), high + 0.08 * (high - low)
    label = "C / C of the first year"
    return Chart(
        "C over time", "month (UTC)", label, parts, ("time", "linear"), span.limits, limits, width=WIDE, height=380
    )


def _draw_months(
    one: DriftSeries, colour: int, versions: Sequence[VersionPoint], span: Span, address: str = ""
) -> Iterator[Series]:
    name = name_path(*one.scope.parts)
    months: list[MonthPoint] = [month for month in one.months if span.has(month.month)]
    at = [month.month / SECOND_US + HALF_A_MONTH_S for month in months]
    low, middle, high = ([getattr(month, part) for month in months] for part in ("low", "c_ratio", "high"))
    titles = [
        f"{name} {format_instant(m.month)[:7]}: {m.c_ratio:.4f}, {m.low:.4f} to {m.high:.4f} "
        f"({m.paths} paths, {m.events} events)"
        for m in months
    ]
    links = [f"{address}{span.with_more(at=format_instant(m.month)[:7] + '-15')}" for m in months] if address else ()
    yield Series(BAND, at, low=low, high=high, name="", colour=colour)
    yield Series(LINE, at, middle, name=name, colour=colour)
    yield Series(POINTS, at, middle, name="", colour=colour, titles=titles, links=links)
    lines = [(t, month.line[0]) for t, month in zip(at, months, strict=True) if month.line]
    if lines:
        at_line, values = [t for t, _ in lines], [value for _, value in lines]
        yield Series(LINE, at_line, values, name=f"{name}: season and slope", colour=colour, style=1)
    for version in versions:
        of, ratio = version.mean, 1.0 + version.change
        if not (span.has(of.since) or span.has(of.until)):
            continue
        # one beside the other: polarisations share their windows
        middle_of = (of.since + (0.48 if of.dipole == "X" else 0.52) * (of.until - of.since)) / SECOND_US
        sigma, links = ratio * of.c_sigma / of.c, [f"/calibrations/{of.calibration}{span.query}"]
        titles = [f"{name} {of.dipole}, version of {_days(of.since, of.until)}: {ratio:.4f} ± {sigma:.4f}"]
        yield Series(
            POINTS, [middle_of], [ratio], [ratio - sigma], [ratio + sigma], f"version, {of.dipole}",
            OF_DIPOLE.get(of.dipole, INK), titles=titles, links=links,
        )  # fmt: skip


def _days(since: Instant | None, until: Instant | None) -> str:
    begin, end = (("open" if at is None else format_instant(at)[:10]) for at in (since, until))
    return f"{begin} to {end}"


def draw_path(
    life: Life, drift: DriftSeries, versions: Sequence[VersionPoint], span: Span, at: Instant | None, address: str
) -> Chart:
    """C over time with its error, the versions, and where what changed: a click on a month asks for C on that date."""
    parts = list(_draw_months(drift, 2, versions, span, address))
    ratios = {one.mean.calibration: 1.0 + one.change for one in versions}
    for stretch, factors in zip(life.in_effect, life.factors, strict=True):
        ratio = ratios.get(str(stretch.calibration), math.nan)
        if shown := [one for one in factors or () if span.has(one.at)]:
            at_months, values = [one.at / SECOND_US for one in shown], [ratio * one.value for one in shown]
            parts.append(Series(LINE, at_months, values, name="C in effect", colour=GREEN))
    marks = [one for one in life.changes if one.ended is None]
    titles = [
        f"{name_members(one)} changed on {format_instant(one.change.date)[:10]} ({one.decision})" for one in marks
    ]
    links = [address_of(one, span) for one in marks]
    dates = [one.change.date / SECOND_US for one in marks]
    parts.append(Series(MARK, dates, name="change", colour=RED, style=1, titles=titles, links=links))
    if at is not None:
        parts.append(Series(MARK, [at / SECOND_US], name="shown below", colour=GREEN, titles=[format_instant(at)[:10]]))
    label, limits = "C / C of the first year", find_days(life, drift, span)
    return Chart(
        "C over time", "date (UTC)", label, parts, ("time", "linear"), limits, width=WIDE, height=320, left=LEFT
    )


def draw_life(life: Life, limits: tuple[float, float], span: Span, now: Instant) -> Chart:
    """Everything that happened to a scope, a lane a kind; `limits`, s UTC, are those of `find_days`."""
    series: list[Series] = []

    def add(lane: str, since: Instant | None, until: Instant | None, title: str, link: str, colour: int) -> None:
        first, last = (edge if at is None else at / SECOND_US for at, edge in zip((since, until), limits, strict=True))
        row = LANES.index(lane)
        if first < limits[1] and last > limits[0]:
            ends = [min(max(one, limits[0]), limits[1]) for one in (first, last)]
            series.append(Series(LINE, ends, [row, row], colour=colour))
            series.append(Series(POINTS, [ends[0]], [row], colour=colour, titles=[title], links=[link]))

    q = span.query
    for stretch in life.in_effect:
        title = f"in effect {_days(stretch.start, stretch.end)}: {str(stretch.calibration)[:12]}"
        add("in effect", stretch.start, stretch.end, title, f"/calibrations/{stretch.calibration}{q}", GREEN)
    for version in life.versions:
        title = f"version {version.id[:12]} of {_days(*version.window)}: {version.status}, {version.events} events"
        add("versions", *version.window, title, f"/calibrations/{version.id}{q}", SKY)
    for change in life.changes:
        one = change.change
        title = f"change {change.number} of {name_members(change)}: {change.decision}"
        add("changes", one.date - one.sigma, one.date + one.sigma, title, address_of(change, span), RED)
    for cause in life.causes:
        title = f"{cause.change.act}: {cause.changed.sentence}"
        add("causes", cause.change.since, cause.change.until, title, f"/models{q}", PURPLE)
    for alarm in life.alarms:
        add("alarms", alarm.news.since or alarm.raised, alarm.ended or now, alarm.news.sentence, f"/alarms{q}", ORANGE)
    for made in life.investigations:
        title = f"investigation of {_days(made.since, made.until)}: {made.report['verdict']}"
        add("investigations", made.since, made.until, title, f"/investigations/{made.id}{q}", INK)
    height = FOR_AXIS + 24 * len(LANES)
    return Chart("what happened", "date (UTC)", "", series, ("time", "linear"), limits, None, LANES, WIDE, height, LEFT)


UNITS = {TEMPERATURE: "temperature (°C)", RAIN: "rain (mm/h)"}
MOST_COVARIATES = 3


def draw_environment(
    found: Mapping[str, Sequence[tuple[Instant, Floats]]], days: tuple[float, float]
) -> dict[str, Chart]:
    """Draw weather and other covariates month by month, the mean and the middle 68 %: the first few, as ``env-NAME``.

    `found` has each month's first instant and values, shape (event,), by the name of the covariate; `days` are the ends
    of the axis, s UTC.
    """
    charts = {}
    for name, months in list(found.items())[:MOST_COVARIATES]:
        at = [month / SECOND_US + HALF_A_MONTH_S for month, _ in months]
        middle = [float(values.mean()) for _, values in months]
        low, high = zip(*(np.percentile(values, WITHIN_1_SIGMA) for _, values in months), strict=True)
        titles = [
            f"{format_instant(m)[:7]}: {value:.3g}, {len(v)} events"
            for (m, v), value in zip(months, middle, strict=True)
        ]
        label = UNITS.get(name, name)
        series = [
            Series(BAND, at, low=low, high=high, colour=ORANGE),
            Series(LINE, at, middle, colour=ORANGE, titles=titles),
        ]
        charts[f"env-{name}"] = Chart(
            label, "date (UTC)", label, series, ("time", "linear"), days, None, (), WIDE, 160, LEFT
        )
    return charts


def find_days(life: Life, drift: DriftSeries, span: Span) -> tuple[float, float]:
    """First and last instant that are shown, s UTC: the span, where it is open those of the data."""
    known = [month.month / SECOND_US for month in drift.months] + [
        at / SECOND_US for one in life.versions for at in one.window
    ]
    known += [at / SECOND_US for one in life.investigations for at in (one.since, one.until)]
    first, last = min(known, default=0.0), max(known, default=1.0)
    low = first if span.since is None else span.since / SECOND_US
    high = last if span.until is None else span.until / SECOND_US
    return (low, high) if low < high else (low, low + 1.0)


def draw_matrix(station: str, years: Sequence[str], span: Span) -> Chart | None:
    """Every path of a station beside its median, month by month; a row leads to its path. None without a month."""
    tables = [json.loads(year) for year in years]
    cells = {
        (antenna, dipole, month): value
        for table in tables
        for (antenna, dipole), row in zip(table["paths"], table["values"], strict=True)
        for month, value in zip(table["months"], row, strict=True)
        if value is not None and span.has(parse_instant("month", f"{month}-15"))
    }
    if not cells:
        return None
    paths = sorted({(antenna, dipole) for antenna, dipole, _ in cells})
    first, last = (np.datetime64(pick(month for *_, month in cells), "M") for pick in (min, max))
    months = [str(month) for month in np.arange(first, last + 1)]
    values = np.array([[cells.get((*path, month), np.nan) for month in months] for path in paths], dtype=float)
    limit = max(2.0, PERCENT * float(np.nanmax(np.abs(values))))
    edges = [parse_instant("month", f"{month}-01") / SECOND_US for month in (first, last + 1)]
    image = Series(
        IMAGE, edges, (len(paths) - 0.5, -0.5), name="%", image=PERCENT * values[::-1], limit=limit,
        links=[f"/paths/{station}/{antenna}/{dipole}{span.query}" for antenna, dipole in paths],
        titles=[f"antenna {antenna} {dipole}" for antenna, dipole in paths],
    )  # fmt: skip
    rows = [f"{antenna} {dipole}" if k % 2 == 0 or len(paths) < 24 else "" for k, (antenna, dipole) in enumerate(paths)]
    height = FOR_AXIS + max(MATRIX_ROW, 200 // len(paths)) * len(paths)
    limits = (edges[0], edges[1])
    return Chart(
        "change of C of every path", "month (UTC)", "antenna and dipole", [image], ("time", "linear"), limits,
        (len(paths) - 0.5, -0.5), rows, WIDE, height,
    )  # fmt: skip


def draw_over_lst(found: OverLst, name: str) -> Chart:
    """Band power against sidereal time, as the published figure has it."""
    low, high = found.measured - np.nan_to_num(found.error), found.measured + np.nan_to_num(found.error)
    titles = [f"{lst:.2f} h: {value:.3f}" for lst, value in zip(found.lst_hours, found.measured, strict=True)]
    measured = Series(POINTS, found.lst_hours, found.measured, low, high, "measured", titles=titles)
    expected = Series(LINE, found.lst_hours, found.expected, name="predicted by the fit", colour=RED)
    label = "band power / its predicted daily mean"
    hours = "local sidereal time (h)"
    return Chart(f"fit of {name} over sidereal time", hours, label, [measured, expected], x_limits=(0.0, 24.0))
