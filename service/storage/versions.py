"""Calibration versions: stored once under the hash of their inputs, never changed."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from sqlalchemy import ColumnElement, Connection, Row, and_, case, func, or_, select, tuple_

from lbacal.instants import SECOND_US
from lbacal_core.calibration.paths import is_undetermined
from lbacal_core.calibration.spreads import ServedCurve, carry_to_path
from lbacal_core.curves.covariance import Budget
from lbacal_core.curves.curves import (
    CONVERGED,
    MISFIT,
    NONE,
    NOT_IDENTIFIABLE,
    STATUSES,
    WITH_VALUES,
    Anomalies,
    CalibrationCurve,
    parse_anomalies,
    parse_curve,
)
from lbacal_core.curves.reference_chain import CableTable, GainSpreads, ReferenceChain, parse_cable_table, parse_spreads
from lbacal_core.curves.validity import Instant, Scope, parse_scope
from lbacal_core.errors import name_path
from lbacal_core.provenance import canonical_json, hash_content
from service.schema.tables import IS_GATED, budget, calibration, calibration_mean, chain_part, examined, promotion
from service.storage.models import complete_id
from service.storage.rows import (
    Store,
    add_rows,
    equal,
    from_row,
    put_rows,
    require_one,
    scope_columns,
    select_many,
    to_row,
)

# The reference chains of versions: members and L_ref beside the version, cables and spreads once under their hash.

PARTS_REMEMBERED = 64
"""Tables of cables, and as many of spreads, that stay in memory; they never change, and there are few."""


def write_chains(connection: Connection, chains: Mapping[str, Mapping[str, ReferenceChain]]) -> dict[str, str | None]:
    """Store what the chains of versions share, and give each version's own part, canonical JSON; None without."""
    parts: dict[str, str] = {}
    for chain in (chain for of_version in chains.values() for chain in of_version.values()):
        shared = (chain.cables,) if chain.spreads is None else (chain.cables, chain.spreads)
        for part in shared:
            if part.digest not in parts:
                parts[part.digest] = canonical_json(part.as_dict())
    rows = [{"sha256": digest, "content": content} for digest, content in sorted(parts.items())]
    add_rows(connection, chain_part, rows)
    return {name: _describe(of_version) for name, of_version in chains.items()}


def _describe(chains: Mapping[str, ReferenceChain]) -> str | None:
    if not chains:
        return None
    return canonical_json(
        {
            dipole: {
                "members": [list(member) for member in chain.members],
                "mean_cable_loss": chain.mean_loss.tolist(),
                "cables": chain.cables.digest,
                "spreads": None if chain.spreads is None else chain.spreads.digest,
                "doubt": chain.doubt,
            }
            for dipole, chain in chains.items()
        }
    )


def read_chains(connection: Connection, references: Mapping[str, str | None]) -> dict[str, dict[str, ReferenceChain]]:
    """The chains of versions by dipole, from each version's own part."""
    own = {name: {} if text is None else json.loads(text) for name, text in references.items()}
    described = [chain for of_version in own.values() for chain in of_version.values()]
    tables = {chain["cables"] for chain in described}
    spreads = {chain["spreads"] for chain in described if chain["spreads"] is not None}
    found = select_many(connection, select(chain_part), chain_part.c.sha256, tables | spreads)
    contents = {row.sha256: row.content for row in found}
    table_of = {digest: _parse_cables(contents[digest]) for digest in tables}
    spreads_of = {digest: _parse_spreads(contents[digest]) for digest in spreads}
    return {
        name: {
            dipole: ReferenceChain(
                members=tuple((station, antenna) for station, antenna in chain["members"]),
                mean_loss=np.array(chain["mean_cable_loss"], dtype=float),
                cables=table_of[chain["cables"]],
                spreads=spreads_of.get(chain["spreads"]),
                doubt=chain["doubt"],
            )
            for dipole, chain in of_version.items()
        }
        for name, of_version in own.items()
    }


@lru_cache(PARTS_REMEMBERED)
def _parse_cables(text: str) -> CableTable:
    return parse_cable_table(json.loads(text))


@lru_cache(PARTS_REMEMBERED)
def _parse_spreads(text: str) -> GainSpreads:
    return parse_spreads(json.loads(text))


BESIDE = "beside"
"""The input that names the spectra of the other windows that a version was fitted together with."""
BEHIND = "behind"
"""The input that names the spectra which say what single paths have behind N_RCU, where a change is taken out."""
BUDGET = "budget"
"""The input that names a budget which was not computed from the version's own spectra and those around them."""
OF_OTHERS = (BESIDE, BEHIND, BUDGET)
"""The inputs that other fits lend: what they are made of differs from fit to fit, however little C does."""
OF_SIMULATION = {
    "instrument": "another instrument", "sky_power": "another sky power", "model_version": "another model version",
    "settings": "other settings", "model": "other causes adopted",
}  # fmt: skip
"""The inputs that are no data, with what is said where one is another."""
CURVES_REMEMBERED = 1200
"""Versions whose curves stay in memory: those of all paths of the Superterp in two years, about 40 MB."""


@dataclass(frozen=True)
class Version:
    """The result of one fit over the window [since, until) for one scope.

    `gate` is why it was not promoted by itself; None where it passed, or no promotion was requested. `chains` holds the
    reference chain of each curve by its dipole; a dipole that is not there has none that is known. `anomalies` are the
    spectra of the window with anomalous power, most of which were left out.
    """

    scope: Scope
    since: Instant
    until: Instant
    inputs: Mapping[str, Any]
    curves: Sequence[CalibrationCurve]
    made: Instant
    made_by: str
    reason: str
    gate: str | None = None
    chains: Mapping[str, ReferenceChain] = field(default_factory=dict)
    anomalies: Anomalies = NONE
    stored_sha256: str | None = field(default=None, compare=False)
    """Hash of the curves when they were stored; None where they are not stored yet."""

    @property
    def id(self) -> str:
        """The hash of the inputs."""
        return hash_content(self.inputs)

    @property
    def model(self) -> str | None:
        """The id of the model, where causes were adopted into it; None for the chain alone."""
        return self.inputs.get("model")

    @property
    def window(self) -> tuple[Instant, Instant]:
        """The half-open interval whose spectra it was made from."""
        return self.since, self.until

    @property
    def payload(self) -> list[dict[str, Any]]:
        """The curves as JSON values; `payload_sha256` is the hash of this list as canonical JSON."""
        return [curve.as_dict() for curve in self.curves]

    @property
    def payload_sha256(self) -> str:
        """The hash that clients verify: of stored curves the hash of then, which shows whether they have changed."""
        return self.stored_sha256 or hash_content(self.payload)

    @property
    def status(self) -> str:
        """The worst status of its curves."""
        return max((curve.status for curve in self.curves), key=STATUSES.index)

    @property
    def events(self) -> int:
        """The largest number of events behind any of its curves."""
        return max(curve.events for curve in self.curves)

    @property
    def budgets(self) -> set[str]:
        """Hashes of the budgets that its curves name."""
        covariances = (curve.covariance for curve in self.curves)
        return {one.budget for one in covariances if one is not None and one.budget is not None}

    def serves(self, dipole: str | None) -> bool:
        """Whether it has a curve for a dipole: a mean has none of dipoles that nobody recorded."""
        return any(dipole is None or curve.dipole in (dipole, None) for curve in self.curves)

    def curve_of(self, dipole: str) -> CalibrationCurve:
        """Find the curve that serves a dipole."""
        return next(curve for curve in self.curves if curve.dipole in (dipole, None))

    def cable_of(self, path: Scope, instant: Instant) -> str | None:
        """Name of the cable of a path at an instant, as the version's own chain knows it; None where it does not."""
        chain = self.chains.get(str(path.dipole))
        seconds = instant / SECOND_US
        return None if chain is None else chain.cables.cable_of(str(path.station), int(str(path.antenna)), seconds)

    def is_over(self, instant: Instant) -> bool:
        """Whether its window has a part on both sides of an instant."""
        return self.since < instant < self.until

    def serve(self, path: Scope, instant: Instant) -> ServedCurve:
        """The curve as a path is served it, through the cable that the path has at an instant."""
        station, antenna, dipole = str(path.station), int(str(path.antenna)), str(path.dipole)
        return carry_to_path(
            self.curve_of(dipole), self.chains.get(dipole), station, antenna, dipole, instant / SECOND_US
        )


@dataclass(frozen=True)
class MeanC:
    """The band mean of C of one curve of a version, V per ADC unit, and its standard deviation."""

    calibration: str
    scope: Scope
    dipole: str
    since: Instant
    until: Instant
    events: int
    c: float
    c_sigma: float


def mean_over_band(curve: CalibrationCurve) -> tuple[float, float] | None:
    """Mean of C over the channels; its error is the median relative one, because the errors of channels move together.

    V per ADC unit, both; None for a curve without C. A channel without a value counts as those beside it do, so that
    means over a band with and without it compare.
    """
    if curve.c is None or curve.c_sigma_stat is None:
        return None
    mean = float(np.mean(curve.filled(curve.c)))
    return mean, mean * float(np.nanmedian(curve.c_sigma_stat / curve.c))


@dataclass(frozen=True)
class Examined:
    """The fit of a scope's window whose C is that of the version in effect, but for `shift` standard deviations.

    `inputs` is the id that its version would have; where an earlier fit was continued, the hash of its version and of
    the spectra that came since.
    """

    scope: Scope
    since: Instant
    until: Instant
    inputs: str
    calibration: str
    shift: float
    made: Instant


@dataclass(frozen=True)
class Summary:
    """A version without its curves."""

    id: str
    scope: Scope
    since: Instant
    until: Instant
    made: Instant
    events: int


class Waiting(NamedTuple):
    """A version that waits for a human, and the objection of the gate; one that did not converge waits in vain."""

    calibration: str
    scope: Scope
    gate: str
    made: Instant
    since: Instant
    until: Instant
    status: str
    curves: str | None
    """Canonical JSON of what is not identifiable; None otherwise."""

    @property
    def doubts_wider(self) -> bool:
        """Whether it speaks against the answer of others: by C of its own, or by data that should have given it."""
        undetermined = (is_undetermined(parse_curve(curve)) for curve in json.loads(self.curves or "[]"))
        return self.status in WITH_VALUES or any(undetermined)

    @property
    def is_to_decide(self) -> bool:
        """Whether a person can promote it: a version without a C, or a misfit, leaves nothing to decide."""
        return self.status == CONVERGED

    @property
    def sentence(self) -> str:
        """Whose version waits, for whom, and why."""
        name = name_path(*self.scope.parts)
        waits = "waits for a person to promote it" if self.is_to_decide else "cannot be promoted"
        return f"version {self.calibration[:12]} of {name} {waits} ({self.gate})"


def _find_uncut(row: Row[Any], others: Sequence[Row[Any]]) -> str:
    """The first of the newest spectra in the longest window, of versions in the order in which they were made."""
    own = json.loads(row.inputs)
    alike = []
    for one in others:
        inputs = json.loads(one.inputs)
        if 2 * one.events >= row.events and all(inputs.get(name) == own.get(name) for name in OF_SIMULATION):
            alike.append((one.until_us - one.since_us, inputs["spectra"], one.id))
    longest, first = max((length for length, *_ in alike), default=0), dict[str, str]()
    for length, spectra, name in alike:
        if length == longest:
            first.setdefault(spectra, name)
    return next(reversed(first.values()), row.id)


class VersionStore(Store):
    """Versions by their id."""

    def add(self, versions: Sequence[Version]) -> None:
        """Store versions; one whose inputs are stored already stays as it is."""
        rows, means = [], []
        references = write_chains(self._connection, {version.id: version.chains for version in versions})
        for version in sorted(versions, key=lambda version: version.id):
            rows.append(
                to_row(
                    version, calibration, **scope_columns(version.scope),
                    inputs=canonical_json(version.inputs), curves=canonical_json(version.payload),
                    reference=references[version.id],
                    anomalies=canonical_json(version.anomalies.as_dict()) if version.anomalies.worst else None,
                )
            )  # fmt: skip
            for curve in version.curves:
                mean = mean_over_band(curve)
                if mean is not None:
                    c, c_sigma = mean
                    means.append({"calibration": version.id, "dipole": curve.dipole or "", "c": c, "c_sigma": c_sigma})
        add_rows(self._connection, calibration, rows)
        add_rows(self._connection, calibration_mean, means)

    def confirm(self, found: Sequence[Examined]) -> None:
        """Write what confirmed versions in effect, in place of what did so before in the same window."""
        ordered = sorted(found, key=lambda one: one.scope.key)
        put_rows(self._connection, examined, [to_row(one, examined, scope=one.scope.key) for one in ordered])

    def confirmation(self, version_id: str) -> Examined | None:
        """The fit that confirmed a version last; None where none did."""
        statement = select(examined).where(examined.c.calibration == version_id)
        row = self._connection.execute(statement.order_by(examined.c.made_us.desc()).limit(1)).one_or_none()
        return None if row is None else from_row(Examined, row, scope=parse_scope(row.scope))

    def get(self, version_id: str) -> Version:
        """One version by its id, or by as many first digits as no other has; `NotFoundError` for an unknown one."""
        found = self.get_many([complete_id(self._connection, calibration.c.id, version_id, "version")])
        return require_one(found.values(), f"no calibration {version_id!r}; GET /v1/calibrations lists them")

    def get_many(self, ids: Iterable[str]) -> dict[str, Version]:
        """Versions by their ids; unknown ids are left out."""
        rows = list(select_many(self._connection, select(calibration), calibration.c.id, ids))
        return {row.id: version for row, version in zip(rows, self._values(rows), strict=True)}

    def uncut(self, ids: Collection[str], instant: Instant) -> dict[str, str]:
        """The version that each of some would be if nothing cut its window, by id.

        Promoted once and by the same simulation, it has the longest window that holds an instant, with at least half of
        the events; there the newest spectra, and of those that have these it was made first, whatever others lent it.
        """
        names = ("id", "scope", "since_us", "until_us", "events", "inputs")
        columns = [calibration.c[name] for name in names]
        wanted = self._connection.execute(select(*columns).where(calibration.c.id.in_(ids))).all()
        if not wanted:
            return {}
        scopes = {row.scope for row in wanted}
        is_like = (
            calibration.c.scope.in_(scopes),
            calibration.c.id.in_(select(promotion.c.calibration).where(promotion.c.scope.in_(scopes))),
            calibration.c.since_us <= instant,
            calibration.c.until_us > instant,
            2 * calibration.c.events >= min(row.events for row in wanted),
            or_(calibration.c.status == CONVERGED, calibration.c.id.in_(ids)),
        )
        of_scope = defaultdict[str, list[Row[Any]]](list)
        for row in self._connection.execute(select(*columns).where(*is_like).order_by("made_us", "id")):
            of_scope[row.scope].append(row)
        return {row.id: _find_uncut(row, of_scope[row.scope]) for row in wanted}

    def search(self, scope: Scope | None, status: str | None, cursor: str, limit: int) -> list[Version]:
        """Versions with an id after a cursor, in order of id."""
        asked = equal(calibration, scope=None if scope is None else scope.key, status=status)
        statement = select(calibration).where(calibration.c.id > cursor, *asked)
        return self._values(self._connection.execute(statement.order_by(calibration.c.id).limit(limit)).all())

    def newest(self, scope: Scope, also: Iterable[str]) -> list[Version]:
        """Versions of a scope that no newer one of their window replaced, and others by id, by window."""
        window, is_own = (calibration.c.since_us, calibration.c.until_us), calibration.c.scope == scope.key
        last = select(*window, func.max(calibration.c.made_us)).where(is_own).group_by(*window)
        is_shown = or_(tuple_(*window, calibration.c.made_us).in_(last), calibration.c.id.in_(sorted(set(also))))
        statement = select(calibration).where(is_own, is_shown)
        in_order = statement.order_by(calibration.c.since_us, calibration.c.made_us, calibration.c.id)
        return self._values(self._connection.execute(in_order).all())

    def cable_changes(self) -> dict[str, set[float]]:
        """When antennas change cables, unix seconds by station, in any table that a version answers with."""
        found: dict[str, set[float]] = {}
        for row in self._connection.execute(select(chain_part)):
            for station, _, _, *instants in json.loads(row.content).get("antennas", ()):
                found.setdefault(station, set()).update(instant for instant in instants if instant is not None)
        return found

    def misfits(self) -> list[Summary]:
        """Versions that misfit and have no newer one of their window, in order of scope."""
        asked = select(calibration.c.id).where(calibration.c.status == MISFIT, ~_has_newer())
        found = self.summaries(self._connection.execute(asked).scalars())
        return sorted(found, key=lambda one: one.scope.key)

    def waiting(self, scopes: Iterable[Scope] | None = None, at: Instant | None = None) -> list[Waiting]:
        """List what waits for a human, of all or some scopes, at any or an instant, in the order in which it was made.

        That is kept back by the gate, promoted by nobody, newest of its window. One over whose window versions were
        promoted since, such as those on both sides of a change, is over.
        """
        promoted = select(promotion.c.id).where(promotion.c.calibration == calibration.c.id).exists()
        is_over = and_(_is_promoted_since(calibration.c.since_us), _is_promoted_since(calibration.c.until_us - 1))
        inside = [] if at is None else [calibration.c.since_us <= at, calibration.c.until_us > at]
        names = ("id", "scope", "gate", "made_us", "since_us", "until_us", "status")
        curves = case((calibration.c.status == NOT_IDENTIFIABLE, calibration.c.curves))
        statement = select(*[*(calibration.c[name] for name in names), curves])
        inside += [] if scopes is None else [calibration.c.scope.in_({scope.key for scope in scopes})]
        rows = self._connection.execute(statement.where(IS_GATED, *inside, ~promoted, ~_has_newer(), ~is_over))
        # Few are kept back, and an index holds just these: a database that is asked for an order reads all versions.
        own = sorted((row.made_us, row.id, row) for row in rows)
        return [Waiting(name, parse_scope(row.scope), *row[2:]) for _, name, row in own]

    def summaries(self, ids: Iterable[str]) -> list[Summary]:
        """Versions by their ids, without their curves."""
        names = ("id", "scope", "since_us", "until_us", "made_us", "events")
        columns = [calibration.c[name] for name in names]
        rows = select_many(self._connection, select(*columns), calibration.c.id, ids)
        return [from_row(Summary, row, scope=parse_scope(row.scope)) for row in rows]

    def means(self, ids: Iterable[str]) -> list[MeanC]:
        """Band means of C of the converged curves of versions, in order of their windows."""
        columns = [
            *(calibration.c[name] for name in ("id", "scope", "since_us", "until_us", "made_us", "events")),
            *(calibration_mean.c[name] for name in ("dipole", "c", "c_sigma")),
        ]
        statement = select(*columns).join(calibration, calibration.c.id == calibration_mean.c.calibration)
        rows = select_many(self._connection, statement, calibration.c.id, ids)
        return [
            from_row(MeanC, row, calibration=row.id, scope=parse_scope(row.scope))
            for row in sorted(rows, key=lambda row: (row.since_us, row.made_us, row.dipole))
        ]

    def _values(self, rows: Sequence[Row[Any]]) -> list[Version]:
        chains = read_chains(self._connection, {row.id: row.reference for row in rows})
        return [_value(row, chains[row.id]) for row in rows]


def _has_newer() -> ColumnElement[bool]:
    """Whether a later version of the same scope and window was made."""
    later = calibration.alias()
    is_later = and_(
        later.c.scope == calibration.c.scope, later.c.since_us == calibration.c.since_us,
        later.c.until_us == calibration.c.until_us, later.c.made_us > calibration.c.made_us,
    )  # fmt: skip
    return select(later.c.id).where(is_later).exists()


def _is_promoted_since(instant: ColumnElement[int]) -> ColumnElement[bool]:
    """Whether another version of the same scope was put into effect at an instant after a version was made."""
    lasts = or_(promotion.c.valid_to_us.is_(None), promotion.c.valid_to_us > instant)
    later = (
        promotion.c.scope == calibration.c.scope,
        promotion.c.at_us > calibration.c.made_us,
        promotion.c.calibration.is_not(None),
    )
    return select(promotion.c.id).where(*later, promotion.c.valid_from_us <= instant, lasts).exists()


def _value(row: Row[Any], chains: Mapping[str, ReferenceChain]) -> Version:
    return from_row(
        Version, row, scope=Scope(row.station, row.antenna, row.dipole), inputs=json.loads(row.inputs),
        curves=_parse_curves(row.curves), chains=chains, stored_sha256=row.payload_sha256,
        anomalies=NONE if row.anomalies is None else parse_anomalies(json.loads(row.anomalies)),
    )  # fmt: skip


@lru_cache(CURVES_REMEMBERED)
def _parse_curves(text: str) -> tuple[CalibrationCurve, ...]:
    """Curves from their stored text; the same text, which never changes, is read once."""
    return tuple(parse_curve(curve) for curve in json.loads(text))


# Budgets of systematic errors: what the curves of a fit share, stored once under its hash.


class BudgetStore(Store):
    """Budgets by their hash."""

    def add(self, budgets: Mapping[str, Budget]) -> None:
        """Store budgets; one that is stored already stays as it is."""
        rows = [{"sha256": name, "content": canonical_json(one.as_dict())} for name, one in sorted(budgets.items())]
        add_rows(self._connection, budget, rows)

    def get(self, digest: str) -> dict[str, Any]:
        """Get one budget as JSON values; `NotFoundError` for an unknown hash."""
        lacking = f"no budget {digest!r}; a curve names its own in covariance.systematic.budget"
        return dict(json.loads(require_one(self.get_texts([digest]).values(), lacking)))

    def get_texts(self, digests: Iterable[str]) -> dict[str, str]:
        """Budgets by their hash as they are stored, canonical JSON; unknown ones are left out."""
        found = select_many(self._connection, select(budget).order_by(budget.c.sha256), budget.c.sha256, digests)
        return {row.sha256: row.content for row in found}
