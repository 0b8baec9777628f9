"""Fits of stored spectra with the model that is adopted: versions, their budgets and what the causes gained.

Nothing is written here: a refit keeps what these functions make, and the dry run of an adoption shows it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from lbacal.engine import HERE, Engine, Result
from lbacal.instants import SECOND_US, format_instant
from lbacal_core.audit.audit import audit_quickly
from lbacal_core.calibration.budget import add_budget, compute_budget
from lbacal_core.calibration.continued import Continued, continue_fit
from lbacal_core.calibration.separable import solve_separable
from lbacal_core.calibration.singles import MIN_EVENTS, has_enough
from lbacal_core.calibration.windows import cut_window, find_hardware_changes
from lbacal_core.calibration.years import Beside, gain_modes
from lbacal_core.causes.model import Model
from lbacal_core.curves.covariance import Budget
from lbacal_core.curves.curves import CONVERGED, Anomalies, CalibrationCurve, FitReport
from lbacal_core.curves.kept_lines import KeptLines, Owner
from lbacal_core.curves.reference_chain import ReferenceChain
from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.discovery.calibrate import FittedCauses, fit_causes
from lbacal_core.errors import name_path, write_count
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.provenance import MODEL_VERSION, Remembered, hash_content
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.blocks import Recorded, SpectraByStation
from lbacal_core.spectra.spectra import Spectra
from service.errors import ConflictError
from service.storage.changes import Cut, is_same_date
from service.storage.database import Stores
from service.storage.ledger import is_of_person
from service.storage.spectra import Window
from service.storage.sums import KeptPiece, Served, ServedKey, Sums, name_pieces, read_pieces, write_pieces
from service.storage.versions import BEHIND, BUDGET, Examined, Version
from service.usecases.drift import year_of
from service.usecases.orders import hash_covariates
from service.usecases.windows import ALONE, Neighbours, name_beside, name_windows, scope_of, share_misfits

MOST_LOOKED_AT = 10_000
"""Spectra of stations whose unit is known to be that of power."""
Read = tuple[Window, tuple[int, int]]
"""A window, and what it held when it was read: `SpectraStore.content`."""


@dataclass(frozen=True)
class Wanted:
    """A fit: the scope of its versions, whose spectra they are made from, the window and the model; who wants it.

    `changed` are the dates at which antennas changed before the window's end, `undated` those that are known too badly
    to cut it: the gate counts them.
    """

    scope: str
    of: Scope
    since: Instant
    until: Instant
    model: Model
    by: str
    reason: str
    changed: tuple[Cut, ...] = ()
    undated: tuple[Cut, ...] = ()

    @property
    def taken_out(self) -> list[Cut]:
        """The changes that are taken out of a mean, so that it is that of its antennas before they changed.

        Those of known size, of any antenna or station for the array, of single antennas for a station; none for paths.
        """
        return [one for one in self.changed if self._is_part(one) and (one.power is not None or one.slow is not None)]

    @property
    def cuts(self) -> list[Cut]:
        """Where the window is cut."""
        inside = [one for one in self.changed if self.since < one.date and one.slow is None]
        return [one for one in inside if one.power is None or not self._is_part(one)]

    def _is_part(self, one: Cut) -> bool:
        """Whether what changed is a part of what is fitted: an antenna of a station, a station of the array."""
        return self.scope == "array" or (self.scope == "station" and one.antenna is not None)

    @property
    def named(self) -> list[list[Any]]:
        """The hash of these changes."""
        gated = (one for one in self.undated if not self._is_part(one))
        cuts = [[one.station, one.antenna, one.date, one.sigma] for one in (*self.cuts, *gated)]
        return cuts + [[*astuple(one)[: -3 if one.slow else -4], *one.own] for one in self.taken_out]

    @property
    def window(self) -> Window:
        """The window that is read: of the whole station where a path's model has causes of more than the path."""
        is_part = self.of.antenna is not None and not self.model.is_plain
        return Window(self.since, self.until, Scope(self.of.station) if is_part else self.of)


@dataclass(frozen=True)
class Made:
    """The versions of a fit, one for every scope, and the budgets that their curves name, by hash.

    With the lines of the `pieces` of the window later events can continue the fit, and other windows be fitted.
    """

    versions: list[Version]
    budgets: Mapping[str, Budget]
    pieces: Sequence[KeptPiece] = ()


@dataclass(frozen=True)
class Fits:
    """Makes versions from stored spectra."""

    simulation: Simulation
    resistance_ohm: float
    clock: Callable[[], Instant]
    read: Remembered[Read, Spectra] = field(default_factory=lambda: Remembered(1))
    fitted: Remembered[tuple[Any, ...], FittedCauses] = field(default_factory=lambda: Remembered(1))
    of_power: Remembered[str, bool] = field(default_factory=lambda: Remembered(MOST_LOOKED_AT))
    engine: Engine = HERE

    def elsewhere(self, function: Callable[..., Result], *of: Any) -> Result:
        """`function(fits, *of)` where the engine does it, by the clock of this process."""
        made: Result = self.engine.call(_do_at, self, self.clock(), function, *of)
        return made

    def load(self, stores: Stores, wanted: Wanted) -> Recorded:
        """The spectra of a fit, or an error where there is none; those of the array are read within the transaction.

        Those of a station that were read last stay in memory: the next part is another scope of the same.
        """
        window, is_plain = wanted.window, wanted.model.is_plain

        def read(of: Scope = window.scope) -> Spectra:
            return self.load_window(stores, replace(window, scope=of), with_covariates=not is_plain)

        def spread(function: Callable[[Spectra], Result], parts: Iterable[Spectra]) -> Iterator[Result]:
            return (self.elsewhere(_apply, function, own) for own in parts)

        if window.scope == Scope():
            stations = list(stores.spectra.contents(window.since, window.until))
            return SpectraByStation.of(stations, lambda name: read(Scope(name)), spread) if stations else read()
        is_kept = window.scope.antenna is None and is_plain
        return self.read.get((window, stores.spectra.content(window)), read) if is_kept else read()

    def load_window(self, stores: Stores, window: Window, *, with_covariates: bool) -> Spectra:
        """The spectra of a window, or an error where there is none."""
        channels = self.simulation.instrument.frequency_mhz
        found = stores.spectra.load(window, channels, self.resistance_ohm, with_covariates=with_covariates)
        if found is None:
            since, until = format_instant(window.since), format_instant(window.until)
            raise ConflictError(f"no usable spectra of {name_path(*window.scope.parts)} between {since} and {until}")
        return found

    def name_block(self, stores: Stores, wanted: Wanted) -> Sums:
        """The block of a fit as it is now, nothing kept in it yet."""
        return read_block(stores, wanted.scope, wanted.window, self._name_inputs(wanted), wanted.of)

    def _name_inputs(self, wanted: Wanted) -> str:
        """All inputs of a fit but the spectra."""
        model = [] if wanted.model.is_plain else [wanted.model.id]
        return hash_content([self.name_simulation(wanted.since, wanted.until, wanted.of), wanted.named, *model])

    def find_neighbours(self, stores: Stores, wanted: Wanted, cuts: Sequence[Cut] | None = None) -> Neighbours:
        """The calendar years beside a window of which lines are kept that a fit would make again.

        With the cuts of all years; None for those on record.
        """
        of = Scope(wanted.of.station)
        found = list(self._find_pieces(stores, wanted.scope, of, wanted.since, wanted.until))
        changes: dict[tuple[str, int | None], list[Instant]] = {}
        behind: dict[Owner, tuple[Floats, str]] = {}
        for station in {one.station for one in wanted.taken_out}:
            behind |= self._find_behind(stores, Scope(station))
        for cut in stores.changes.cuts(of.station) if cuts is None else cuts:
            changes.setdefault((cut.station, cut.antenna), []).append(cut.date)
        for owner, dates in find_hardware_changes(self.simulation.instrument).items():
            changes.setdefault(owner, []).extend(round(date * SECOND_US) for date in dates)
        return Neighbours(found, changes, behind)

    def _find_pieces(
        self, stores: Stores, scope: str, of: Scope, since: Instant = 0, until: Instant = 0
    ) -> Iterator[KeptPiece]:
        """What is kept of the calendar years beside a window, of fits that would be made again; beside none: of all."""
        fit_of = read_fits(stores, of.station)
        for block in stores.sums.beside(scope, of, since, until):
            then = fit_of(scope, of, block.since, block.until)
            is_year = (block.since, block.until) == year_of(block.since)
            if is_year and block.inputs == self._name_inputs(then):
                yield from read_pieces(block.arrays)

    def _find_behind(self, stores: Stores, station: Scope) -> dict[Owner, tuple[Floats, str]]:
        """What is added behind N_RCU in the paths of a station, by the first window that is kept of each."""
        found: dict[Owner, tuple[Floats, str]] = {}
        for piece in self._find_pieces(stores, "antenna", station):
            for one in piece.lines:
                at = [k for k, owner in enumerate(one.owners) if one.is_good[k] and owner not in found]
                terms = self.simulation.with_form(one.form).noise
                solved = solve_separable(one.slope[at], one.intercept[at], one.information[at], terms)
                for k, behind in zip(at, solved.q @ terms.behind, strict=True):
                    found[one.owners[k]] = np.maximum(behind, 0.0), str(one.spectra[k])
        return found

    def name_simulation(self, since: Instant, until: Instant, of: Scope) -> dict[str, Any]:
        """Inputs of a window but spectra, cuts and causes: `instrument`, `sky_power`, `own_sky`, `model_version`."""
        simulation = self.simulation
        return {
            "instrument": simulation.instrument.digest_of(since / SECOND_US, until / SECOND_US, of.station, of.antenna),
            "sky_power": simulation.sky_power.digest(),
            "own_sky": simulation.is_own_sky,
            "model_version": MODEL_VERSION,
        }

    def read_later(self, stores: Stores, now: Sums, window: Window) -> Later | None:
        """Read the kept lines of a block with the spectra of later events; None where more than these changed."""
        kept = stores.sums.get(now.kind, now.scope, now.since, now.until)
        if kept is None or (kept.inputs, kept.flag) != (now.inputs, now.flag):
            return None
        channels = self.simulation.instrument.frequency_mhz
        spectra = stores.spectra.load(window, channels, self.resistance_ohm, after=kept.event)
        is_all = kept.spectra + (0 if spectra is None else len(spectra)) == now.spectra
        return Later(kept, spectra) if is_all else None

    def examine(
        self, pieces: Sequence[KeptPiece], spectra: Spectra | None, neighbours: Neighbours,
        before: Mapping[ServedKey, Served],
    ) -> Outcome | None:  # fmt: skip
        """Look at later events of a kept fit, and at other windows; None where the whole window is to be read.

        A scope is not done where `before` is near enough: what it was served may answer again.
        """
        examined, rest, made = list[Examined](), list[Scope](), self.clock()
        names = [None if spectra is None else spectra.digest()]
        pieces = [one for one in pieces if one.served]
        seen = np.zeros(0 if spectra is None else len(spectra), dtype=bool)
        for piece in pieces:
            rows = seen if spectra is None else _rows_of_piece(piece, spectra)
            seen |= rows
            own = None if spectra is None or not np.any(rows) else spectra.select(rows)
            beside = neighbours.beside(piece.since, piece.until)
            with threadpool_limits(1):
                simulation = self.simulation if own is None else self.simulation.smeared(own)
                ends = piece.since / SECOND_US, (piece.until - 1) / SECOND_US
                continued = continue_fit(piece.lines, own, simulation, [one for _, one in beside], ends)
            for served in piece.served:
                shift = _find_shift(served, continued)
                if shift is None and not served.curves:
                    return None
                # the mean of all stations would be read anew for a change of one antenna
                is_other = served.scope != Scope() and served.changes not in (None, neighbours.changes_of(served.scope))
                was = before.get((served.scope, piece.since, piece.until))
                of_before = None if was is None else _find_shift(was, continued)
                is_again = of_before is not None and of_before < SMALLEST_SHIFT
                if shift is None or shift >= SMALLEST_SHIFT or is_other or is_again:
                    rest.append(served.scope)
                    continue
                inputs = hash_content([served.calibration, *names, name_windows(served.scope, beside)])
                examined.append(
                    Examined(served.scope, piece.since, piece.until, inputs, served.calibration, shift, made)
                )
            neighbours = neighbours.and_also(piece)
        is_whole = len(pieces) == 1 and all(scope.antenna is not None for scope in rest)
        is_few = not rest or (is_whole and len(rest) <= LARGEST_REST * (len(rest) + len(examined)))
        return Outcome(examined, rest) if np.all(seen) and is_few else None

    def fit_causes(self, spectra: Recorded, model: Model) -> FittedCauses:
        """Fit the sizes of the adopted causes to all spectra of their stations, where these are enough for any fit.

        The last fit of a station's causes stays in memory: the next part is another scope of the same spectra.
        """
        stations = {station for station, *_ in spectra.quarter_hashes}
        concerned = {one.station for one in model.causes}.intersection(stations)
        enough = model.of_stations([name for name in concerned if has_enough(spectra.read(name))])

        def fit() -> FittedCauses:
            simulation = self.simulation.with_causes(enough).smeared(spectra)
            return fit_causes(spectra, simulation)

        if model.is_plain or len(stations) != 1 or isinstance(spectra, SpectraByStation):
            return fit()
        return self.fitted.get((spectra.digest(), hash_covariates(spectra), enough.id), fit)

    def make(
        self, whole: FittedCauses, wanted: Wanted, neighbours: Neighbours = ALONE, budget: Budget | None = None
    ) -> Made:
        """Fit the chain to the spectra that a fit wants, the sizes of the causes fitted to the whole station's.

        With a budget given, that of other fits of the station, the versions name it among their inputs. One chain is
        fitted to a path through all windows with the same hardware; a piece of the window that is too small for a fit
        takes from those with another.
        """
        pieces = list(self._fit_pieces(whole, wanted, neighbours, budget))
        versions = [version for made, *_ in pieces for version in made]
        versions = share_misfits(versions) if len(pieces) > 1 else versions
        if budget is not None:
            versions = [replace(one, inputs={**one.inputs, BUDGET: budget.digest}) for one in versions]
        budgets = {name: one for _, report, _ in pieces for name, one in report.budgets.items()}
        good = {(one.window, curve.path) for one in versions for curve in one.curves if curve.status == CONVERGED}
        kept = []
        for _, report, during in pieces:
            of_piece = {owner for window, owner in good if window == (during.since, during.until)}
            kept.append(KeptPiece(during.since, during.until, [one.lend(of_piece) for one in report.lines]))
        return Made(versions, budgets, [one for one in kept if one.lines])

    def _fit_pieces(
        self, whole: FittedCauses, wanted: Wanted, neighbours: Neighbours, budget: Budget | None
    ) -> Iterator[tuple[list[Version], FitReport, Wanted]]:
        """Fit the pieces of a window, that with the most spectra first: it has the budget of all, and may lend."""
        made, named, instrument = self.clock(), _name_sizes(whole, wanted, neighbours), self.simulation.instrument
        whole = _take_out(whole, wanted, neighbours)
        cut = sorted(self._cut(whole, wanted), key=lambda one: -len(one[1]))
        if budget is None:
            for of_piece, *_ in cut:
                self._require_power(of_piece.recorded, wanted)
        for of_piece, recorded, during in cut:
            dipoles = {dipole for *_, dipole in of_piece.recorded.quarter_hashes}
            if budget is None or not dipoles <= budget.polarisations:
                budget = self._budget(of_piece)
            # without a budget of its polarisation nothing may borrow what makes it a curve
            known, found = budget.polarisations, neighbours.beside(during.since, during.until)
            beside = [(one, of) for one, of in found if of.lines.owners[0][2] in known]
            report = add_budget(of_piece.fit(wanted.scope, beside=[of for _, of in beside]), budget)
            report = replace(report, lines=[_name_lines(one, named) for one in report.lines])
            neighbours = neighbours.and_also(KeptPiece(during.since, during.until, report.lines))
            left_out = of_piece.events_left_out
            told = (
                f"; {write_count(left_out, 'event')} left out: a covariate of a cause is not known" if left_out else ""
            )
            said = replace(during, reason=wanted.reason + told)
            yield _versions(recorded, report, said, made, named, beside, instrument), report, during

    def _require_power(self, recorded: Recorded, wanted: Wanted) -> None:
        """Refuse spectra whose unit is not that of power, looking at one station after the other."""
        instrument = self.simulation.instrument
        for station in sorted({station for station, *_ in recorded.quarter_hashes}):

            def look(station: str = station) -> bool:
                found = audit_quickly(recorded.read(station), instrument)
                found.require_power(f"spectra of {name_path(*wanted.of.parts)}")
                return True

            self.of_power.get(recorded.digest(station), look)

    def _budget(self, fitted: FittedCauses) -> Budget:
        """The budget of some spectra: one for all scopes that are fitted to them."""
        budget: Budget = self.simulation.made.get(
            ("budget", fitted.spectra.digest()), lambda: compute_budget(fitted.spectra, fitted.simulation)
        )
        return budget

    def _cut(self, whole: FittedCauses, wanted: Wanted) -> Iterator[tuple[FittedCauses, Recorded, Wanted]]:
        """The pieces of the window of a fit: what is fitted, the spectra by which it is named, and when it lies."""
        spectra, of, is_part = whole.recorded, wanted.of, wanted.window.scope != wanted.of
        fitted = whole.keep(lambda own: (own.antenna == of.antenna) & (own.dipole == of.dipole)) if is_part else whole
        ends = wanted.since / SECOND_US, wanted.until / SECOND_US
        instrument = self.simulation.instrument
        for one in cut_window(fitted.recorded, instrument, wanted.scope, *ends, _list_cuts(wanted, instrument)):
            of_piece = fitted if one.is_whole else fitted.keep(one.rows)
            during = replace(wanted, since=round(one.since_unix * SECOND_US), until=round(one.until_unix * SECOND_US))
            if len(of_piece.recorded):
                yield of_piece, spectra if of_piece is fitted else of_piece.recorded, during


def _apply(_: Fits, function: Callable[[Spectra], Result], own: Spectra) -> Result:
    return function(own)


def _do_at(fits: Fits, now: Instant, function: Callable[..., Result], *of: Any) -> Result:
    return function(replace(fits, clock=lambda: now), *of)


def _take_out(whole: FittedCauses, wanted: Wanted, neighbours: Neighbours) -> FittedCauses:
    """The changes of single antennas taken out of their power, where a mean is made of them.

    What changed is in front of N_RCU: the noise behind it stays.
    """
    if not wanted.taken_out:
        return whole
    modes = gain_modes(whole.simulation.instrument.frequency_mhz)[1:]

    def take_out(spectra: Spectra) -> Floats:
        power = spectra.power.copy()
        last: dict[tuple[Any, ...], Cut] = {}  # of ramps and seasons, the last of a kind counts
        for one in wanted.taken_out:
            kind = one.antenna is None, one.date if one.slow is None else one.slow.is_season
            for dipole in one.dipoles or np.unique(spectra.dipole).tolist():
                of_dipole = (spectra.station == one.station) & (spectra.dipole == dipole)
                every = np.unique(spectra.antenna[of_dipole]).tolist()
                last |= {
                    (one.station, antenna, dipole, *kind): one
                    for antenna in (every if one.antenna is None else [one.antenna])
                }
        for (_, antenna, dipole, *_), one in last.items():
            rows = (spectra.station == one.station) & (spectra.dipole == dipole) & (spectra.antenna == antenna)
            behind, _ = neighbours.behind.get((one.station, antenna, dipole), (np.zeros(power.shape[1]), ""))
            signal = np.maximum(power[rows] - behind, 0.0)
            power[rows] += signal * np.expm1(-one.log_power(spectra.time_unix[rows], modes, dipole))
        return power

    return replace(whole, unchanged=take_out)


def _name_sizes(whole: FittedCauses, wanted: Wanted, neighbours: Neighbours) -> dict[str, str]:
    """What names the versions of a fit besides their own spectra: changes taken out, and what sizes were fitted to."""
    named = {}
    if wanted.taken_out:
        of = {(one.station, one.antenna) for one in wanted.taken_out}
        behind = [(owner, name) for owner, (_, name) in neighbours.behind.items() if {owner[:2], (owner[0], None)} & of]
        sources = sorted([*map(str, owner), name] for owner, name in behind)
        named["changes"] = hash_content(wanted.named)
        if sources:
            named[BEHIND] = hash_content(sources)
    if whole.model.is_plain:
        return named
    of_sizes = {"model_spectra": whole.recorded.digest()} if wanted.scope == "antenna" else {}
    return {**named, "environment": hash_covariates(whole.recorded), **of_sizes}


def _name_lines(lines: KeptLines, named: Mapping[str, str]) -> KeptLines:
    """The lines of a mean under another name where changes are taken out: the same spectra lend other lines then."""
    if "changes" not in named:
        return lines
    taken_out = [named[name] for name in ("changes", BEHIND) if name in named]
    return replace(lines, spectra=np.array([hash_content([one, *taken_out]) for one in lines.spectra.tolist()]))


def _versions(
    spectra: Recorded,
    report: FitReport,
    wanted: Wanted,
    made: Instant,
    named: Mapping[str, str],
    beside: Sequence[tuple[KeptPiece, Beside]],
    instrument: Instrument,
) -> list[Version]:
    """The versions of a report, each by its own inputs; all of them share those `named`."""
    groups: dict[Scope, list[CalibrationCurve]] = {}
    chains: dict[Scope, dict[str, ReferenceChain]] = {}
    for curve, chain in zip(report.curves, report.chains, strict=True):
        scope = scope_of(curve.path)
        groups.setdefault(scope, []).append(curve)
        if chain is not None:
            chains.setdefault(scope, {})[str(curve.dipole)] = chain
    ends = wanted.since / SECOND_US, wanted.until / SECOND_US
    return [
        Version(
            scope=scope,
            since=wanted.since,
            until=wanted.until,
            inputs={
                **report.provenance.inputs,
                **named,
                **name_beside(scope, group, beside),
                "instrument": instrument.digest_of(*ends, scope.station, scope.antenna),
                "spectra": spectra.digest(scope.station, scope.antenna, scope.dipole),
                "scope": scope.key,
                "settings": dict(report.provenance.settings),
                "model_version": report.provenance.model_version,
            },
            curves=tuple(group),
            made=made,
            made_by=wanted.by,
            reason="; ".join([wanted.reason, *_explain_repeated(group)]),
            chains=chains.get(scope, {}),
            anomalies=Anomalies.of(
                one for one in report.anomalies if scope in Scope(one.station, one.antenna, one.dipole).widening
            ),
        )
        for scope, group in groups.items()
    ]


def _explain_repeated(curves: Sequence[CalibrationCurve]) -> list[str]:
    """What a window takes from others beyond the noise constants, or why it takes nothing."""
    served = []
    for curve in curves:
        found = curve.repeated
        if found is not None and found.windows == 1:
            words = f"chi^2 per degree of freedom {found.chi2_per_dof:.2f}"
            served.append(f"{curve.dipole} is fitted by itself: it does not repeat what other windows say ({words})")
        elif found is not None and curve.events < MIN_EVENTS:
            served.append(
                f"too few events for a fit: C of {curve.dipole} is that of other windows, with a gain of its own"
            )
    return served


def _list_cuts(wanted: Wanted, instrument: Instrument) -> dict[tuple[str, int | None], list[float]]:
    """Dates of cuts, s UTC, by station and antenna; None for all of a station.

    One that agrees with a date on record of its antenna is that.
    """
    found: dict[tuple[str, int | None], list[float]] = {}
    known = [(owner, date) for owner, dates in find_hardware_changes(instrument).items() for date in dates]
    for one in wanted.cuts:
        own, at = (one.station, one.antenna), (one.date, one.sigma)
        if not any(owner == own and is_same_date(at, (round(date * SECOND_US), 0)) for owner, date in known):
            found.setdefault(own, []).append(one.date / SECOND_US)
    return found


def read_part(stores: Stores, request: Mapping[str, Any], model: Model, by: str, reason: str) -> Wanted:
    """The fit that a part of a job asks for."""
    of = Scope(request["station"], request["antenna"], request["dipole"])
    wanted = read_fits(stores, of.station)(request["scope"], of, request["since"], request["until"])
    return replace(wanted, model=model, by=by, reason=reason)


FitOf = Callable[[str, Scope, Instant, Instant], Wanted]
"""The fit of a scope, of whose spectra, in a window."""


def read_fits(stores: Stores, station: str | None) -> FitOf:
    """The fits of a station, or of the array, with the model that is adopted and the changes that are in force."""
    adopted, of_changes = stores.models.of_station(station), stores.changes.of_fits(station)

    def fit_of(scope: str, of: Scope, since: Instant, until: Instant) -> Wanted:
        model = adopted.during(since / SECOND_US, until / SECOND_US)
        before = (tuple(one for one in some if one.begins_before(until)) for some in of_changes)
        return Wanted(scope, of, since, until, model, "", "", *before)

    return fit_of


# Due refits that read only the events that came since: the fit that is kept is continued by them.
#
# Where C then differs too little from what a scope is served, nothing is written but that the events were examined. The
# few paths of a station of which that cannot be said are fitted from their own spectra. The whole window is read where
# more than these changed: flags, late spectra of events that were there, other inputs, models with causes, promotions
# since.

SMALLEST_SHIFT = 0.25
"""Due work that moves C by less than this, in standard deviations and in every channel, is no news."""
LARGEST_REST = 0.5
"""Share of the paths of a station from which on the window is read whole."""


@dataclass(frozen=True)
class Later:
    """The kept lines of a block, and the spectra that came since; None where there are none."""

    block: Sums
    spectra: Spectra | None


@dataclass(frozen=True)
class Outcome:
    """Paths that later events confirm, and those that only a fit from spectra can decide: none of a mean."""

    examined: Sequence[Examined]
    rest: Sequence[Scope]


def read_block(stores: Stores, kind: str, window: Window, inputs: str, of: Scope) -> Sums:
    """A block as it is now: what it holds of spectra, and the hash of its other inputs."""
    spectra, flag = stores.spectra.content(window)
    event = stores.spectra.newest_event(window)
    return Sums(kind, of, window.since, window.until, inputs, spectra, flag, event, spectra, {})


def is_still_served(stores: Stores, pieces: Sequence[KeptPiece]) -> bool:
    """Whether what is in effect is what was when a fit was kept."""
    for piece in pieces:
        scopes = [one.scope for one in piece.served]
        names = _name_standing(stores, scopes, piece.since, piece.until)
        standing = find_standing(stores, scopes, piece.since, piece.until)
        said = {one.scope: one.calibration if one.is_in_effect else None for one in piece.served}
        if any(names[scope] and standing.get(scope) != name for scope, name in said.items()):
            return False
    return True


def keep_fit(stores: Stores, block: Sums, made: Made, served: Mapping[ServedKey, Served]) -> None:
    """Keep a fit in its block, where the chain alone was fitted."""
    if made.pieces:
        pieces = list[KeptPiece]()
        for one in made.pieces:
            scopes = dict.fromkeys(scope_of(owner) for lines in one.lines for owner in lines.owners)
            pieces.append(replace(one, served=[served[scope, one.since, one.until] for scope in scopes]))
        stores.sums.put(replace(block, arrays=write_pieces(pieces)), name_pieces(pieces))
    elif all(one.model is None for one in made.versions):  # nothing is left that could be lent
        stores.sums.forget(block.scope, block.since, block.until, block.kind)


def keep_served(
    stores: Stores,
    block: Sums,
    pieces: Sequence[KeptPiece],
    served: Mapping[ServedKey, Served],
    renewed: Sequence[KeptPiece],
) -> None:
    """Keep the curves that some scopes are served since, and what their paths lend to other windows since.

    Their lines go on being continued as they were when all was read: events would be added to the new ones twice.
    """
    own = {owner for piece in renewed for one in piece.lines for owner in one.owners}
    now = [
        replace(
            piece,
            served=[served.get((one.scope, piece.since, piece.until), one) for one in piece.served],
            lines=[
                one.lend({owner for owner, is_good in zip(one.owners, one.is_good, strict=True) if is_good} - own)
                for one in piece.lines
            ],
        )
        for piece in pieces
        if piece.served or own.isdisjoint(owner for one in piece.lines for owner in one.owners)
    ]
    now += renewed
    stores.sums.put(replace(block, arrays=write_pieces(now)), name_pieces(now))


def find_standing(stores: Stores, scopes: Sequence[Scope], since: Instant, until: Instant) -> dict[Scope, str]:
    """The versions in effect at both ends of a window and in its middle, where no person withdrew, by scope."""
    names = _name_standing(stores, scopes, since, until)
    return {scope: name for scope, of in names.items() if len(of) == 1 for name in of if name is not None}


def _name_standing(
    stores: Stores, scopes: Sequence[Scope], since: Instant, until: Instant
) -> dict[Scope, set[str | None]]:
    """What decides at both ends of a window and in its middle but for persons' withdrawals, None where nothing does."""
    instants = since, (since + until) // 2, until - 1
    said = stores.ledger.decisive_at([(scope, at) for scope in scopes for at in instants])
    found = {scope: [said.get((scope, at)) for at in instants] for scope in scopes}
    return {
        scope: {None if p is None else p.calibration for p in of if p is None or not is_of_person(p)}
        for scope, of in found.items()
    }


def read_served(version: Version, changes: Sequence[Instant], *, is_in_effect: bool) -> Served:
    """Read the curves that a scope is served after a fit."""
    curves: Mapping[str, tuple[Floats, Floats]] = {
        str(curve.dipole): (curve.c, curve.c_sigma_stat)
        for curve in version.curves
        if curve.c is not None and curve.c_sigma_stat is not None
    }
    return Served(version.scope, version.id, is_in_effect, curves, changes)


def _rows_of_piece(piece: KeptPiece, spectra: Spectra) -> NDArray[np.bool_]:
    """The spectra that belong to a piece of a window: of a mean those of its time, else those of its paths too."""
    rows = (spectra.time_unix >= piece.since / SECOND_US) & (spectra.time_unix < piece.until / SECOND_US)
    if any(one.members is not None for one in piece.lines):
        return np.asarray(rows)
    paths = {owner for one in piece.lines for owner in one.owners}
    keys = zip(spectra.station.tolist(), spectra.antenna.tolist(), spectra.dipole.tolist(), strict=True)
    return np.asarray(rows & np.array([key in paths for key in keys]))


def _find_shift(served: Served, continued: Continued) -> float | None:
    """By how much C may differ from what is served, in standard deviations: the largest of any channel that has both.

    None where that is not decided, or where one of them has a curve that the other lacks.
    """
    dipoles = [served.scope.dipole] if served.scope.dipole is not None else _list_dipoles(served, continued)
    owners = {dipole: (served.scope.station, served.scope.antenna, dipole) for dipole in dipoles}
    own = {dipole: continued.curves[owner] for dipole, owner in owners.items() if owner in continued.curves}
    if own.keys() != served.curves.keys() or continued.undecided & set(owners.values()):
        return None
    shifts = [
        np.nanmax(np.abs(own[dipole][0] - c) / np.fmin(own[dipole][1], sigma)) + own[dipole][2]
        for dipole, (c, sigma) in served.curves.items()
    ]
    return float(max(shifts, default=0.0))


def _list_dipoles(served: Served, continued: Continued) -> list[str]:
    """The dipoles of which a mean has curves."""
    parts = served.scope.station, served.scope.antenna
    return sorted({dipole for *own, dipole in (*continued.curves, *continued.undecided) if tuple(own) == parts})
