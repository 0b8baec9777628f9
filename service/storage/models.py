"""Models that were adopted: canonical texts under their hash, and an insert-only ledger of what each station has."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from sqlalchemy import Column, Connection, Row, and_, func, or_, select

from lbacal.instants import SECOND_US
from lbacal_core.causes.model import Model, follows_date
from lbacal_core.curves.validity import Instant
from lbacal_core.errors import BadInputError
from lbacal_core.provenance import canonical_json
from service.errors import NotFoundError
from service.schema.tables import investigation, model, model_change, model_gain
from service.storage.rows import Store, add_rows, equal, from_row, put_rows, require_one, to_row

# Ids by their first digits, where no other id begins with them.

ID_DIGITS = 64
FEWEST_DIGITS = 6
_SHORT_ID = re.compile(r"[0-9a-f]{1,63}")


def complete_id(connection: Connection, column: Column[str], beginning: str, noun: str) -> str:
    """The one id of a column that begins with some digits; what none begins with is returned as it is.

    Raises
    ------
    BadInputError
        Where several begin with them.
    NotFoundError
        Where they are too few.
    """
    if len(beginning) == ID_DIGITS or not _SHORT_ID.fullmatch(beginning):
        return beginning
    if len(beginning) < FEWEST_DIGITS:
        raise NotFoundError(f"{beginning!r} names no {noun}: {FEWEST_DIGITS} or more digits of its id do")
    is_meant = column.between(beginning, beginning.ljust(ID_DIGITS, "f"))
    found = list(connection.execute(select(column).where(is_meant).limit(2)).scalars())
    if len(found) > 1:
        raise BadInputError("id", f"more digits of the id of one {noun}", f"{beginning}, which several have")
    return str(found[0]) if found else beginning


ADOPTED, WITHDRAWN = "adopted", "withdrawn"
STOPPED_SIGMA = 3.0
"""Standard deviations by which a gain lies below the expected one where a cause has stopped paying."""


@dataclass(frozen=True)
class Announced:
    """The change of the band mean of C that a change of the model was said to make, as a fraction, and its error."""

    fraction: float
    sigma: float


@dataclass(frozen=True)
class ModelChange:
    """One line of the ledger: from now on a station's fits use another model, with one cause more or less.

    Attributes
    ----------
    cause
        The id of the model that has this cause alone: what gains are kept under.
    since, until
        The interval in which the cause acts; windows outside keep what they have.
    known_until
        The newest event of the investigation: what the cause gains is counted on later ones.
    announced
        By the key of a scope and dipole (``CS002/17/X X``).
    promise
        The gain in log-likelihood that the finding promises for as many events again, with its error; None if unknown.
    """

    number: int
    station: str
    act: str
    model: str
    before: str
    cause: str
    since: Instant | None
    until: Instant | None
    known_until: Instant | None
    investigation: str | None
    finding: int | None
    announced: Mapping[str, Announced]
    promise: tuple[float, float] | None
    at: Instant
    by: str
    reason: str

    def touches(self, since: Instant, until: Instant) -> bool:
        """Whether the cause acts in a window."""
        return (self.since is None or self.since < until) and (self.until is None or self.until > since)


@dataclass(frozen=True)
class Gain:
    """The gain of an adopted cause in log-likelihood on the events of a window that its adoption had not used.

    `expected` and its error follow from the size as it was adopted.
    """

    cause: str
    station: str
    since: Instant
    until: Instant
    events: int
    gain: float
    expected: float
    expected_sigma: float
    made: Instant

    @property
    def has_stopped_paying(self) -> bool:
        """Whether these events gain significantly less than they would with the size as adopted."""
        return self.gain < self.expected - STOPPED_SIGMA * self.expected_sigma


class ModelStore(Store):
    """Models, changes and gains; only the gain of a window is replaced, by that of more events."""

    def put(self, *models: Model) -> None:
        """Keep the texts of models; one that is kept already stays as it is."""
        add_rows(self._connection, model, [{"id": one.id, "content": one.to_text()} for one in models])

    def get(self, name: str) -> Model:
        """A model by its id or by as many of its first digits as no other begins with.

        `NotFoundError` for an unknown one.
        """
        whole = complete_id(self._connection, model.c.id, name, "model")
        texts = self._connection.execute(select(model.c.content).where(model.c.id == whole)).scalars()
        return Model.from_text(require_one(texts, f"no model {name!r}; GET /v1/models lists them"))

    def change(self, made: ModelChange) -> ModelChange:
        """Write a line of the ledger, and return it with the number that the database gives it."""
        announced = canonical_json({key: [one.fraction, one.sigma] for key, one in made.announced.items()})
        promise = None if made.promise is None else canonical_json(list(made.promise))
        row = to_row(made, model_change, announced=announced, promise=promise)
        number = self._connection.execute(model_change.insert().values(row).returning(model_change.c.id)).scalar_one()
        return replace(made, number=number)

    def changes(self, station: str | None = None) -> list[ModelChange]:
        """The ledger, oldest first, of all stations or of one."""
        statement = select(model_change).where(*equal(model_change, station=station)).order_by(model_change.c.id)
        return [_change(row) for row in self._connection.execute(statement)]

    def current(self) -> Model:
        """Everything that is adopted now, at all stations."""
        newest = select(func.max(model_change.c.id)).group_by(model_change.c.station)
        statement = select(model.c.content).join(model_change, model_change.c.model == model.c.id)
        texts = self._connection.execute(statement.where(model_change.c.id.in_(newest))).scalars()
        return Model(tuple(cause for text in texts for cause in Model.from_text(text).causes))

    def during(self, station: str | None, since: Instant, until: Instant) -> Model:
        """The adopted causes that act in a window, of one station or of all."""
        return self.of_station(station).during(since / SECOND_US, until / SECOND_US)

    def of_station(self, station: str | None) -> Model:
        """The adopted causes of one station or of all.

        What follows the date is a change and no cause, also where somebody adopted it when that was not refused.
        """
        adopted = Model(tuple(one for one in self.current().causes if not follows_date(one.cause, one.parameters)))
        return adopted if station is None else adopted.of_stations([station])

    def last_change(self, station: str | None, since: Instant, until: Instant) -> ModelChange | None:
        """The newest change that touches a window, of one station or of all (None); None where none does."""
        touching = [one for one in self.changes(station) if one.touches(since, until)]
        return touching[-1] if touching else None

    def put_gains(self, gains: Sequence[Gain]) -> None:
        """Write gains in place of those of the same cause and window."""
        put_rows(self._connection, model_gain, [to_row(one, model_gain) for one in gains])

    def gains(self) -> list[Gain]:
        """All gains, in order of their windows."""
        statement = select(model_gain).order_by(model_gain.c.since_us, model_gain.c.cause)
        return [from_row(Gain, row) for row in self._connection.execute(statement)]


def _change(row: Row[Any]) -> ModelChange:
    announced = {key: Announced(*values) for key, values in json.loads(row.announced).items()}
    promise = None if row.promise is None else tuple(json.loads(row.promise))
    return from_row(ModelChange, row, number=row.id, announced=announced, promise=promise)


# Investigations of stored spectra: each is kept as it was made, and never changed.


@dataclass(frozen=True)
class Investigation:
    """An investigation of the spectra of one station in one window; `id` is the hash of its inputs."""

    id: str
    station: str
    since: Instant
    until: Instant
    inputs: Mapping[str, Any]
    report: Mapping[str, Any]
    made: Instant
    made_by: str
    reason: str


_STATION = investigation.c.station
_NEWEST = investigation.c.made_us.desc(), investigation.c.id


class InvestigationStore(Store):
    """Investigations are made once."""

    def add(self, made: Investigation) -> None:
        """Keep an investigation; one of the same inputs stays as it is."""
        inputs, report = canonical_json(made.inputs), json.dumps(made.report, allow_nan=False)
        row = to_row(made, investigation, inputs=inputs, report=report, verdict=made.report["verdict"])
        add_rows(self._connection, investigation, [row])

    def find(self, name: str) -> Investigation | None:
        """Find the investigation of that id; None where there is none."""
        row = self._connection.execute(select(investigation).where(investigation.c.id == name)).one_or_none()
        return None if row is None else _value(row)

    def get(self, name: str) -> Investigation:
        """The investigation of that id or of that beginning of one; `NotFoundError` says where the ids are."""
        found = self.find(complete_id(self._connection, investigation.c.id, name, "investigation"))
        return require_one([found] if found else [], f"no investigation {name!r}; GET /v1/investigations lists them")

    def newest(self, *, before: str | None, station: str | None, limit: int) -> Sequence[Investigation]:
        """Investigations from the newest back, those behind the one of the id `before`."""
        statement = select(investigation).where(*equal(investigation, station=station))
        statement = statement.order_by(investigation.c.made_us.desc(), investigation.c.id.desc())
        if before is not None:
            last = self.get(before)
            is_earlier = investigation.c.made_us < last.made
            same = and_(investigation.c.made_us == last.made, investigation.c.id < last.id)
            statement = statement.where(or_(is_earlier, same))
        return [_value(row) for row in self._connection.execute(statement.limit(limit))]

    def newest_covering(self, instant: Instant, station: str | None) -> list[Investigation]:
        """The newest investigation of each station whose window holds an instant, by station."""
        holds = investigation.c.since_us <= instant, investigation.c.until_us > instant
        return self._ranked((_STATION,), _NEWEST, 1, *holds, *equal(investigation, station=station))

    def newest_with_findings(self) -> list[Investigation]:
        """The newest investigation of every station's window, of those that are not `consistent`.

        By station and window.
        """
        window = _STATION, investigation.c.since_us, investigation.c.until_us
        return self._ranked(window, _NEWEST, 1, is_shown=investigation.c.verdict != "consistent")

    def newest_pairs(self) -> list[tuple[Investigation, Investigation | None]]:
        """The newest investigation of every station's last window, and any one before it, of that or an earlier.

        Stations come in alphabetical order.
        """
        of_station: dict[str, list[Investigation]] = {}
        for one in self._ranked((_STATION,), (investigation.c.until_us.desc(), *_NEWEST), 2):
            of_station.setdefault(one.station, []).append(one)
        return [(newest, before[0] if before else None) for newest, *before in of_station.values()]

    def _ranked(
        self, groups: Sequence[Any], order: Sequence[Any], most: int, *which: Any, is_shown: Any = True
    ) -> list[Investigation]:
        """The first investigations of each group, of those that are shown, in order of the groups."""
        rank = func.row_number().over(partition_by=groups, order_by=order).label("rank")
        ranked = select(investigation.c.id, rank).where(*which).subquery()
        joined = select(investigation).join(ranked, ranked.c.id == investigation.c.id)
        shown = joined.where(ranked.c.rank <= most, is_shown).order_by(*groups, ranked.c.rank)
        return [_value(row) for row in self._connection.execute(shown)]


def _value(row: Row[Any]) -> Investigation:
    return from_row(Investigation, row, inputs=json.loads(row.inputs), report=json.loads(row.report))
