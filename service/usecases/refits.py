"""Refits: asked for by an admin, or due because the daily run found new events; done part by part."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from lbacal.instants import DAY_US, SECOND_US, format_instant
from lbacal_core.calibration.windows import leave_out_changed
from lbacal_core.causes.model import Model
from lbacal_core.curves.covariance import Budget, parse_budget
from lbacal_core.curves.validity import Instant, Promotion, Scope, list_deciding, timeline
from lbacal_core.discovery.adopted import measure_gains
from lbacal_core.discovery.calibrate import FittedCauses
from lbacal_core.errors import BadInputError
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.blocks import Recorded
from lbacal_core.spectra.spectra import Spectra
from service.config import Settings
from service.errors import ConflictError
from service.storage.changes import IN_FORCE, KeptChange, concerns
from service.storage.database import Database, Stores
from service.storage.jobs import Order, Part
from service.storage.ledger import is_of_person
from service.storage.models import ADOPTED, Gain
from service.storage.processes import SCHEDULER
from service.storage.sums import KeptPiece, Served, ServedKey, Sums, read_pieces
from service.storage.versions import Examined, Version
from service.usecases.calibrations import select_paths
from service.usecases.fits import (
    SMALLEST_SHIFT,
    Fits,
    Made,
    Wanted,
    find_standing,
    is_still_served,
    keep_fit,
    keep_served,
    read_part,
    read_served,
)
from service.usecases.gate import Gate, find_shift
from service.usecases.orders import name_inputs, place_order, read_window
from service.usecases.retractions import withdraw_retracted
from service.usecases.windows import ALONE, Neighbours
from service.wire.bodies import RefitBody

KIND = "refit"
MOST_RECALLED = 8
"""So many of the last versions of a window are looked through for the one of before a decision that was undone."""
Span = tuple[Instant, Instant]


@dataclass(frozen=True)
class Refits:
    """Makes versions from stored spectra."""

    database: Database
    simulation: Simulation
    fits: Fits
    gate: Gate
    settings: Settings
    name_now: Callable[[Stores, Part], Order | None]
    clock: Callable[[], Instant]

    def request(self, body: RefitBody, by: str) -> int:
        """Enqueue what an admin asks for: one part for the array, else one a station, with the model adopted now."""
        since, until = read_window(body.since, body.until)
        if until - since > self.settings.max_window_days * DAY_US:
            most = f"a window of at most {self.settings.max_window_days:g} days (LBACAL_MAX_WINDOW_DAYS)"
            raise BadInputError("body.until", most, f"{(until - since) / DAY_US:.0f} days")
        scope = Scope(body.station, body.antenna, body.dipole)
        select_paths(self.simulation.instrument, scope.station, scope.antenna, scope.dipole)
        is_too_narrow = {"array": scope != Scope(), "station": scope.antenna is not None, "antenna": False}
        if is_too_narrow[body.scope]:
            raise BadInputError("body", f"nothing narrower than the scope {body.scope}", scope.key)
        inputs = name_inputs(self.simulation).text
        with self.database.write() as stores:
            stations = [scope.station] if scope.station else stores.spectra.stations()
            if not stations:
                raise ConflictError("no spectra are stored: ingest some, then ask for a refit")
            wanted = [Scope()] if body.scope == "array" else [Scope(s, scope.antenna, scope.dipole) for s in stations]
            parts = []
            for one in wanted:
                model = stores.models.during(one.station, since, until)
                stores.models.put(model)
                part = describe_part(body.scope, one, since, until, model, promote=body.promote)
                parts.append(part if body.fit == "years" else {**part, "fit": body.fit})
            order = Order(KIND, body.model_dump(), parts, body.reason, by, inputs=inputs)
            return place_order(stores, order, self.settings.max_open_parts, self.clock)

    def run(self, part: Part, worker: str) -> None:
        """Do a part: read, fit, then write versions, promotions and the end of the part in one transaction.

        Due work reads the events that came since, and everything only where these could be news.
        """
        if part.is_due and self._examine(part, worker):
            return
        with self.database.read() as stores:
            wanted, read = self._read(stores, part), self.name_now(stores, part)
            block = self.fits.name_block(stores, wanted)
            spectra = self.fits.load(stores, wanted)
            is_alone = part.request.get("fit") == "year"
            neighbours = ALONE if is_alone else self.fits.find_neighbours(stores, wanted)
            known = find_known_until(stores, wanted)
            of_array = _fit(self.fits, spectra, wanted, neighbours, known) if wanted.scope == "array" else None
        made, gains = of_array or self.fits.elsewhere(_fit, spectra, wanted, neighbours, known)
        with self.database.write() as stores:
            said = _read_said(stores, block) if part.is_due else {}
            kept = self._keep(stores, made.versions, part, said, neighbours)
            is_night = part.is_due and part.request["promote"]
            withdrawn = list(_withdraw_gaps(stores, made.versions, part)) if is_night else []
            if is_night:
                answered = [key for key, one in kept.served.items() if one.is_in_effect]
                scopes = [one for one in stores.spectra.scopes_of(wanted.of.station) if one.level == wanted.scope]
                withdrawn += withdraw_retracted(stores, scopes, wanted.since, wanted.until, answered)
            if part.request["promote"]:
                keep_fit(stores, block, made, kept.served)
            if kept.result["calibrations"]:
                stores.budgets.add(made.budgets)
            stores.models.put_gains(gains)
            # the end of the part before the promotions, whose instant must be the last thing before the commit
            stores.jobs.complete(part, worker, kept.result, self.clock(), read)
            stores.ledger.append([*kept.promotions, *withdrawn], self.clock)

    def _read(self, stores: Stores, part: Part) -> Wanted:
        name = part.request.get("model")
        model = Model() if name is None else stores.models.get(name)
        return read_part(stores, part.request, model, part.by, part.reason)

    def _examine(self, part: Part, worker: str) -> bool:
        """Do a part by the events that came since, where these are no news of most paths; whether that was so."""
        with self.database.read() as stores:
            wanted, read = self._read(stores, part), self.name_now(stores, part)
            block = self.fits.name_block(stores, wanted) if wanted.model.is_plain else None
            later = None if block is None else self.fits.read_later(stores, block, wanted.window)
            neighbours = self.fits.find_neighbours(stores, wanted)
            pieces = [] if later is None else read_pieces(later.block.arrays)
            before = _list_before(stores, pieces, stores.changes.kept(wanted.of.station))
        if later is None:
            return False
        found = self.fits.elsewhere(Fits.examine, pieces, later.spectra, neighbours, before)
        # of what other years changed the whole window is fitted, as it was at first: same input, same id
        if found is None or (found.rest and later.spectra is None):
            return False
        made = [self._fit_path(wanted, path, pieces, neighbours) for path in found.rest]
        versions = [one for of_path in made for one in of_path.versions]
        with self.database.write() as stores:
            stores.ledger.lock()
            if _explain_other_model(stores, part) or not is_still_served(stores, pieces):
                return False
            kept = self._keep(stores, versions, part, _list_said(pieces), neighbours)
            stores.versions.confirm(found.examined)
            if versions:
                keep_served(
                    stores, later.block, pieces, kept.served, [one for of_path in made for one in of_path.pieces]
                )
            kept.result["examined"] += len(found.examined)
            stores.jobs.complete(part, worker, kept.result, self.clock(), read)
            stores.ledger.append(kept.promotions, self.clock)
        return True

    def _fit_path(self, wanted: Wanted, path: Scope, pieces: Sequence[KeptPiece], neighbours: Neighbours) -> Made:
        """Fit one path from all its spectra, with the budget of the last fit of the whole station."""
        served = next(one for piece in pieces for one in piece.served if one.scope == path)
        of_path = replace(wanted, of=path)
        with self.database.read() as stores:
            spectra = self.fits.load(stores, of_path)
            before = stores.versions.get_many([served.calibration])[served.calibration]
            covariance = before.curves[0].covariance
            name = None if covariance is None else covariance.budget
            budget = None if name is None else parse_budget(stores.budgets.get(name))
        made, _ = self.fits.elsewhere(_fit, spectra, of_path, neighbours, {}, budget)
        return made

    def _keep(self, stores: Stores, made: list[Version], part: Part, said: Said, neighbours: Neighbours) -> _Kept:
        """Store new versions, each with the objection of the gate if promotion was asked for.

        What the gate compares with must not change before the promotions are written: the ledger is locked first. Due
        work leaves no version where C hardly moved from the one in effect.
        """
        kept = _Kept()
        if not part.request["promote"]:
            stores.versions.add(made)
            kept.result["calibrations"] = [version.id for version in made]
            return kept
        stores.ledger.lock()
        for window in dict.fromkeys(version.window for version in made):
            self._keep_window(stores, [v for v in made if v.window == window], part, said, neighbours, kept)
        return kept

    def _keep_window(
        self, stores: Stores, made: list[Version], part: Part, said: Said, neighbours: Neighbours, kept: _Kept
    ) -> None:
        """Store the new versions of one window.

        What somebody put into effect since due work spoke of the window last stays, while it would say the same again;
        what a person withdrew stays withdrawn, and what would answer there all over the window waits for a person.
        Where windows are again what they were, the version of then answers again, if C hardly moved since.
        """
        since, until = made[0].window
        scopes = [version.scope for version in made]
        changes = {scope: neighbours.changes_of(scope) for scope in scopes}
        standing = find_standing(stores, scopes, since, until)
        own = {scope: said[scope, since, until] for scope in scopes if (scope, since, until) in said}
        aside = {scope: one.calibration for scope, one in own.items() if standing.get(scope) != one.calibration}
        versions = stores.versions.get_many({*standing.values(), *aside.values()})
        superseded, kept_changes = _explain_other_model(stores, part), stores.changes.kept(part.request["station"])
        gated = {name: superseded or told for name, told in self.gate.judge(stores, made, kept_changes).items()}
        rest = _find_rest(stores, scopes, since, until) if part.is_due else {}
        waiting = {scope: told for scope, (spans, told) in rest.items() if not spans}
        examined = dict[Scope, Examined]()
        stays = set[Scope]()
        for v in made if part.is_due else []:
            name = aside.get(v.scope) or standing.get(v.scope)
            is_same = v.id == name
            answering, served_last = versions.get(str(name)), own.get(v.scope)
            alike = _find_alike(kept_changes, v.scope)
            one = None if is_same else _confirm(stores, v, answering, served_last, changes[v.scope], alike)
            if gated[v.id] is None and one is not None:
                examined[v.scope] = one
                versions |= stores.versions.get_many([one.calibration])
            is_again = v.scope in aside and (is_same or (one is not None and one.calibration == name))
            if is_again or (v.scope not in standing and _is_set_apart(stores, v, said)):
                stays.add(v.scope)
        news = [v for v in made if v.scope not in examined]
        stores.versions.confirm(list(examined.values()))
        stores.versions.add([replace(v, gate=gated[v.id] or waiting.get(v.scope)) for v in news])
        passed = {v.scope: v.id for v in news if gated[v.id] is None}
        answers = {scope: one.calibration for scope, one in examined.items()} | passed
        promoted = [
            Promotion(0, scope, *span, name, 0, part.by, part.reason)
            for scope, name in answers.items()
            if scope not in stays and standing.get(scope) != name
            for span in rest.get(scope, ([(since, until)], ""))[0]
        ]
        kept.promotions += promoted
        again = [of for of, name in passed.items() if part.is_due and name in (standing.get(of), aside.get(of))]
        kept.result["calibrations"] += [v.id for v in news if v.scope not in again]
        kept.result["promoted"] += list(dict.fromkeys(one.calibration for one in promoted))
        kept.result["gated"] |= {name: objection for name, objection in gated.items() if objection is not None}
        kept.result["gated"] |= {passed[of]: told for of, told in waiting.items() if of in passed and of not in stays}
        kept.result["examined"] += len(examined) + len(again)
        in_effect = {scope: {passed.get(scope), standing.get(scope)} for scope in scopes}
        served = {v.scope: read_served(v, changes[v.scope], is_in_effect=v.id in in_effect[v.scope]) for v in news}
        served |= {
            of: read_served(versions[one.calibration], changes[of], is_in_effect=True) for of, one in examined.items()
        }
        kept.served |= {
            (scope, since, until): replace(own.get(scope, one), changes=one.changes) if scope in stays else one
            for scope, one in served.items()
        }


@dataclass
class _Kept:
    """What a part leaves behind; its result is as jobs tell it."""

    result: dict[str, Any] = field(
        default_factory=lambda: {"calibrations": [], "promoted": [], "gated": {}, "examined": 0}
    )
    promotions: list[Promotion] = field(default_factory=list)
    served: dict[ServedKey, Served] = field(default_factory=dict)


Said = Mapping[ServedKey, Served]
"""What due work put into effect last, by scope and window."""


def _fit(
    fits: Fits,
    spectra: Recorded,
    wanted: Wanted,
    neighbours: Neighbours,
    known: Mapping[str, Instant],
    budget: Budget | None = None,
) -> tuple[Made, list[Gain]]:
    """What a fit makes of spectra, and what its causes gained."""
    whole = fits.fit_causes(spectra, wanted.model)
    made = fits.make(whole, wanted, neighbours, budget)
    return made, measure_payoff(whole, wanted, known, fits.simulation, fits.clock())


def _read_said(stores: Stores, now: Sums) -> Said:
    """What was put into effect when a fit of a block was kept last."""
    kept = stores.sums.get(now.kind, now.scope, now.since, now.until)
    return {} if kept is None else _list_said(read_pieces(kept.arrays))


def _list_said(pieces: Sequence[KeptPiece]) -> Said:
    return {(one.scope, of.since, of.until): one for of in pieces for one in of.served if one.is_in_effect}


def _is_set_apart(stores: Stores, version: Version, said: Said) -> bool:
    """Whether a version answers in a part of its window, and in all the rest what somebody put there."""
    since, until = version.window
    stretches = timeline(stores.ledger.standing([version.scope], since, until), version.scope)
    inside = {
        one.calibration
        for one in stretches
        if (one.start is None or one.start < until) and (one.end is None or one.end > since)
    }
    names = {one.calibration for (scope, *_), one in said.items() if scope == version.scope}
    is_somebodys = bool(inside - names - {version.id})
    return version.id in inside and None not in inside and is_somebodys


def _confirm(
    stores: Stores,
    new: Version,
    in_effect: Version | None,
    said: Served | None,
    changes: Sequence[Instant],
    alike: Instant,
) -> Examined | None:
    """The fit as a confirmation of the version in effect, or of one that answered before; None if it is news.

    What answered when changes were in force as now for the last time before comes first: by a decision that is undone C
    comes back in several fits, of which the first may still differ. Then the first near enough of those of the same
    spectra answers: the same fit has the same answer whenever it is made. Else it is the one in effect, or an earlier.
    """
    promotions = stores.ledger.of_interval(new.scope, *new.window, MOST_RECALLED)
    names = list(dict.fromkeys(str(p.calibration) for p in promotions))
    if new.id in names:
        return None
    then = stores.versions.get_many(names)
    before = [str(p.calibration) for p in promotions if p.at <= alike][:1]
    of_same = [name for name in names if then[name].inputs["spectra"] == new.inputs["spectra"]]
    ordered = (*before, *sorted(of_same, key=lambda name: then[name].made))  # by promotion two would take turns
    one = next((again for name in ordered if (again := _examine(new, then[name]))), None)
    if one is not None:
        return one
    one = _examine(new, in_effect)
    is_decided = said is not None and said.changes not in (None, changes)
    if one is not None and not is_decided:
        return one
    recalled = next((again for name in names if (again := _examine(new, then[name]))), None)
    return min((again for again in (recalled, one) if again is not None), key=lambda again: again.shift, default=None)


def _find_alike(changes: Iterable[KeptChange], scope: Scope) -> Instant:
    """When the changes of a scope in force were those of now for the last time before others were; 0 if never."""
    acts: list[tuple[Instant, int, bool]] = []
    for one in changes:
        if concerns(one, scope.antenna, scope.dipole):
            acts.append((one.made, one.number, replace(one, decisions=()).decision == IN_FORCE))
            acts += [(said.at, one.number, said.decision == IN_FORCE) for said in one.decisions]
            acts += [] if one.ended is None else [(one.ended, one.number, False)]
    held: dict[int, bool] = {}
    steps = []
    for at, number, is_in_force in sorted(acts, key=lambda act: act[0]):
        steps.append((at, number, held.get(number, False)))
        held[number] = is_in_force
    others, were_others = set[int](), False
    for at, number, was_in_force in reversed(steps):
        (others.discard if was_in_force == held[number] else others.add)(number)
        if were_others and not others:
            return at
        were_others = were_others or bool(others)
    return 0


def _list_before(stores: Stores, pieces: Sequence[KeptPiece], changes: Sequence[KeptChange]) -> dict[ServedKey, Served]:
    """What scopes were served when changes were in force as now last, where something else answers since."""
    found = {}
    for of in pieces:
        for served in of.served:
            if not (alike := _find_alike(changes, served.scope)):
                continue
            promotions = stores.ledger.of_interval(served.scope, of.since, of.until, MOST_RECALLED)
            name = next((str(p.calibration) for p in promotions if p.at <= alike), served.calibration)
            if name != served.calibration:
                versions = stores.versions.get_many([name, served.calibration])
                if find_shift(versions[name], versions[served.calibration]) is not None:
                    found[served.scope, of.since, of.until] = read_served(versions[name], (), is_in_effect=False)
    return found


def _withdraw_gaps(stores: Stores, made: Sequence[Version], part: Part) -> Iterator[Promotion]:
    """Withdraw what due work put into effect over a change where the pieces of the window give no C.

    It would answer there for ever, and in a service that got the same spectra after the change nothing does. Whoever
    adopted a cause that this is the fit of withdrew nothing: later pieces may answer.
    """
    window = part.request["since"], part.request["until"]
    for scope in dict.fromkeys(v.scope for v in made):
        with_c = sorted(
            v.window for v in made if v.scope == scope and (v.window == window or v.curves[0].c is not None)
        )
        for start, end in _between(window, with_c):
            for one in list_deciding(stores.ledger.standing([scope], start, end), scope, start, end):
                if one.by == part.by and one.calibration is not None:
                    yield replace(one, calibration=None, by=SCHEDULER, reason=part.reason)


def _between(window: Span, spans: Iterable[Span]) -> list[Span]:
    """The parts of a window that spans in it, in order, leave free."""
    edges = [window[0], *(edge for span in spans for edge in span), window[1]]
    return [(start, end) for start, end in zip(edges[::2], edges[1::2], strict=True) if start < end]


def _find_rest(
    stores: Stores, scopes: Sequence[Scope], since: Instant, until: Instant
) -> dict[Scope, tuple[list[Span], str]]:
    """The parts of a window that persons' withdrawals leave, by scope, and who withdrew the last of the others."""
    found = {}
    standing = stores.ledger.standing(scopes, since, until)
    for scope in {one.scope for one in standing if is_of_person(one)}:
        own = [one for one in list_deciding(standing, scope, since, until) if is_of_person(one)]
        told = [f"withdrawn by {one.by} on {format_instant(one.at)[:10]} ({one.reason})" for one in own[-1:]]
        spans = _between((since, until), [(one.valid_from, one.valid_to or until) for one in own])
        found[scope] = spans, f"{''.join(told)}: nothing answers until a person promotes"
    return found


def _explain_other_model(stores: Stores, part: Part) -> str | None:
    """Why versions must not go into effect whose model was replaced while they were made; None where it was not."""
    wanted = part.request
    now = stores.models.during(wanted["station"], wanted["since"], wanted["until"])
    if wanted.get("model") == (None if now.is_plain else now.id):
        return None
    named = "the chain alone" if now.is_plain else f"model {now.id[:12]}"
    return f"{named} was adopted for this window after the fit was asked for"


def _examine(new: Version, in_effect: Version | None) -> Examined | None:
    """The fit as a confirmation of the version in effect; None if it is news, or that version itself."""
    if in_effect is None or in_effect.id == new.id:
        return None
    shift = find_shift(in_effect, new)
    if shift is None or shift >= SMALLEST_SHIFT:
        return None
    return Examined(new.scope, *new.window, new.id, in_effect.id, shift, new.made)


def describe_part(
    scope: str, of: Scope, since: Instant, until: Instant, model: Model, *, promote: bool
) -> dict[str, Any]:
    """A part of a refit as JSON: the scope of its versions, whose spectra they are made from, and the model.

    A model without causes is not named: parts are what they were before there were models.
    """
    return {
        "scope": scope, "station": of.station, "antenna": of.antenna, "dipole": of.dipole,
        "since": since, "until": until, "promote": promote, **({} if model.is_plain else {"model": model.id}),
    }  # fmt: skip


# What adopted causes gain on events that their adoption had not seen, measured by every later refit of the station.


def find_known_until(stores: Stores, wanted: Wanted) -> dict[str, Instant]:
    """The newest event that the adoption of each cause had seen, by the id of the cause; empty for other scopes."""
    if wanted.scope != "station" or wanted.model.is_plain:
        return {}
    changes = stores.models.changes(wanted.of.station)
    return {one.cause: one.known_until for one in changes if one.act == ADOPTED and one.known_until is not None}


def measure_payoff(
    whole: FittedCauses, wanted: Wanted, known_until: Mapping[str, Instant], simulation: Simulation, now: Instant
) -> list[Gain]:
    """The gain of every adopted cause on the events of a window that are new to it, its size as it was adopted."""
    found = list[Gain]()
    spectra = leave_out_changed(whole.recorded, simulation.instrument) if known_until else None
    if not isinstance(spectra, Spectra):
        return found
    names = list(whole.model.by_id)
    for last in sorted({known_until[name] for name in names if name in known_until}):
        is_new = spectra.time_unix > last / SECOND_US
        if not (is_new.any() and whole.stations):
            continue
        measured = measure_gains(spectra, simulation.with_causes(whole.model), is_new)
        found += [
            Gain(
                names[one.number], str(wanted.of.station), wanted.since, wanted.until, one.events, one.gain,
                one.expected, one.expected_sigma, now,
            )
            for one in measured
            if known_until.get(names[one.number]) == last
        ]  # fmt: skip
    return found
