"""The calibration in effect on a date, and the versions behind it."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property

from lbacal.instants import DAY_US, SECOND_US, format_instant, format_optional
from lbacal_core.calibration.slow_changes import follow_slow_changes
from lbacal_core.calibration.spreads import ServedCurve, serve_reference
from lbacal_core.curves.curves import OK, UNCERTAIN
from lbacal_core.curves.reference_chain import ReferenceChain
from lbacal_core.curves.validity import Instant, Promotion, Scope, Stretch
from lbacal_core.errors import BadInputError, name_path, require_antenna, require_name, write_change
from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.provenance import Remembered
from service.errors import NotInEffectError
from service.storage.alarms import Doubt
from service.storage.changes import DISMISSED, STEP, Cut, Epoch, KeptChange, concerns, split_epochs
from service.storage.database import Database
from service.storage.ledger import Neighbour, Neighbours, pick_answering
from service.storage.processes import SCHEDULER
from service.storage.spectra import Window
from service.storage.versions import Version, Waiting

FEWEST_REMEMBERED = 1200
"""Versions, and curves as texts, that stay in memory: the Superterp's of two years, 40 MB.

An instrument with more paths has one for each: a cache that is swept from end to end would hold none that is asked for.
"""
BUDGETS_REMEMBERED = 100
WHOLE_REMEMBERED = 2
"""Answers for all paths: one of 5,000 paths is 43 MB."""
State = tuple[int, Instant | None, tuple[KeptChange, ...], tuple[Waiting, ...], tuple[Doubt, ...]]
"""The newest promotion, the latest instant of the ledger, the changes on record: what is in effect follows. And what
waits, and what is in doubt."""
SLOW_STEP_US = 10 * DAY_US
"""C along a ramp or season is served for the middle of so long a time: what is cached stays true in it, and five days
of a season are 9 % of its amplitude."""
SAMPLED_US = 30 * DAY_US
REACH = 2.0
"""Standard deviations of its date from a change within which an instant may be of its other side."""


@dataclass(frozen=True)
class CurveInEffect:
    """The curve that answers for a path, by which promotion, and the promotions of the scopes on the way.

    Two are equal where they tell the same: the version never changes, and of the instant asked for only the path's
    cable and the slow changes in force matter.

    Attributes
    ----------
    path, dipole
        Who was asked for; with the reference chain of the array, whose path has no dipole, that of the curve.
    is_held
        Nothing is in effect, and the nearest version in time answers instead.
    cable
        The path's cable at the instant; None where that is not known, and then the instant is told as `without_cable`.
    changed
        What to know where the version answers on both sides of a change that was found, where the path's newest spectra
        are left out of fits, most of the version's events were flagged, or the gate keeps back a narrower one, as is
        known now; None elsewhere.
    epoch
        The time between changes in force in which the instant lies.
    waiting
        A version that would answer here but for the gate, narrower than what answers or newer; not told of the past of
        the ledger.
    dismissed
        The changes that a person dismissed, which would cut the version's window or would be followed.
    slow, followed_at
        The ramps and seasons in force that C follows, and the instant at which it does; none and None where there are
        none.
    """

    path: Scope
    dipole: str | None
    promotion: Promotion
    is_held: bool
    trace: tuple[Promotion, ...]
    cable: str | None
    without_cable: Instant | None
    changed: str | None
    epoch: Epoch
    waiting: Waiting | None
    dismissed: tuple[KeptChange, ...]
    slow: tuple[KeptChange, ...]
    followed_at: Instant | None
    version: Version = field(compare=False, repr=False)
    at: Instant = field(compare=False)

    @property
    def served(self) -> ServedCurve:
        """The curve through the path's own cable, that of a reference chain as it is, along what changes slowly."""
        is_chain, version = self.path.antenna is None, self.version
        served = serve_reference(version.curve_of(str(self.dipole))) if is_chain else version.serve(self.path, self.at)
        return served if self.followed_at is None else follow(served, version, self.slow, self.followed_at)

    @property
    def flag_reason(self) -> str | None:
        """Why the whole curve is uncertain; None where it is not."""
        held = "held: nothing is in effect, the nearest in time answers" if self.is_held else None
        return "; ".join(text for text in (held, self.changed, self.served.reason) if text) or None

    @property
    def flags(self) -> list[str]:
        """The flag of each channel."""
        is_uncertain, flags = self.flag_reason is not None, self.served.curve.flags.tolist()
        return [UNCERTAIN if is_uncertain and flag == OK else flag for flag in flags]

    @property
    def chain(self) -> ReferenceChain | None:
        """The reference chain behind the curve; None where that is the path's own, or its chain is not known."""
        is_own = self.version.scope.antenna is not None
        return None if is_own else self.version.chains.get(str(self.dipole))

    @property
    def why(self) -> str:
        """Why it is this version: what it was made for, between which changes, and what was withdrawn before it."""
        made, acted, epoch, served = self.version, self.promotion, self.epoch, self.served
        withdrawn = [f"; {one}" for one in _tell_withdrawn(self.trace)]
        named = " and ".join(f"change {one.number} ({one.change.kind})" for one in self.slow)
        followed = f"; C follows {named}, which adds an error of {100.0 * served.error:.2f} %" if named else ""
        dismissed = [
            f"; change {one.number} ({one.change.kind}) of {format_instant(one.change.date)[:10]} was dismissed "
            f"{format_instant(one.said.at)[:19]}Z by {one.said.by} ({one.said.reason})"
            for one in self.dismissed
            if one.said is not None
        ]
        waits = [] if self.waiting is None else [f"; {self.waiting.sentence}"]
        bounds = (
            (epoch.because, epoch.start, epoch.start_sigma, "begins"),
            (epoch.ended_by, epoch.end, epoch.end_sigma, "ends"),
        )
        ends = [
            f"{'a record of the instrument' if number is None else f'change {number}'} of {format_instant(date)[:10]}"
            f"{f' ± {sigma / DAY_US:.1f} days' if sigma else ''} {does} its epoch"
            for number, date, sigma, does in bounds
            if date is not None
        ]
        return (
            f"made {format_instant(made.made)[:19]}Z by {made.made_by} ({made.reason}), in effect since "
            f"{format_instant(acted.at)[:19]}Z by {acted.by} ({acted.reason}); "
            f"{' and '.join(ends) or 'no change in force bounds its epoch'}{followed}"
            f"{''.join([*dismissed, *withdrawn, *waits])}"
        )


@dataclass(frozen=True)
class WrittenCurve:
    """A curve in effect as the text of an answer, and the budget that it names."""

    text: bytes
    budget: str | None


@dataclass(frozen=True)
class WrittenAnswer:
    """An answer without its head: the texts of curves, and what comes after them; with the SHA-256 of both."""

    curves: Sequence[bytes]
    end: bytes

    @cached_property
    def digest(self) -> str:
        """The SHA-256 of the texts."""
        found = hashlib.sha256(self.end)
        for text in self.curves:
            found.update(text)
        return found.hexdigest()

    @cached_property
    def size(self) -> int:
        """Bytes of the texts and of the commas between them."""
        return sum(map(len, self.curves)) + max(0, len(self.curves) - 1) + len(self.end)


@dataclass(frozen=True)
class InEffect:
    """The answer for some paths at an instant; `missing` are those for which nothing is in effect.

    `budgets` are those of their versions by their hash, as JSON texts.
    """

    at: Instant
    curves: Sequence[CurveInEffect]
    missing: Sequence[Scope]
    budgets: Mapping[str, str]


def select_paths(instrument: Instrument, station: str | None, antenna: int | None, dipole: str | None) -> list[Scope]:
    """The paths of an instrument that a query means."""
    if antenna is not None and station is None:
        raise BadInputError("antenna", "a station beside it", f"antenna {antenna} alone")
    if dipole is not None:
        require_name("dipole", dipole, instrument.dipoles)
    if station is not None:
        require_name("station", station, sorted({record.station for record in instrument.antennas}))
    of_station = [record for record in instrument.antennas if station in (None, record.station)]
    chosen = sorted({(r.station, r.antenna) for r in of_station if antenna in (None, r.antenna)})
    if antenna is not None:
        require_antenna("antenna", antenna, str(station), {record.antenna for record in of_station})
    return [Scope(s, a, d) for s, a in chosen for d in instrument.dipoles if dipole in (None, d)]


def select_scope(
    instrument: Instrument, scope: str | None, station: str | None, antenna: int | None, dipole: str | None
) -> list[Scope]:
    """The paths that a query means, or with the scope ``array`` the reference chain of the array.

    `scope` is that or None.
    """
    if scope is None:
        return select_paths(instrument, station, antenna, dipole)
    if (station, antenna) != (None, None):
        raise BadInputError("scope", "no station or antenna beside scope=array", f"{station or 'antenna'}")
    select_paths(instrument, None, None, dipole)
    return [Scope()]


@dataclass(frozen=True)
class Calibrations:
    """Answers which calibration was in effect when, as known when."""

    database: Database
    instrument: Instrument
    budgets: Remembered[str, str] = field(default_factory=lambda: Remembered(BUDGETS_REMEMBERED))

    @cached_property
    def versions(self) -> Remembered[str, Version]:
        """Versions by their id."""
        return Remembered(self._remembered)

    @cached_property
    def written(self) -> Remembered[CurveInEffect, WrittenCurve]:
        """Curves as texts."""
        return Remembered(self._remembered)

    @cached_property
    def whole(self) -> Remembered[tuple[State, Instant], WrittenAnswer]:
        """Answers for all paths at an instant, as the ledger stands."""
        return Remembered(WHOLE_REMEMBERED)

    def answer_all(self, at: Instant, write: Callable[[InEffect], WrittenAnswer]) -> WrittenAnswer:
        """Answer for all paths at an instant, as the ledger stands: written once for each instant."""
        state = self._read_state()
        for kept in self.whole.get_many([(state, at)], lambda _: {}).values():
            return kept
        written = write(self.in_effect(at, select_paths(self.instrument, None, None, None)))
        if self._read_state() == state:
            self.whole.get((state, at), lambda: written)
        return written

    def _read_state(self) -> State:
        return self.database.ask(
            lambda s: (
                s.ledger.newest_number(), s.ledger.newest_instant(),
                tuple(s.changes.kept()), tuple(s.versions.waiting()), tuple(s.alarms.doubts()),
            )
        )  # fmt: skip

    @property
    def _remembered(self) -> int:
        return max(FEWEST_REMEMBERED, len(self.instrument.antennas) * len(self.instrument.dipoles))

    def in_effect(
        self, at: Instant, paths: Sequence[Scope], as_of: Instant | None = None, *, hold: bool = False
    ) -> InEffect:
        """Curves in effect for paths at an instant; an error naming the neighbours if there is none for any of them."""
        stations = {path.station for path in paths}
        near = next(iter(stations)) if len(stations) == 1 else None
        asked, kept = self.database.ask(lambda s: (s.ledger.answers(paths, at, as_of), s.changes.kept(near, as_of)))
        waits, doubts = ({}, {}) if as_of is not None else self._ask_of_now(at, None if near is None else paths)
        of_antenna, dismissed = group_by_antenna(kept), [one for one in kept if one.decision == DISMISSED]
        answers = pick_answering(asked)
        held: dict[Scope, Neighbour] = {}
        if len(answers) < len(paths) and (hold or not answers):
            asked, answers, held = self._look_around(at, paths, as_of, waits, of_antenna, hold=hold)
        waits_at = {at: waits} | {
            last: self._ask_of_now(last, None if near is None else paths)[0]
            for last in ({one.last for one in held.values()} if as_of is None else ())
        }
        names = (str(promotion.calibration) for promotion in answers.values())
        versions = self.versions.get_many(names, lambda ids: self.database.look(lambda s: s.versions.get_many(ids)))
        lacking = [path for path, said in answers.items() if not versions[str(said.calibration)].serves(path.dipole)]
        if lacking:
            array, of_array = self._ask_array(at, as_of)
            versions |= of_array
            for path in lacking:
                asked[path] = [*asked[path], *array]
                del answers[path]
                held.pop(path, None)
                answers.update((path, one) for one in array if of_array[str(one.calibration)].serves(path.dipole))
            if not answers:
                name = name_path(*lacking[0].parts)
                raise NotInEffectError(f"{name}: the mean that is in effect has no curve of this dipole")
        named = (name for version in versions.values() for name in version.budgets)
        cuts = {one.scope: _list_cuts(one.scope, of_antenna) for one in answers.values()}
        dates = {(scope, cut.date) for scope, of_scope in cuts.items() for cut in of_scope}
        bridging = self.database.ask(lambda s: s.ledger.bridging(dates, as_of)) if dates else {}
        budgets = self.budgets.get_many(named, lambda ids: self.database.look(lambda s: s.budgets.get_texts(ids)))
        # asked once a version and change, however many paths the version answers for
        have_spectra = cache(lambda *of: self.database.ask(lambda s: all(map(s.spectra.has_usable, of))))

        def list_curves(path: Scope, promotion: Promotion) -> Iterator[CurveInEffect]:
            """The curve that a path is served; of an array that was asked for by itself, those of its chains."""
            version, trace = versions[str(promotion.calibration)], tuple(asked[path])
            is_held, last = path in held, held[path].last if path in held else at
            chain = version.chains.get(str(path.dipole))
            records = () if chain is None else chain.cables.records.get(path.parts[:2], ())
            scope, epoch = promotion.scope, _find_epoch(path, at, of_antenna, records)
            newer = _list_waiting(path, promotion, version, waits if is_held else {}, waits_at.get(last, {}))[:1]
            between = epoch, next(iter(newer), None), _find_dismissed(dismissed, scope, version)
            said = [(cut, bridging.get((scope, cut.date))) for cut in cuts[scope]]
            over = [(cut, by) for cut, by in said if by and by.calibration == promotion.calibration]
            warnings = [
                *(_warn_over(cut, by, version, at) for cut, by in over),
                *_warn_of_both(path, version, of_antenna, have_spectra),
                *_warn_near(path, epoch, at, of_antenna, version),
                *(doubts[of] for of in (path, version.id) if of in doubts),
                *(one.sentence for one in newer if one.doubts_wider and one.scope != scope),
            ]
            told = [*_warn_held(path, at, last, of_antenna, records), *list(filter(None, warnings))[:1]]
            slow, step = find_slow(scope, of_antenna), last // SLOW_STEP_US
            followed = slow, step * SLOW_STEP_US + SLOW_STEP_US // 2 if slow else None, version, at
            cable = version.cable_of(path, at)
            unknown = at if cable is None and chain is not None else None
            of_version = promotion, is_held, trace, cable, unknown, "; ".join(told) or None, *between, *followed
            for dipole in [path.dipole] if path.dipole else [curve.dipole for curve in version.curves]:
                yield CurveInEffect(path, dipole, *of_version)

        curves = [curve for path in paths if path in answers for curve in list_curves(path, answers[path])]
        return InEffect(at, curves, [path for path in paths if path not in answers], budgets)

    def _ask_of_now(
        self, at: Instant, paths: Sequence[Scope] | None
    ) -> tuple[dict[Scope, Waiting], dict[Scope | str, str]]:
        """What waits for a person in windows that hold an instant, of all paths or some; warnings of paths, versions.

        The newest spectra of these are left out of fits, or most of their events were flagged.
        """
        scopes = None if paths is None else {scope for path in paths for scope in path.widening}
        waiting, doubts = self.database.ask(lambda s: (s.versions.waiting(scopes, at), s.alarms.doubts()))
        return {one.scope: one for one in waiting}, {one.of: one.warning for one in doubts if one.since < at}

    def _ask_array(self, at: Instant, as_of: Instant | None) -> tuple[list[Promotion], dict[str, Version]]:
        """Ask the array for what a station's mean lacks, of which only the other dipole was recorded."""
        said = self.database.look(lambda s: s.ledger.decisive([Scope()], at, as_of))
        answers = [one for one in said.values() if one.calibration is not None]
        names = [str(one.calibration) for one in answers]
        return answers, self.database.look(lambda s: s.versions.get_many(names))

    def _look_around(
        self,
        at: Instant,
        paths: Sequence[Scope],
        as_of: Instant | None,
        waits: Mapping[Scope, Waiting],
        of_antenna: ByAntenna,
        *,
        hold: bool,
    ) -> tuple[dict[Scope, list[Promotion]], dict[Scope, Promotion], dict[Scope, Neighbour]]:
        """What was asked of the ledger, what answers, and what of it is held, where there is a gap; at one instant."""
        with self.database.read() as stores:
            asked = stores.ledger.answers(paths, at, as_of)
            decisive = pick_answering(asked)
            missing = [path for path in paths if path not in decisive]
            # without `hold` the sentence names the neighbours of one path only
            served = missing if hold else missing[:1]
            found = stores.ledger.neighbours({path: path.widening for path in served}, at, as_of)
        near = {path: _nearest(path, found[path], at, of_antenna) for path in missing} if hold else {}
        held = {path: neighbour for path, neighbour in near.items() if neighbour is not None}
        if missing and not decisive and not held:
            waiting = next((waits[scope].sentence for scope in missing[0].widening if scope in waits), None)
            why = [*_tell_withdrawn(asked[missing[0]]), *([waiting] if waiting else [])]
            raise NotInEffectError(_explain_gap(missing, found[missing[0]], at, as_of, why))
        return asked, decisive | {path: one.promotion for path, one in held.items()}, held

    def write(
        self, curves: Iterable[CurveInEffect], write: Callable[[CurveInEffect], WrittenCurve]
    ) -> list[WrittenCurve]:
        """Curves as texts; what was written once is not written again."""
        wanted = list(curves)
        texts = self.written.get_many(wanted, lambda missing: {curve: write(curve) for curve in missing})
        return [texts[curve] for curve in wanted]

    def edges(self, as_of: Instant) -> dict[str | None, list[Instant]]:
        """The instants between which every answer about a station (None: the array) is the same, in order."""
        with self.database.read() as stores:
            edges, cables = stores.ledger.edges(as_of), stores.versions.cable_changes()
            kept = stores.changes.kept(as_of=as_of)
        ends = {as_of}.union(*edges.values())
        followed = range(min(ends) // SLOW_STEP_US * SLOW_STEP_US, max(ends), SLOW_STEP_US)
        for change in kept:
            near = round(REACH * change.change.sigma)
            if change.bounds_epoch:
                date = change.change.date
                edges.setdefault(change.change.station, set()).update((date, date - near + 1, date + near))
            if change.slow is not None:
                edges.setdefault(change.change.station, set()).update(followed)
        everywhere = edges.get(None, set())
        found: dict[str | None, list[Instant]] = {None: sorted(everywhere)}
        for station in sorted({record.station for record in self.instrument.antennas}):
            changes = {math.ceil(seconds * SECOND_US) for seconds in cables.get(station, ())}
            found[station] = sorted(everywhere | edges.get(station, set()) | changes)
        return found


ByAntenna = Mapping[tuple[str | None, int | None], Sequence[KeptChange]]
"""Changes by the antennas that they are of; those of a whole station or the array stand under no antenna."""


def group_by_antenna(kept: Iterable[KeptChange]) -> ByAntenna:
    """Changes that bound epochs or that C follows, by the antennas that they are of."""
    found: dict[tuple[str | None, int | None], list[KeptChange]] = {}
    for one in kept:
        antennas: Sequence[int | None] = one.change.antennas or [None]
        for antenna in antennas if one.bounds_epoch or one.slow else ():
            found.setdefault((one.change.station, antenna), []).append(one)
    return found


def _list_cuts(scope: Scope, of_antenna: ByAntenna) -> list[Cut]:
    """The cuts of the windows of a scope."""
    own = _of(of_antenna, scope.station, scope.antenna)
    return [cut for one in own for cut in one.cuts if cut.antenna in (None, scope.antenna)]


def _find_dismissed(dismissed: Iterable[KeptChange], scope: Scope, version: Version) -> tuple[KeptChange, ...]:
    """The dismissed changes of a scope that would cut the window of its version, or that C would follow."""
    return tuple(
        one
        for one in dismissed
        if one.ended is None and one.change.station in (None, scope.station)
        and (not one.change.paths or scope.antenna in one.change.antennas)
        and (one.change.kind != STEP or version.is_over(one.change.date))
    )  # fmt: skip


def lacks_fit(cut: Cut, said: Promotion, version: Version) -> bool:
    """Whether what answers on both sides of a change waits for a refit: the mean over it that no person chose since."""
    return version.is_over(cut.date) and (said.by == SCHEDULER or said.at < cut.known)


def _warn_over(cut: Cut, said: Promotion, version: Version, at: Instant) -> str | None:
    """A warning about C while one version answers on both sides of a change; None on the side that it is of."""
    if lacks_fit(cut, said, version):
        return cut.warning
    who, day = name_path(cut.station, cut.antenna), format_instant(cut.date)[:10]
    side = "before" if version.until <= cut.date else "after"
    is_mean = version.is_over(cut.date)
    what = "the mean over it into effect" if is_mean else f"a version of {side} it into effect over it"
    is_of_side = not is_mean and (at < cut.date) == (side == "before")
    return None if is_of_side else f"{who} changed on {day}: {said.by} put {what} ({said.reason})"


def _warn_of_both(
    path: Scope, version: Version, of_antenna: ByAntenna, have_spectra: Callable[..., bool]
) -> Iterator[str]:
    """Warnings about C fitted to spectra of both sides of a change, of a mean or of what a person put there."""
    span = (version.curve_of(path.dipole) if path.dipole else version.curves[0]).span_unix
    for one in _of(of_antenna, path.station, path.antenna):
        date = one.change.date
        if not one.cuts or not concerns(one, path.antenna, path.dipole) or not version.is_over(date):
            continue
        sides = Window(version.since, date, version.scope), Window(date, version.until, version.scope)
        # without the span of its spectra, those that are there now tell
        if have_spectra(*sides) if span is None else span[0] < date / SECOND_US <= span[1]:
            who, day = name_path(path.station, path.antenna), format_instant(date)[:10]
            told = f"{who} changed on {day} (change {one.number})"
            yield f"{told}: C in effect was fitted to spectra of before and after"


def _warn_near(path: Scope, epoch: Epoch, at: Instant, of_antenna: ByAntenna, version: Version) -> Iterator[str]:
    """Warnings about an instant of which the date of a change leaves open on which side it is, if C has less error."""
    ends = {epoch.because: (epoch.start, epoch.start_sigma), epoch.ended_by: (epoch.end, epoch.end_sigma)}
    for one in _of(of_antenna, path.station, path.antenna):
        date, sigma = ends.get(one.number, (None, 0))
        if date is None or abs(at - date) >= REACH * sigma or not concerns(one, path.antenna, path.dipole):
            continue
        size = one.change.of(path.antenna, path.dipole).size or math.inf
        if path.dipole is None or abs(size) > version.curve_of(path.dipole).typical_error:
            who, day = name_path(path.station, path.antenna), format_instant(date)[:10]
            told = f"{who} changed on {day} ± {sigma / DAY_US:.1f} days (change {one.number})"
            yield f"{told}: C may still be that of the other side"


def _list_waiting(
    path: Scope, said: Promotion, version: Version, of_gap: Mapping[Scope, Waiting], beside: Mapping[Scope, Waiting]
) -> list[Waiting]:
    """List what waits in a gap of a path, and what is narrower or newer than the version that answers beside it."""
    alike = path.widening[: path.widening.index(said.scope) + 1]
    newer = [beside[one] for one in alike if one in beside]
    in_gap = [of_gap[one] for one in alike if one in of_gap]
    return [*in_gap, *(one for one in newer if one.scope != said.scope or one.made > version.made)]


def _warn_held(
    path: Scope, at: Instant, last: Instant, of_antenna: ByAntenna, records: Iterable[AntennaRecord]
) -> Iterator[str]:
    """Warnings about changes of a path between an instant and the one at which what is held was last in effect."""
    own = [one for one in _of(of_antenna, path.station, path.antenna) if concerns(one, path.antenna, path.dipole)]
    sizes: dict[int | None, str] = {
        one.number: f" by {write_change(of.size, of.size_sigma or 0.0)}"
        for one in own
        if (of := one.change.of(path.antenna, path.dipole)).size is not None
    }
    for epoch in split_epochs(path, own, records):
        if epoch.start is not None and min(at, last) < epoch.start <= max(at, last):
            who, day = name_path(path.station, path.antenna), format_instant(epoch.start)[:10]
            told = "a record of the instrument" if epoch.because is None else f"change {epoch.because}"
            side = "before" if last < at else "after"
            yield f"{who} changed on {day}{sizes.get(epoch.because, '')} ({told}): C held is that of {side}"


def _find_epoch(path: Scope, at: Instant, of_antenna: ByAntenna, records: Sequence[AntennaRecord]) -> Epoch:
    """The epoch of a path, or of a whole station, in which an instant lies: both dipoles are cut alike."""
    own = _of(of_antenna, path.station, path.antenna)
    return next(one for one in split_epochs(path, own, records) if one.end is None or at < one.end)


def _of(of_antenna: ByAntenna, station: str | None, antenna: int | None) -> list[KeptChange]:
    """The changes of an antenna, of its whole station and of the array."""
    return [one for key in {(None, None), (station, None), (station, antenna)} for one in of_antenna.get(key, ())]


def find_slow(scope: Scope, of_antenna: ByAntenna) -> tuple[KeptChange, ...]:
    """The ramps and seasons that C of a version follows: its own, its station's and the array's, one of a kind each."""
    near = _of(of_antenna, scope.station, scope.antenna)
    own = [one for one in near if one.slow and concerns(one, scope.antenna, scope.dipole)]
    own.sort(key=lambda one: one.rank)
    return tuple({(one.change.kind, one.change.station, not one.change.paths): one for one in own}.values())


def follow(served: ServedCurve, version: Version, slow: Iterable[KeptChange], at: Instant) -> ServedCurve:
    """A curve of a version carried along slow changes to an instant."""
    since, until = (one / SECOND_US for one in version.window)
    return follow_slow_changes(served, [one.slow for one in slow if one.slow], at / SECOND_US, (since, until))


def follow_through(
    stretch: Stretch, served: ServedCurve, version: Version, slow: Sequence[KeptChange]
) -> list[tuple[Instant, ServedCurve]]:
    """A curve of a version along slow changes, every 30 days of a stretch in effect."""
    since, until = stretch.start or version.since, stretch.end or version.until
    return [(at, follow(served, version, slow, at)) for at in range(since, until, SAMPLED_US)]


def _tell_withdrawn(asked: Iterable[Promotion]) -> list[str]:
    """What was withdrawn of the scopes on the way to an answer."""
    return [
        f"what {name_path(*one.scope.parts)} has from {format_instant(one.valid_from)} to "
        f"{format_optional(one.valid_to) or 'open'} was withdrawn {format_instant(one.at)[:19]}Z by {one.by} "
        f"({one.reason})"
        for one in asked
        if one.calibration is None
    ]


def _nearest(path: Scope, neighbours: Neighbours, at: Instant, of_antenna: ByAntenna) -> Neighbour | None:
    """The nearer of two neighbours on the same side of the changes of a path; of equally near ones that before."""
    near = [neighbour for neighbour in neighbours if neighbour is not None]
    is_beyond = {one: any(_warn_held(path, at, one.last, of_antenna, ())) for one in near}
    return min(near, key=lambda one: (is_beyond[one], abs(one.instant - at)), default=None)


def _explain_gap(
    missing: Sequence[Scope], neighbours: Neighbours, at: Instant, as_of: Instant | None, why: Sequence[str]
) -> str:
    before, after = neighbours
    path = name_path(*missing[0].parts)
    path += "" if len(missing) == 1 else f" or any of the {len(missing)} paths asked for"
    sentence = f"no calibration is in effect for {path} at {format_instant(at)}"
    if before is None and after is None:
        known = "" if as_of is None else f", as known at {format_instant(as_of)}"
        return "; ".join([f"{sentence}, and none was or will be at another time{known}", *why])
    named = []
    if before is not None:
        named.append(f"{before.promotion.calibration} was until {format_instant(before.instant)}")
    if after is not None:
        named.append(f"{after.promotion.calibration} is from {format_instant(after.instant)}")
    hold = "gap=hold of GET /v1/calibrations/effective answers with the nearest"
    return "; ".join([f"{sentence}: {' and '.join(named)}", *why, hold])
