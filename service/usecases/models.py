"""Adoption: a cause that an investigation named becomes part of a station's model, until it is withdrawn.

One transaction writes what the station has from now on and enqueues the refits: a killed process leaves both or none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from threadpoolctl import threadpool_limits

from lbacal.instants import format_instant, parse_instant
from lbacal_core.causes.model import UNEXPLAINED, AdoptedCause, Model
from lbacal_core.curves.covariance import Budget
from lbacal_core.curves.validity import Instant, Promotion, Scope, timeline
from lbacal_core.errors import BadInputError
from lbacal_core.provenance import Remembered, hash_content
from lbacal_core.spectra.blocks import Recorded
from service.errors import ConflictError
from service.storage.alarms import CAUSE_STOPPED_PAYING, News
from service.storage.database import Database, Stores
from service.storage.models import ADOPTED, WITHDRAWN, Announced, Gain, Investigation, ModelChange
from service.storage.processes import SCHEDULER
from service.storage.spectra import Window
from service.storage.versions import Version, mean_over_band
from service.usecases.calibrations import select_paths
from service.usecases.drift import year_of
from service.usecases.gate import find_change_of_mean
from service.usecases.promotions import LAST, Change, Promotions, undo
from service.wire.bodies import AdoptionBody, ReasonBody

if TYPE_CHECKING:
    from service.usecases.due import DueWork
    from service.usecases.fits import Fits, Made, Wanted
    from service.usecases.windows import Neighbours

SCOPES = ("antenna", "station")
"""Scopes of the fits that announce how C changes."""


@dataclass(frozen=True)
class Adoption:
    """A change of a station's model as it is planned.

    `before` is what the station has while the plan is made; `changes` are those of the curves that its paths are served
    in the year of the investigation.
    """

    change: ModelChange
    model: Model
    before: Model
    cause: AdoptedCause
    changes: Sequence[Change]


@dataclass(frozen=True)
class AdoptedModel:
    """A line of the ledger of models with what its causes gained; `is_in_effect` if the station still has it."""

    change: ModelChange
    model: Model
    changed: AdoptedCause
    is_in_effect: bool
    gains: Mapping[str, Sequence[Gain]]

    @property
    def gains_of_change(self) -> Sequence[Gain]:
        """The gains of the adopted or withdrawn cause, window by window."""
        return self.gains.get(self.change.cause, ())


@dataclass(frozen=True)
class Models:
    """Adopts causes, withdraws them, and lists what stations have and had."""

    database: Database
    fits: Fits
    promotions: Promotions
    due: DueWork
    planned: Remembered[str, Adoption]
    clock: Callable[[], Instant]

    def plan_adoption(self, name: str, body: AdoptionBody, by: str) -> Adoption:
        """Work out what the adoption of a finding changes in C, by fits of the year with the cause and without.

        Whoever adopts what was planned last in this process gets the same plan.
        """
        with self.database.read() as stores:
            made = stores.investigations.get(name)
            before = stores.models.current().of_stations([made.station])
            window = year_of(made.since)
            content = stores.spectra.content(Window(*window, Scope(made.station)))
            known = stores.spectra.count_covariates(*window, made.station).total()
            cuts = [[cut.antenna, cut.date] for cut in stores.changes.cuts(made.station, *window)]
            state = [made.id, body.finding, before.id, content, known, stores.ledger.newest_number(), cuts]
        plan = self.planned.get(hash_content(state), lambda: self._plan(made, before, window, body, by))
        return replace(plan, change=replace(plan.change, by=by, reason=body.reason))

    def _plan(
        self, made: Investigation, before: Model, window: tuple[Instant, Instant], body: AdoptionBody, by: str
    ) -> Adoption:
        from lbacal_core.discovery.adopted import promise_of
        from lbacal_core.discovery.calibrate import promise_of_structure
        from service.usecases.fits import read_fits

        model, cause = _adopt(before, made, body.finding)
        with self.database.read() as stores:
            now = [read_fits(stores, made.station)(scope, Scope(made.station), *window) for scope in SCOPES]
            of_window = [one.during(*(edge / 1e6 for edge in window)) for one in (before, model)]
            wanted = [[replace(fit, model=one, by=by, reason=body.reason) for fit in now] for one in of_window]
            # with its covariates, which fits without causes do not look at
            spectra = self.fits.load(stores, wanted[1][0])
            neighbours = [self.fits.find_neighbours(stores, one) for one in wanted[1]]
        with threadpool_limits(1):
            after = self._fit(spectra, wanted[1], neighbours)
            # what the year is compared with needs no budget of its own
            shared = next(iter(after[0].budgets.values()))
            before_it = self._fit(spectra, wanted[0], neighbours, shared)
        announced = {
            key: one
            for old, new in zip(before_it, after, strict=True)
            for key, one in _announce(old.versions, new.versions)
        }
        with self.database.read() as stores:
            changes = self.promotions.foresee(stores, after[0].versions, by, body.reason)
        is_named = body.finding != UNEXPLAINED
        finding = made.report["findings"][body.finding] if is_named else made.report["unexplained"]
        # a report gives its newest event to the second
        known_until = parse_instant("where.dates", finding["where"]["dates"][1]) + 1_000_000
        promise = promise_of(finding) if is_named else promise_of_structure(finding)
        change = ModelChange(
            0, made.station, ADOPTED, model.id, before.id, Model((cause,)).id, _instant(cause.since_unix),
            _instant(cause.until_unix), known_until, made.id,
            int(body.finding) if is_named else None, announced, (promise.gain, promise.sigma), LAST, by, body.reason,
        )  # fmt: skip
        return Adoption(change, model, before, cause, changes)

    def _fit(
        self,
        spectra: Recorded,
        wanted: Sequence[Wanted],
        neighbours: Sequence[Neighbours],
        budget: Budget | None = None,
    ) -> list[Made]:
        """The fits of a year by some scopes, as refits do them."""
        whole = self.fits.fit_causes(spectra, wanted[0].model)
        return [self.fits.make(whole, one, others, budget) for one, others in zip(wanted, neighbours, strict=True)]

    def adopt(self, plan: Adoption, *, promote: bool) -> list[int]:
        """Give a station the model that was planned, and enqueue the refits; returns their jobs."""
        with self.database.write() as stores:
            stores.ledger.lock()
            if stores.models.current().of_stations([plan.change.station]).id != plan.before.id:
                raise ConflictError(f"the model of {plan.change.station} changed meanwhile: look at the dry run again")
            return self._write(stores, plan.change, plan.model, plan.before, promote=promote)

    def withdraw(self, name: str, body: ReasonBody, by: str) -> tuple[Model, list[int]]:
        """Take the cause that made a model out of its station's, and put back what was in effect without it.

        Returns the model that the station has from now on, and the jobs of the refits.
        """
        with self.database.write() as stores:
            stores.ledger.lock()
            adopted = self._adoption_of(stores, name)
            before = stores.models.current().of_stations([adopted.station])
            if adopted.cause not in before.by_id:
                raise ConflictError(f"{adopted.station} no longer has the cause that made model {adopted.model[:12]}")
            model = before.without(list(before.by_id).index(adopted.cause))
            back = {
                key: Announced(-one.fraction / (1 + one.fraction), one.sigma) for key, one in adopted.announced.items()
            }
            change = replace(
                adopted, act=WITHDRAWN, model=model.id, before=before.id, announced=back, promise=None, by=by,
                reason=body.reason,
            )  # fmt: skip
            restored = list(self._restore(stores, adopted, model, by, body.reason))
            jobs = self._write(stores, change, model, before, promote=True)
            stores.ledger.append(restored, self.clock)
        return model, jobs

    def _write(self, stores: Stores, change: ModelChange, model: Model, before: Model, *, promote: bool) -> list[int]:
        stores.models.put(model, before, *(Model((cause,)) for cause in (*model.causes, *before.causes)))
        # later than all that stands: what it replaces is what was promoted before it
        at = max(self.clock(), (stores.ledger.newest_instant() or 0) + 1)
        made = stores.models.change(replace(change, at=at))
        return self.due.enqueue_model(stores, made, promote=promote)

    def _adoption_of(self, stores: Stores, name: str) -> ModelChange:
        whole = stores.models.get(name).id
        adoptions = [one for one in stores.models.changes() if one.act == ADOPTED and one.model == whole]
        if not adoptions:
            raise ConflictError(f"model {whole[:12]} was never adopted: nothing to withdraw")
        return adoptions[-1]

    def _restore(self, stores: Stores, adopted: ModelChange, model: Model, by: str, reason: str) -> Iterator[Promotion]:
        """Promote again what stood before an adoption, where a version with its cause stands now.

        Where nothing stood, as where the gate had held the fit back as a misfit, nothing answers again. A version that
        has other causes than the station has from now on does not come back: what is there stays until the refit.
        """
        paths = select_paths(self.promotions.instrument, adopted.station, None, None)
        scopes = {scope for path in paths for scope in path.widening}
        standing = stores.ledger.standing(scopes, adopted.since, adopted.until)
        earlier = stores.ledger.standing(scopes, adopted.since, adopted.until, before=adopted.at)
        versions = stores.versions.get_many(p.calibration for p in (*standing, *earlier) if p.calibration is not None)
        others = tuple(one for one in stores.models.current().causes if one.station != adopted.station)
        current = Model((*others, *model.causes))
        for scope in sorted(scopes, key=lambda scope: scope.key):
            for stretch in timeline([p for p in standing if p.scope == scope], scope):
                if stretch.start is None or not _has(versions.get(stretch.calibration or ""), adopted.cause):
                    continue
                replaced = Promotion(0, scope, stretch.start, stretch.end, stretch.calibration, LAST)
                for one in undo(replaced, earlier, by, reason):
                    version = versions.get(one.calibration or "")
                    if version is None:
                        yield replace(one, by=SCHEDULER)  # no person withdrew C: a fit may answer
                    elif version.model == _name_within(current, version):
                        yield one

    def history(self, station: str | None = None) -> list[AdoptedModel]:
        """Every change of a model, of one station or of all, newest first, with what its causes gained."""
        with self.database.read() as stores:
            changes = stores.models.changes(station)
            newest = {one.station: one.number for one in changes}
            gains: dict[str, list[Gain]] = {}
            for gain in stores.models.gains():
                gains.setdefault(gain.cause, []).append(gain)
            return [
                AdoptedModel(
                    one, stores.models.get(one.model), stores.models.get(one.cause).causes[0],
                    newest[one.station] == one.number, gains,
                )
                for one in reversed(changes)
            ]  # fmt: skip

    def stopped(self) -> list[News]:
        """Adopted causes that gained too little in the last window that measured it."""
        return [
            News(
                CAUSE_STOPPED_PAYING, Scope(one.change.station), name,
                f"{cause.sentence} On {gain.events} new events from {format_instant(gain.since)[:10]} on it gained "
                f"{gain.gain:.1f} in log-likelihood, expected {gain.expected:.1f} ± {gain.expected_sigma:.1f}",
                {"model": one.model.id, "gain": gain.gain, "expected": gain.expected},
            )
            for one in self.history()
            if one.is_in_effect
            for name, cause in one.model.by_id.items()
            for gain in list(one.gains.get(name, ()))[-1:]
            if gain.has_stopped_paying
        ]  # fmt: skip


def _adopt(before: Model, made: Investigation, number: int | str) -> tuple[Model, AdoptedCause]:
    """A station's model extended by a finding of a report, or its structure without a name; and the cause that it gets.

    `number` is as in `Model.adopt`.
    """
    report = made.report
    of_report = Model() if report.get("model") is None else Model.from_text(report["model"])
    if not of_report.by_id.keys() <= before.by_id.keys():
        raise ConflictError(
            f"investigation {made.id[:12]} was made with a cause that {made.station} no longer has: investigate again"
        )
    try:
        model = before.adopt(report, number, made.since // 1_000_000)
        cause = next(one for name, one in model.by_id.items() if name not in before.by_id)
        Model((cause,)).require_one_c("body.finding")
    except BadInputError as error:
        raise BadInputError("body.finding", error.expected, error.found) from error
    return model, cause


def _has(version: Version | None, cause: str) -> bool:
    """Whether there is a version and it was fitted with a cause."""
    text = None if version is None else version.inputs.get("settings", {}).get("model")
    return text is not None and cause in Model.from_text(text).by_id


def _name_within(current: Model, version: Version) -> str | None:
    """The id of the model that a version would have now; None for the chain alone."""
    model = current.during(*(edge / 1e6 for edge in version.window))
    model = model if version.scope.station is None else model.of_stations([version.scope.station])
    return None if model.is_plain else model.id


def _announce(before: Sequence[Version], after: Sequence[Version]) -> Iterator[tuple[str, Announced]]:
    """The change of mean C from one fit of the same spectra to another, by scope and dipole, where both have one."""
    old = {version.scope: version for version in before}
    for version in after:
        for curve in version.curves:
            dipole, predecessor = str(curve.dipole), old[version.scope]
            fraction = find_change_of_mean(version, predecessor, dipole)
            if fraction is None:
                continue
            means = [mean_over_band(one.curve_of(dipole)) for one in (predecessor, version)]
            errors = [sigma / mean for mean, sigma in (one for one in means if one is not None)]
            yield f"{version.scope.key} {dipole}", Announced(fraction, sum(e**2 for e in errors) ** 0.5)


def _instant(unix: int | None) -> Instant | None:
    return None if unix is None else unix * 1_000_000
