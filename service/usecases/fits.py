"""Fits of stored spectra with the model that is adopted: versions, their budgets and what the causes gained.

Nothing is written here: a refit keeps what these functions make, and the dry run of an adoption shows it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.audit.audit import audit_quickly
from lbacal_core.calibration.chain_test import SkyFreedom
from lbacal_core.calibration.singles import MIN_EVENTS, FitSingles
from lbacal_core.causes.model import Model
from lbacal_core.curves.anomalies import Anomalies
from lbacal_core.curves.covariance import Budget
from lbacal_core.curves.curves import CalibrationCurve, FitReport
from lbacal_core.curves.kept_lines import KeptLines
from lbacal_core.curves.reference_chain import ReferenceChain
from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.discovery.calibrate import FittedCauses, fit_causes
from lbacal_core.drift.windows import cut_window
from lbacal_core.errors import name_path
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.provenance import Remembered
from lbacal_core.skypower.sky_terms import SkyTerm
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra.spectra import Spectra
from lbacal_core.uncertainty.refit import add_budget, compute_budget
from service.errors import ConflictError
from service.storage.cuts import Cut
from service.storage.database import Stores
from service.storage.spectra import Window
from service.storage.versions import BUDGET, Version
from service.usecases.inputs import hash_covariates
from service.usecases.windows import SECOND_US, FindLenders, lend_to_small, share_misfits
from service.wire.instants import format_instant

GAIN_STEP = "gain_step"
BUDGETS_REMEMBERED = 8
Read = tuple[Window, tuple[int, int]]
"""A window, and what it held when it was read: `SpectraStore.content`."""


@dataclass(frozen=True)
class Wanted:
    """A fit: the scope of its versions, whose spectra they are made from, the window and the model; who wants it.

    `cuts` are the dates at which the watch found that antennas changed in the window.
    """

    scope: str
    of: Scope
    since: Instant
    until: Instant
    model: Model
    by: str
    reason: str
    cuts: tuple[Cut, ...] = ()

    @property
    def window(self) -> Window:
        """What is read: the whole station where a path's model has causes, whose sizes belong to more than the path."""
        is_part = self.of.antenna is not None and not self.model.is_plain
        return Window(self.since, self.until, Scope(self.of.station) if is_part else self.of)


@dataclass(frozen=True)
class Made:
    """The versions of a fit, one for every scope, and the budgets that their curves name, by hash.

    `lines` are those of each piece of the window, [since, until), with which later events can continue the fit; none
    where the model has causes.
    """

    versions: list[Version]
    budgets: Mapping[str, Budget]
    lines: Sequence[tuple[Instant, Instant, Sequence[KeptLines]]] = ()


def _find_none(_: Collection[Scope]) -> Sequence[Version]:
    return ()


@dataclass(frozen=True)
class Fits:
    """Makes versions from stored spectra."""

    instrument: Instrument
    sky_power: Callable[[], SkyPower]
    freedom: Callable[[], SkyFreedom | None]
    is_own_sky: bool
    resistance_ohm: float
    clock: Callable[[], Instant]
    changes: Callable[[], Sequence[SkyTerm]]
    singles: FitSingles
    budgets: Remembered[str, Budget] = field(default_factory=lambda: Remembered(BUDGETS_REMEMBERED))
    read: Remembered[Read, Spectra] = field(default_factory=lambda: Remembered(1))

    def load(self, stores: Stores, wanted: Wanted) -> Spectra:
        """The spectra of a fit, or an error where there is none.

        Those of a station that were read last stay in memory: the next part is another scope of the same.
        """
        window = wanted.window
        key = window, stores.spectra.content(window)

        def read(_: list[Read]) -> dict[Read, Spectra]:
            found = stores.spectra.load(
                window, self.instrument.frequency_mhz, self.resistance_ohm, with_covariates=not wanted.model.is_plain
            )
            return {} if found is None else {key: found}

        is_station = window.scope == Scope(window.scope.station) != Scope()
        if is_station and wanted.model.is_plain:
            spectra = self.read.get_many([key], read).get(key)
        else:
            spectra = read([key]).get(key)
        if spectra is None:
            since, until = format_instant(wanted.since), format_instant(wanted.until)
            raise ConflictError(f"no usable spectra of {name_path(*wanted.of.parts)} between {since} and {until}")
        return spectra

    def fit_causes(self, spectra: Spectra, model: Model, *, are_sizes_known: bool = False) -> FittedCauses:
        """Fit the sizes of the adopted causes to all spectra of their stations, where these are enough for any fit."""
        stations = [] if model.is_plain else np.unique(spectra.station).tolist()
        enough = model.of_stations([name for name in stations if _has_enough(spectra, name)])
        return fit_causes(
            spectra, self.instrument, self.sky_power(), enough, is_own_sky=self.is_own_sky,
            are_sizes_known=are_sizes_known,
        )  # fmt: skip

    def foresee(self, whole: FittedCauses, wanted: Wanted, before: Sequence[Version], budget: Budget) -> list[Version]:
        """The versions that `make` will make with a cause more, from those before, whose budget their errors have.

        Chain and statistical error are those of a fit. The budget is not computed again, and what the error of the
        size does to C is taken in proportion to what the size does.
        """
        made, versions = self.clock(), list[Version]()
        for of_piece, recorded, during in self._cut(whole, wanted):
            plain = [curve for one in before if one.window == (during.since, during.until) for curve in one.curves]
            report = add_budget(of_piece.fit(wanted.scope, self.freedom(), plain, self.singles), budget)
            versions += _versions(recorded, report, during, made, _name_beside(whole, wanted), self.instrument)
        return versions

    def make(
        self, whole: FittedCauses, wanted: Wanted, budget: Budget | None = None, find_lenders: FindLenders = _find_none
    ) -> Made:
        """Fit the chain to the spectra that a fit wants, the sizes of the causes fitted to the whole station's.

        With a budget given, that of other fits of the station, the versions name it among their inputs. A piece of the
        window that is too small for a fit borrows from the nearest, those that `find_lenders` knows counted too.
        """
        made, beside = self.clock(), _name_beside(whole, wanted)
        if budget is not None:
            beside[BUDGET] = budget.digest
        pieces, versions, budgets, lines = [], list[Version](), dict[str, Budget](), []
        for of_piece, recorded, during in self._cut(whole, wanted):
            of_data = budget or self._audit_and_budget(of_piece, wanted)
            report = add_budget(of_piece.fit(wanted.scope, self.freedom(), singles=self.singles), of_data)
            versions += _versions(recorded, report, during, made, beside, self.instrument)
            budgets |= report.budgets
            if report.lines:
                lines.append((during.since, during.until, report.lines))
            pieces.append((during.since, of_piece.spectra))
        if len(pieces) > 1:
            versions = share_misfits(versions)
        window = wanted.since, wanted.until
        lent = lend_to_small(versions, window, pieces, self.instrument, self.sky_power(), find_lenders)
        return Made(lent, budgets, lines)

    def _audit_and_budget(self, fitted: FittedCauses, wanted: Wanted) -> Budget:
        """The budget of spectra whose unit is that of power: one for all scopes that are fitted to them."""
        key = fitted.spectra.digest()

        def compute(_: list[str]) -> dict[str, Budget]:
            audit_quickly(fitted.recorded, self.instrument).require_power(f"spectra of {name_path(*wanted.of.parts)}")
            inputs = fitted.spectra, self.instrument, self.sky_power()
            budget = compute_budget(*inputs, changes=self.changes(), freedom=self.freedom(), singles=self.singles)
            return {key: budget}

        return self.budgets.get_many([key], compute)[key]

    def _cut(self, whole: FittedCauses, wanted: Wanted) -> Iterator[tuple[FittedCauses, Spectra, Wanted]]:
        """The pieces of the window of a fit: what is fitted, the spectra by which it is named, and when it lies."""
        spectra = whole.recorded
        is_part = wanted.window.scope != wanted.of
        fitted = whole.select(_rows_of(spectra, wanted.of)) if is_part else whole
        ends = wanted.since / SECOND_US, wanted.until / SECOND_US
        for rows in cut_window(fitted.recorded, self.instrument, wanted.scope, *ends, _list_cuts(wanted)):
            of_piece = fitted if np.all(rows.rows) else fitted.select(rows.rows)
            during = replace(wanted, since=round(rows.since_unix * SECOND_US), until=round(rows.until_unix * SECOND_US))
            yield of_piece, spectra if np.all(rows.rows) else of_piece.recorded, during


def _name_beside(whole: FittedCauses, wanted: Wanted) -> dict[str, str]:
    """What names the versions of a fit with causes besides their own spectra: what the sizes were fitted to."""
    if whole.model.is_plain:
        return {}
    of_sizes = {"model_spectra": whole.recorded.digest()} if wanted.scope == "antenna" else {}
    return {"environment": hash_covariates(whole.recorded), **of_sizes}


def _versions(
    spectra: Spectra,
    report: FitReport,
    wanted: Wanted,
    made: Instant,
    beside: Mapping[str, str],
    instrument: Instrument,
) -> list[Version]:
    """The versions of a report, each named by its own inputs; `beside` are those that all of them share."""
    groups: dict[Scope, list[CalibrationCurve]] = {}
    chains: dict[Scope, dict[str, ReferenceChain]] = {}
    for curve, chain in zip(report.curves, report.chains, strict=True):
        scope = Scope(curve.station, curve.antenna, None if curve.antenna is None else curve.dipole)
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
                **beside,
                "instrument": instrument.digest_of(*ends, scope.station, scope.antenna),
                "spectra": spectra.digest(scope.station, scope.antenna, scope.dipole),
                "scope": scope.key,
                "settings": dict(report.provenance.settings),
                "model_version": report.provenance.model_version,
            },
            curves=tuple(group),
            made=made,
            made_by=wanted.by,
            reason=wanted.reason,
            chains=chains.get(scope, {}),
            anomalies=Anomalies.of(
                one for one in report.anomalies if scope in Scope(one.station, one.antenna, one.dipole).widening
            ),
        )
        for scope, group in groups.items()
    ]


def _list_cuts(wanted: Wanted) -> dict[tuple[str, int], list[float]]:
    """Dates of cuts, s UTC, by station and antenna."""
    found: dict[tuple[str, int], list[float]] = {}
    for one in wanted.cuts:
        found.setdefault((one.station, one.antenna), []).append(one.date / SECOND_US)
    return found


def _has_enough(spectra: Spectra, station: str) -> bool:
    """Whether any path of a station has the events that a fit needs."""
    of_station = spectra.station == station
    paths = np.stack([spectra.antenna[of_station], spectra.dipole[of_station] == "Y"])
    return bool(np.unique(paths, axis=1, return_counts=True)[1].max() >= MIN_EVENTS)


def _rows_of(spectra: Spectra, scope: Scope) -> NDArray[np.bool_]:
    rows: NDArray[np.bool_] = np.ones(len(spectra), dtype=bool)
    if scope.station is not None:
        rows &= spectra.station == scope.station
    if scope.antenna is not None:
        rows &= (spectra.antenna == scope.antenna) & (spectra.dipole == scope.dipole)
    return rows


def read_part(stores: Stores, request: Mapping[str, Any], model: Model, by: str, reason: str) -> Wanted:
    """The fit that a part of a job asks for."""
    of = Scope(request["station"], request["antenna"], request["dipole"])
    window = request["since"], request["until"]
    cuts = find_cuts(stores, of.station, *window, model)
    return Wanted(request["scope"], of, *window, model, by, reason, cuts)


def find_cuts(stores: Stores, station: str | None, since: Instant, until: Instant, model: Model) -> tuple[Cut, ...]:
    """The dates at which a window is cut; none at stations whose model has a step, which says what changed then."""
    stepping = {one.station for one in model.causes if one.cause == GAIN_STEP}
    return tuple(cut for cut in stores.cuts.standing(station, since, until) if cut.station not in stepping)
