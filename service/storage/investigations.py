"""Investigations of stored spectra: each is kept as it was made, and never changed."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Row, and_, func, or_, select
from sqlalchemy.dialects.postgresql import insert as postgresql_insert
from sqlalchemy.dialects.sqlite import insert as sqlite_insert

from lbacal_core.curves.validity import Instant
from lbacal_core.provenance import canonical_json
from service.errors import NotFoundError
from service.schema.tables import investigation
from service.storage.short_ids import complete_id


@dataclass(frozen=True)
class Investigation:
    """What the simulation gets wrong in the spectra of one station in one window; `id` is the hash of its inputs."""

    id: str
    station: str
    since: Instant
    until: Instant
    inputs: Mapping[str, Any]
    report: Mapping[str, Any]
    made: Instant
    made_by: str
    reason: str


class InvestigationStore:
    """Investigations are made once."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._insert: Any = sqlite_insert if connection.dialect.name == "sqlite" else postgresql_insert

    def add(self, made: Investigation) -> None:
        """Keep an investigation; one of the same inputs stays as it is."""
        row = {
            "id": made.id, "station": made.station, "since_us": made.since, "until_us": made.until,
            "inputs": canonical_json(made.inputs), "verdict": made.report["verdict"],
            "report": json.dumps(made.report, allow_nan=False), "made_us": made.made, "made_by": made.made_by,
            "reason": made.reason,
        }  # fmt: skip
        self._connection.execute(self._insert(investigation).values(row).on_conflict_do_nothing())

    def find(self, name: str) -> Investigation | None:
        """The investigation of that id."""
        row = self._connection.execute(select(investigation).where(investigation.c.id == name)).one_or_none()
        return None if row is None else _value(row)

    def get(self, name: str) -> Investigation:
        """The investigation of that id or of that beginning of one, or an error that says where the ids are."""
        found = self.find(complete_id(self._connection, investigation.c.id, name, "investigation"))
        if found is None:
            raise NotFoundError(f"no investigation {name!r}; GET /v1/investigations lists them")
        return found

    def newest(self, *, before: str | None, station: str | None, limit: int) -> Sequence[Investigation]:
        """Investigations from the newest back, those behind the one of the id `before`."""
        statement = select(investigation).order_by(investigation.c.made_us.desc(), investigation.c.id.desc())
        if station is not None:
            statement = statement.where(investigation.c.station == station)
        if before is not None:
            last = self.get(before)
            is_earlier = investigation.c.made_us < last.made
            same = and_(investigation.c.made_us == last.made, investigation.c.id < last.id)
            statement = statement.where(or_(is_earlier, same))
        return [_value(row) for row in self._connection.execute(statement.limit(limit))]

    def newest_with_findings(self) -> list[Investigation]:
        """The newest investigation of every station's window, of those that found a cause; by station and window."""
        window = (investigation.c.station, investigation.c.since_us, investigation.c.until_us)
        order = (investigation.c.made_us.desc(), investigation.c.id)
        rank = func.row_number().over(partition_by=window, order_by=order).label("rank")
        ranked = select(investigation.c.id, rank).subquery()
        statement = select(investigation).join(ranked, ranked.c.id == investigation.c.id).where(ranked.c.rank == 1)
        statement = statement.where(investigation.c.verdict != "consistent").order_by(*window)
        return [_value(row) for row in self._connection.execute(statement)]

    def newest_pairs(self) -> list[tuple[Investigation, Investigation | None]]:
        """The newest investigation of every station's last window, and the one before it, of that window or an earlier.

        Stations come in alphabetical order.
        """
        order = (investigation.c.until_us.desc(), investigation.c.made_us.desc(), investigation.c.id)
        rank = func.row_number().over(partition_by=investigation.c.station, order_by=order).label("rank")
        ranked = select(investigation.c.id, rank).subquery()
        statement = select(investigation).join(ranked, ranked.c.id == investigation.c.id).where(ranked.c.rank <= 2)
        of_station: dict[str, list[Investigation]] = {}
        for row in self._connection.execute(statement.order_by(investigation.c.station, ranked.c.rank)):
            of_station.setdefault(row.station, []).append(_value(row))
        return [(newest, before[0] if before else None) for newest, *before in of_station.values()]


def _value(row: Row[Any]) -> Investigation:
    return Investigation(
        row.id, row.station, row.since_us, row.until_us, json.loads(row.inputs), json.loads(row.report), row.made_us,
        row.made_by, row.reason,
    )  # fmt: skip
