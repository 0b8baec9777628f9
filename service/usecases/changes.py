"""Changes of paths, as people see them: listed, entered by who knows of one, and decided about.

A change is refitted once the pieces of the windows that it cuts are in effect: until then one C answers on both sides.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from lbacal.instants import DAY_US, SECOND_US, parse_instant
from lbacal_core.causes.model import follows_date
from lbacal_core.curves.validity import Instant, Scope, timeline
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.spectra.spectra import span_of_record
from service.errors import ConflictError
from service.storage.changes import (
    COURSE,
    DISMISSED,
    IN_FORCE,
    INVESTIGATION,
    PERSON,
    RAMP,
    SEASON,
    STEP,
    Change,
    Decision,
    Evidence,
    KeptChange,
    concerns,
)  # fmt: skip
from service.storage.database import Database, Stores
from service.storage.models import Investigation
from service.usecases.calibrations import find_slow, follow_through, group_by_antenna, lacks_fit, select_paths
from service.usecases.doubts import find_doubts
from service.usecases.drift import year_of
from service.usecases.gate import Gate, compare_curves
from service.usecases.promotions import Change as ChangeOfC
from service.usecases.promotions import Promotions
from service.wire.bodies import ChangeBody, DecisionBody

if TYPE_CHECKING:
    from service.usecases.fits import Fits

INVESTIGATED_SIGMA_US = 3 * DAY_US
"""An investigation gives the event from which on a cause acts, and no error of that date."""
GAIN_STEP, GAIN_DRIFT = "gain_step", "gain_drift"
RIVAL_ODDS = 0.01
"""A step whose odds beside a ramp are better may be what that is."""
WORDS = {IN_FORCE: "in force", DISMISSED: "dismissed"}


def mark_refitted(stores: Stores, changes: Sequence[KeptChange], dipoles: Collection[str]) -> list[KeptChange]:
    """Changes with whether they are refitted: one whose antennas have versions in effect may not be.

    What a person put into effect over it since it is in force is no fit that is missing.
    """
    asked = [
        (one.number, cut, (Scope(cut.station, cut.antenna, None if cut.antenna is None else dipole), cut.date))
        for one in changes for cut in one.cuts for dipole in dipoles
    ]  # fmt: skip
    bridging = stores.ledger.bridging(place for *_, place in asked)
    versions = stores.versions.get_many(str(said.calibration) for said in bridging.values())
    over = [(number, cut, bridging[place]) for number, cut, place in asked if place in bridging]
    waiting = {number for number, cut, said in over if lacks_fit(cut, said, versions[str(said.calibration)])}
    return [replace(one, is_refitted=one.number not in waiting) for one in changes]


def propose(
    made: Investigation, instrument: Instrument, on_record: Sequence[KeptChange] = ()
) -> Iterator[tuple[Change, Evidence]]:
    """Propose the finding of an investigation along the date as a change; other findings are causes of the model.

    A ramp that may as well be a step, as between two campaigns, is the step in force of its antennas in the window.
    """
    steps = [one.change for one in on_record if one.steps and made.since < one.change.date < made.until]
    every = {(path.antenna, path.dipole) for path in select_paths(instrument, made.station, None, None)}
    for number, finding in enumerate(made.report["findings"]):
        is_ramp, dated = finding["cause"] == GAIN_DRIFT, finding["parameters"].get("date_unix")
        if not follows_date(finding["cause"], finding["parameters"]):
            continue
        where, size = finding["where"], finding["size"]
        paths = tuple((antenna, dipole) for antenna in where["antennas"] for dipole in where["dipoles"])
        paths = () if every <= set(paths) else paths
        since = (RAMP if is_ramp else COURSE, made.since, 0)
        change = Change(
            made.station, paths, *(since if dated is None else (STEP, round(dated * SECOND_US), INVESTIGATED_SIGMA_US))
        )
        if is_ramp or finding["cause"] == GAIN_STEP:
            of_c = (1.0 + size["value"]) ** -0.5  # C^2 is proportional to 1 / gain
            change = replace(change, size=of_c - 1.0, size_sigma=of_c * size["sigma"] / (1.0 + size["value"]) / 2.0)
        rivals = finding.get("evidence", {}).get("rivals", ())
        if is_ramp and any(one["cause"] == GAIN_STEP and one["odds"] > RIVAL_ODDS for one in rivals):
            change = next((one for one in steps if set(one.antennas) == set(change.antennas)), change)
        yield change, Evidence(INVESTIGATION, f"{made.id}#{number}", finding["significance_sigma"], made.made)


@dataclass(frozen=True)
class Changes:
    """Lists changes and takes decisions about them; the next look for due work finds the windows that these change."""

    database: Database
    instrument: Instrument
    promotions: Promotions
    find_fits: Callable[[], Fits]
    gate: Gate
    clock: Callable[[], Instant]

    def list_all(self, station: str | None = None) -> list[KeptChange]:
        """All changes on record, of all stations or of one."""
        with self.database.read() as stores:
            return mark_refitted(stores, stores.changes.kept(station), self.instrument.dipoles)

    def list_doubted(self, station: str | None = None) -> list[KeptChange]:
        """The same with what speaks against each."""
        with self.database.read() as stores:
            return self._doubt(stores, station)

    def enter(self, body: ChangeBody, by: str) -> KeptChange:
        """Put on record and into force what a person knows: of a change that was found, or of a new one."""
        change, now = self._read(body), self.clock()
        with self.database.write() as stores:
            stores.changes.note(change, Evidence(PERSON, by, None, now))
            same = [one.number for one in stores.changes.kept(change.station) if one.change.is_same(change)]
            decided = [stores.changes.decide(one, Decision(IN_FORCE, now, by, body.reason)) for one in same]
            return self._doubt_one(stores, decided[0])

    def decide(self, number: int, body: DecisionBody, by: str) -> KeptChange:
        """Put a change in force, or dismiss it, whatever its sources say."""
        with self.database.write() as stores:
            kept = _require_open(stores.changes.get(number), body.decision)
            decided = stores.changes.decide(kept.number, Decision(body.decision, self.clock(), by, body.reason))
            return self._doubt_one(stores, decided)

    def _doubt(self, stores: Stores, station: str | None) -> list[KeptChange]:
        changes = mark_refitted(stores, stores.changes.kept(station), self.instrument.dipoles)
        report = stores.drift.report() if any(one.is_spoken_of for one in changes) else None
        doubts = find_doubts(changes, report or {}, self.instrument.dipoles)
        return [replace(one, doubts=doubts[one.number]) for one in changes]

    def _doubt_one(self, stores: Stores, kept: KeptChange) -> KeptChange:
        return next(one for one in self._doubt(stores, kept.change.station) if one.number == kept.number)

    def foresee(self, number: int, body: DecisionBody, by: str) -> tuple[KeptChange, list[ChangeOfC], dict[str, str]]:
        """The change as it would be decided, and what that does to the curves of its paths, by fits of the year.

        And the versions that the gate would keep back, with its objections.
        """
        with self.database.read() as stores:
            kept = _require_open(stores.changes.get(number), body.decision)
            said = Decision(body.decision, self.clock(), by, body.reason)
            then = replace(kept, decisions=(*kept.decisions, said))
            others = [one for one in stores.changes.kept(kept.change.station) if one.number != number]
            if kept.slow or then.slow:
                return then, list(self._follow(stores, [*others, kept], [*others, then], kept)), {}
        if not [*kept.cuts, *then.cuts]:
            return then, [], {}
        return then, *self._fit(kept.change, year_of(kept.change.date), [*others, then], by)

    def _follow(
        self, stores: Stores, before: Sequence[KeptChange], after: Sequence[KeptChange], kept: KeptChange
    ) -> Iterator[ChangeOfC]:
        """The largest change of each stretch in effect by following a ramp or season, or by no longer doing so."""
        groups, station = [group_by_antenna(one) for one in (before, after)], kept.change.station
        paths = [one for one in select_paths(self.instrument, station, None, None) if concerns(kept, *one.parts[1:])]
        standing = stores.ledger.standing({scope for path in paths for scope in path.widening})
        in_effect = [(path, one) for path in paths for one in timeline(standing, path)]
        versions = stores.versions.get_many({str(one.calibration) for _, one in in_effect})
        for path, one in in_effect:
            version = versions.get(str(one.calibration))
            if version is None or one.start is None or not version.serves(path.dipole):
                continue
            served = version.serve(path, one.start)
            sampled = (follow_through(one, served, version, find_slow(version.scope, of)) for of in groups)
            changes = [compare_curves(was.curve, now.curve) for (_, was), (_, now) in zip(*sampled, strict=True)]
            most = max(changes, key=lambda change: change.max_fraction, default=None)
            if most is not None and most.max_fraction > 0.0:
                yield ChangeOfC(path, one.start, one.end, version.id, version.id, most)

    def _fit(
        self, change: Change, window: tuple[Instant, Instant], then: Sequence[KeptChange], by: str
    ) -> tuple[list[ChangeOfC], dict[str, str]]:
        from service.usecases.fits import Wanted

        cuts = [cut for one in then for cut in one.cuts]
        inside = tuple(cut for cut in cuts if cut.date < window[1])
        paths, fits = select_paths(self.instrument, change.station, None, None), self.find_fits()
        scopes = {path for path in paths if not change.paths or path.antenna in change.antennas}
        with self.database.read() as stores:
            model = stores.models.during(change.station, *window)
            wanted = Wanted("antenna", Scope(change.station), *window, model, by, "", inside)
            try:
                spectra = fits.load(stores, wanted)
            except ConflictError:
                return [], {}
            made = fits.make(fits.fit_causes(spectra, model), wanted, fits.find_neighbours(stores, wanted, cuts))
            versions = [one for one in made.versions if one.scope in scopes]
            told = dict[str, str | None]()
            for span in {one.window for one in versions}:
                told |= self.gate.judge(stores, [one for one in versions if one.window == span], then)
            passed = [one for one in versions if told[one.id] is None]
            return self.promotions.foresee(stores, passed, by, ""), {name: why for name, why in told.items() if why}

    def _read(self, body: ChangeBody) -> Change:
        """What a person says, held against the instrument."""
        given = [name for name in ("paths", "station", "array") if getattr(body, name) is not None]
        if len(given) != 1:
            raise BadInputError("body", "one of paths, station, array", " and ".join(given) or "none of them")
        stations: set[str | None] = {one.station for one in body.paths or ()} or {body.station}
        if len(stations) > 1:
            raise BadInputError("body.paths", "paths of one station", ", ".join(sorted(map(str, stations))))
        for one in body.paths or ():
            select_paths(self.instrument, one.station, one.antenna, one.dipole)
        (station,) = stations
        if station is not None:
            select_paths(self.instrument, station, None, None)
        paths = [(one.antenna, one.dipole) for one in body.paths or ()]
        if body.kind in (RAMP, SEASON) and body.size is None:
            raise BadInputError("body.size", f"the size of the {body.kind}, which C follows", "none")
        size = (None, None) if body.size is None else (body.size.value, body.size.sigma)
        date = parse_instant("body.at.value", body.at.value)
        first, last = span_of_record(self.clock() / SECOND_US)
        if not first <= date / SECOND_US <= last:
            expected = "an instant from 2009 until now, as of spectra; what comes is entered then"
            raise BadInputError("body.at.value", expected, body.at.value)
        return Change(station, tuple(dict.fromkeys(paths)), body.kind, date, round(body.at.sigma_days * DAY_US), *size)


def _require_open(kept: KeptChange, decision: str) -> KeptChange:
    if kept.ended is not None:
        raise ConflictError(f"change {kept.number} has ended: nobody who found it still does")
    if kept.decision == decision:
        raise ConflictError(f"change {kept.number} is {WORDS[decision]} already")
    return kept
