"""The watch: follows every path, station and the whole through all years, and raises alarms of what changed.

It reads what the drift has measured of every event (`service.usecases.drift`), asks the core what changed
(`lbacal_core.drift.follow`), keeps the answer as the report that pages and the API tell from, and settles the alarms of
steps and slopes. It is due whenever the measured events are others than those of the last report. An antenna that was
found to have changed has its windows cut there from then on, until the chain alone shows the change no more.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from lbacal.instants import DAY_US, SECOND_US, format_instant
from lbacal_core.calibration.windows import find_hardware_changes
from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.drift.members import is_of_one_size, name_members, split_by_size
from lbacal_core.errors import name_path, write_change
from lbacal_core.grids import YEAR_S, Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.provenance import DRIFT_VERSION, MODEL_VERSION, hash_content
from service.storage.alarms import SLOPE, STEP, News
from service.storage.changes import DRIFT as BY_DRIFT
from service.storage.changes import (
    LARGEST_DATE_ERROR_US,
    PERSON,
    RAMP,
    RECORD,
    SEASON,
    Change,
    Evidence,
    KeptChange,
    OwnSize,
)
from service.storage.database import Database, Stores
from service.storage.jobs import Part
from service.storage.spectra import EVENT_SPAN_US, Window
from service.storage.sums import DRIFT, Sums
from service.usecases.gate import PLAIN, tell_change

if TYPE_CHECKING:
    from lbacal_core.drift.follow import History

KIND = "watch"
YEAR_US = round(YEAR_S * SECOND_US)
MEMBERS_NAMED = 4
"""A sentence names this many of those that changed together, and counts the others."""
UNLESS = " unless a person dismissed the change"
"""The end of the sentence of an alarm, whose list says which it is."""
FEWEST_LEFT_OUT = 5
"""Exceptions are a twentieth of a path's spectra at the most: so many in a row are one by chance in three millions."""
TREND_P = 0.001
"""Probability of a trend of the whole without one, below which it is an alarm."""


@dataclass(frozen=True)
class Watch:
    """Follows the array."""

    database: Database
    instrument: Instrument
    cuts_windows: bool
    clock: Callable[[], Instant]

    def name_inputs(self, stores: Stores) -> str | None:
        """The hash of what a report is made from; None where nothing was measured yet."""
        digests, known = stores.sums.digests(DRIFT), sorted(find_hardware_changes(self.instrument).items())
        return hash_content([digests, known, MODEL_VERSION, DRIFT_VERSION]) if digests else None

    def run(self, part: Part, worker: str) -> None:
        """Do a part: follow, keep the report, settle the alarms; nothing where all measured events are gone since."""
        with self.database.read() as stores:
            inputs = self.name_inputs(stores)
            years, known = stores.sums.of_kind(DRIFT), find_hardware_changes(self.instrument)
            history = assemble_history(years, known) if inputs else None
            left_out = [] if history is None else list(_find_left_out(stores, history))
            recorded = [] if history is None else list(_find_recorded(history, known))
        more = {"left_out": left_out, "recorded": recorded}
        report = None if history is None else self._report(history) | more
        with self.database.write() as stores:
            now = self.clock()
            stores.jobs.complete(part, worker, {"calibrations": []}, now)
            if history is None or report is None:
                return
            stores.drift.keep_report(str(inputs), report, now)
            news = tell_news(report, self.instrument.frequency_mhz, cuts_windows=self.cuts_windows)
            stores.alarms.settle((STEP, SLOPE), list(news), now)
            settle_changes(stores, report if self.cuts_windows else {"changes": []}, _list_measured(history), now)

    def _report(self, history: History) -> dict[str, Any]:
        from lbacal_core.drift.follow import follow  # with scipy: only workers need it
        from lbacal_core.drift.report import describe_followed

        return describe_followed(history, follow(history), self.instrument.frequency_mhz)


def assemble_history(years: Iterable[Sums], changes: Mapping[tuple[str, int], Sequence[float]]) -> History:
    """Lay what is kept of all years and stations on one axis of events, with the dates of hardware changes."""
    from lbacal_core.drift.follow import History
    from service.usecases.drift_measurement import read_events

    modes = [(str(one.scope.station), *of) for one in years for of in read_events(one.arrays).items()]
    return History.of(modes, changes)


Measured = Mapping[tuple[str | None, int, str | None], tuple[float, float]]
"""Paths that drift has events of (dipole None: any), with the instants of the first and the last."""


def _list_measured(history: History) -> Measured:
    paths = zip(history.station.tolist(), history.antenna.tolist(), history.dipole.tolist(), strict=True)
    first, last = (SECOND_US * ends for ends in history.spans)
    spans = list(zip(first.tolist(), last.tolist(), strict=True))
    return {
        (station, antenna, dipole): span
        for (station, antenna, letter), span in zip(paths, spans, strict=True) for dipole in (letter, None)
    }  # fmt: skip


def _find_recorded(history: History, changes: Mapping[tuple[str, int], Sequence[float]]) -> Iterator[dict[str, Any]]:
    """Find hardware changes of which no path has events on both sides: an antenna that came, went or was renamed."""
    owners = list(zip(history.station.tolist(), history.antenna.tolist(), strict=True))
    sized = {(*of, date) for of, dates in zip(owners, history.known_unix.tolist(), strict=True) for date in dates}
    together = defaultdict[tuple[str, float], list[int]](list)
    for station, antenna in sorted(set(owners)):
        for date in changes.get((station, antenna), ()):
            if history.time_unix[0] < date <= history.time_unix[-1] and (station, antenna, date) not in sized:
                together[station, date].append(antenna)
    for (station, date), antennas in together.items():
        yield {"station": station, "antennas": antennas, "date_unix": date}


def _find_left_out(stores: Stores, history: History) -> Iterator[dict[str, Any]]:
    """Find paths whose newest spectra, `FEWEST_LEFT_OUT` or more, were all left out; not those that count as silent."""
    from lbacal_core.drift.report import SILENT_EVENTS

    time_us = history.time_unix * SECOND_US
    for (station, antenna, dipole), (_, last) in _list_measured(history).items():
        if dipole is None or not np.isfinite(last) or np.sum(time_us > last) < FEWEST_LEFT_OUT:
            continue
        ends = round(last) + EVENT_SPAN_US, round(float(time_us[-1])) + EVENT_SPAN_US
        spectra = stores.spectra.count(Window(*ends, Scope(station, antenna, dipole)))
        if FEWEST_LEFT_OUT <= spectra < SILENT_EVENTS:
            yield {
                "station": station, "antenna": antenna, "dipole": dipole, "last_unix": last / SECOND_US,
                "spectra": spectra,
            }  # fmt: skip


def settle_changes(stores: Stores, report: Mapping[str, Any], measured: Measured, now: Instant) -> None:
    """Note what drift found, and end what it no longer finds in paths that are measured.

    A path whose C was withdrawn has nothing that drift could be measured against: what was found in it stays. A step
    does not end because an adopted cause takes it up: the cause may be withdrawn. A slow change does: C would follow it
    twice. A change follows the later events that give it another date or size, unless a person has spoken of it: of
    one that a person entered without a size, the size alone. A change of the instrument's record that is below the
    threshold is on record, and not found.
    """
    found = [
        (change, max(_list_significances(change, one["members"])), bool(one["is_known"]))
        for one in report["changes"]
        for change in read_changes(one)
    ]
    for one in report.get("slopes", ()):
        found += [(*of, False) for of in read_slow(one, report["first_unix"])]
    for one in report.get("recorded", ()):
        paths = tuple((antenna, None) for antenna in one["antennas"])
        found.append((Change(one["station"], paths, STEP, round(one["date_unix"] * SECOND_US), 0), 0.0, True))
    alike = defaultdict[tuple[str | None, str], dict[Change, Sequence[Evidence]]](dict)
    for change, significance, is_known in found:
        is_found = not is_known or significance >= report.get("threshold_sigma", math.inf)
        by_drift = [Evidence(BY_DRIFT, "", significance, now)] if is_found else []
        on_record = [Evidence(RECORD, "", None, now)] if is_known else []
        alike[change.station, change.kind][change] = [*by_drift, *on_record]
    for kept in stores.changes.kept():
        change = kept.change
        is_slow = change.kind in (RAMP, SEASON)
        is_sought = is_slow or stores.models.during(change.station, change.date, change.date + 1).is_plain
        is_measured = not change.paths or any((change.station, *path) in measured for path in change.paths)
        if is_sought and is_measured and not any(map(change.is_same, alike[change.station, change.kind])):
            for source in (BY_DRIFT, RECORD):
                stores.changes.end(kept.number, source, now)
    for change, *_ in found:
        say_so = alike[change.station, change.kind][change]
        noted = [stores.changes.note(change, one) for one in say_so]
        for source in {BY_DRIFT, RECORD} - {one.source for one in say_so}:
            stores.changes.end(noted[0].number, source, now)
    for number, change, by in find_moved(stores.changes.kept(), alike, measured):
        stores.changes.move(number, change, by[0])


def _list_significances(change: Change, members: Iterable[Mapping[str, Any]]) -> list[float]:
    """Significances of the members of a date that a change is of, standard deviations."""
    return [
        float(one["significance"])
        for one in members
        if ((one["antenna"], one["dipole"]) in change.paths if change.paths else one["antenna"] is None)
    ]


Alike = Mapping[tuple[str | None, str], Mapping[Change, Sequence[Evidence]]]
"""Changes by station and kind, with who says so."""


def find_moved(
    on_record: Sequence[KeptChange], found: Alike, measured: Measured
) -> Iterator[tuple[int, Change, Sequence[Evidence]]]:
    """Find the changes that later events give another date, size or dipoles of their antennas, by their numbers.

    With what these give them, and who says so: of each that lasts, the nearest found of all its antennas, if no other
    on record is nearer to that. One of which a person has spoken stays, but for a size that was left open. A dipole
    that drift alone had named leaves one in which it is no longer found.
    """
    lasting = defaultdict[tuple[str | None, str], list[Change]](list)
    for kept in on_record:
        if kept.ended is None:
            lasting[kept.change.station, kept.change.kind].append(kept.change)
    for kept in on_record:
        own, spoken = kept.change, [by for by in kept.evidence if by.source == PERSON and by.ended is None]
        is_size_open = all(by.date is not None and by.size is None for by in spoken)
        if kept.ended is not None or not is_size_open:
            continue
        of_kind = found.get((own.station, own.kind), {})
        same = [one for one in of_kind if own.is_same(one)]
        nearest = _nearest(own, [one for one in same if one.has_all_of(own)])
        if nearest is None:
            continue
        if spoken:
            sized = replace(nearest, date=own.date, sigma=own.sigma, paths=own.paths)
            if own.is_away_from(sized):
                yield kept.number, sized, of_kind[nearest]
            continue
        told = own.as_found(nearest, _find_gone(kept, same, measured))
        if told.paths == own.paths and not own.is_away_from(nearest):
            continue
        like = filter(nearest.is_same, lasting[own.station, own.kind])
        rivals = [one for one in like if not own.paths or set(one.antennas) & set(own.antennas)]
        if _nearest(nearest, rivals) == own:
            yield kept.number, told, of_kind[nearest]


def _find_gone(kept: KeptChange, found: Sequence[Change], measured: Measured) -> list[tuple[int, str | None]]:
    """The dipoles of a change that drift alone had named, and no longer finds though it has events before and after."""
    own = kept.change
    if kept.evidence[0].source != BY_DRIFT or any(by.source in (PERSON, RECORD) for by in kept.evidence):
        return []
    spans = {path: measured.get((own.station, *path), (math.inf, -math.inf)) for path in own.paths}
    has_both_sides = [path for path, (first, last) in spans.items() if first < own.date <= last]
    return [path for path in has_both_sides if not any(path in one.paths for one in found)]


def _nearest(own: Change, others: Iterable[Change]) -> Change | None:
    """The one nearest in date."""
    return min(others, key=lambda one: abs(one.date - own.date), default=None)


def read_changes(told: Mapping[str, Any]) -> list[Change]:
    """Read steps at one date as changes: one of each size; a station's median stands for all its paths."""
    date, sigma = round(told["date_unix"] * SECOND_US), round(told["date_sigma_days"] * DAY_US)
    return [
        Change(
            told["station"], _paths_of(one["members"]), STEP, date, sigma, one["size"], one["sigma"],
            **_plain_shape(one["shape"]), own=_own_sizes(*one["members"]),
        )
        for one in ([told] if told["is_known"] else split_by_size(told, keep_antennas=True))
    ]  # fmt: skip


def _own_sizes(first: Mapping[str, Any], *others: Mapping[str, Any]) -> tuple[OwnSize, ...]:
    """Those of the other members that changed by another amount than the first."""
    return tuple(
        OwnSize(one["antenna"], one["dipole"], one["size"], one["sigma"], **_plain_shape(one.get("shape", {})))
        for one in others
        if one["antenna"] is not None and not is_of_one_size(first, one)
    )


def read_slow(told: Mapping[str, Any], first_unix: float) -> Iterator[tuple[Change, float]]:
    """Read the slope and the season of a path as a ramp since the first event, and a season, with their significance.

    What a station does beside the others differs by polarisation: its alarm says it, and a person may enter it.
    """
    if told["antenna"] is None:
        return
    of, first = (told["station"], ((told["antenna"], told["dipole"]),)), round(first_unix * SECOND_US)
    if told["is_found"]:
        ramp = Change(*of, RAMP, first, 0, math.expm1(told["slope"]), told["sigma"], **_plain_shape(told["shape"]))
        yield ramp, told["significance"]
    size, sigma = told["season"], told["season_sigma"]
    if told["season_is_found"] and size > PLAIN * sigma:  # one of the tilt alone has no date
        largest = first + (round(told["season_phase"] * YEAR_US) - first) % YEAR_US
        late = round(sigma / size * YEAR_US / (2 * math.pi))
        season = Change(*of, SEASON, largest, late, math.expm1(size), sigma, **_plain_shape(told["season_shape"]))
        yield season, told["season_significance"]


def _plain_shape(shape: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    """The tilt and curvature that are plain."""
    return {name: one["value"] for name, one in shape.items() if abs(one["value"]) > PLAIN * one["sigma"]}


def _paths_of(members: Sequence[Mapping[str, Any]]) -> tuple[tuple[int, str | None], ...]:
    is_whole = any(one["antenna"] is None for one in members)
    return () if is_whole else tuple((one["antenna"], one["dipole"]) for one in members)


def tell_news(report: Mapping[str, Any], frequency_mhz: Floats, *, cuts_windows: bool) -> Iterator[News]:
    """The news of a report: changes that nobody knew of, slopes, and a trend of the whole."""
    for change in report["changes"]:
        if change["is_known"]:
            continue
        first, *others = change["members"]
        who = name_path(change["station"], first["antenna"], first["dipole"])
        if others:
            who = f"{change['station']}, {len(change['members'])} together"
        amounts = [
            tell_change(one["size"], one["sigma"], one["shape"], frequency_mhz)
            + (f" ({name_members(one['members'], MEMBERS_NAMED)})" if others else "")
            for one in split_by_size(change)
        ]
        since = round(change["date_unix"] * SECOND_US)
        error = round(change["date_sigma_days"] * DAY_US)
        sentence = (
            f"{who}: C changed by {', by '.join(amounts)}, if its noise stayed, "
            f"on {format_instant(since)[:10]} ± {change['date_sigma_days']:.1f} days"
        )
        is_cut = cuts_windows and error <= LARGEST_DATE_ERROR_US
        sentence += f"; its windows are cut there{UNLESS}" if is_cut else ""
        # what the instrument file would say if hardware changed then: refits cut their windows there
        antennas = sorted({one["antenna"] for one in change["members"] if one["antenna"] is not None})
        own, day = change["station"], format_instant(since)
        proposal = [{"station": own, "antenna": antenna, "since": day} for antenna in antennas]
        content = {**change, "proposal": proposal}
        yield News(STEP, Scope(change["station"]), "", sentence, content, since, error)
    for slope in report["slopes"]:
        if not slope["is_found"]:
            continue
        is_path = slope["antenna"] is not None
        scope = Scope(slope["station"], slope["antenna"], slope["dipole"]) if is_path else Scope(slope["station"])
        beside = "its station" if is_path else "the other stations"
        followed = f"; C in effect follows that{UNLESS} or entered another" if is_path and cuts_windows else ""
        amount = tell_change(slope["slope"], slope["sigma"], slope["shape"], frequency_mhz)
        sentence = (
            f"{name_path(slope['station'], slope['antenna'], slope['dipole'])}: C changes by {amount} a year "
            f"beside {beside}{followed}"
        )
        yield News(SLOPE, scope, "" if is_path else slope["dipole"], sentence, slope)
    whole = report["trends"].get("array")
    if whole is not None and whole["p_value"] < TREND_P:
        sentence = f"C of all paths changes by {write_change(whole['slope'], whole['sigma'])} a year"
        yield News(SLOPE, Scope(), "", sentence, {name: whole[name] for name in ("slope", "sigma", "limit_95")})
