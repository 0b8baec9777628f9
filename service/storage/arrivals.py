"""Spectra as they arrive: each event, covariate and spectrum is stored once, whoever sends it how often.

One statement inserts thousands of rows, and one join finds what is stored under their keys already, so that a spectrum
costs the same however large its batch is. Events go in by name, then spectra by key: clients who send the same events
at once wait for each other instead of blocking each other.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, select
from sqlalchemy.dialects.postgresql import insert as postgresql_insert
from sqlalchemy.dialects.sqlite import insert as sqlite_insert

from lbacal_core.curves.validity import Instant
from lbacal_core.errors import BadInputError
from lbacal_core.spectra.spectra import MAX_COVARIATES, Spectra
from service.errors import ConflictError
from service.schema.tables import event, path, receipt

POWER = np.dtype("<f8")
SAME_TIME_US = 1
EVENT_SPAN_US = 60_000_000
"""An event is one read-out of all antennas: two times further apart under one name are two events."""
ROWS_NAMED = 5
_ROWS_AT_ONCE = 4096

# Arrays instead of a COPY into a staging table: 0.9 of its speed for 20 events, 1.2 for one (docs/decisions/intake.md).
# %b: as bytes; psycopg writes arrays as text otherwise, in twice the time.
_SQL = {
    "sqlite": {
        "event": "INSERT INTO event (event_id, time_us, env) VALUES (?, ?, ?) ON CONFLICT DO NOTHING",
        "spectrum": "INSERT INTO spectrum (path, event, time_us, blocks, power) VALUES (?, ?, ?, ?, ?) "
        "ON CONFLICT DO NOTHING",
        "env": "UPDATE event SET env = json_patch(?, coalesce(env, '{}')) WHERE id = ?",
        "stored": "SELECT spectrum.path, spectrum.event, time_us, blocks, power FROM json_each(?) AS sent "
        "JOIN spectrum ON spectrum.path = json_extract(sent.value, '$[0]') "
        "AND spectrum.event = json_extract(sent.value, '$[1]')",
    },
    "postgresql": {
        "event": "INSERT INTO event (event_id, time_us, env) "
        "SELECT * FROM unnest(%b::text[], %b::bigint[], %b::text[]) ON CONFLICT DO NOTHING",
        "spectrum": "INSERT INTO spectrum (path, event, time_us, blocks, power) "
        "SELECT * FROM unnest(%b::int[], %b::bigint[], %b::bigint[], %b::int[], %b::bytea[]) ON CONFLICT DO NOTHING",
        "env": "UPDATE event SET env = (%s::jsonb || coalesce(env, '{}')::jsonb)::text WHERE id = %s",
        "stored": "SELECT path, event, time_us, blocks, power "
        "FROM unnest(%b::int[], %b::bigint[]) AS sent (path, event) JOIN spectrum USING (path, event)",
    },
}

Row = tuple[Any, ...]
Item = TypeVar("Item")


class Arrivals:
    """Stores what is new of a batch and refuses what contradicts the store."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._is_sqlite = connection.dialect.name == "sqlite"
        self._sql = _SQL[connection.dialect.name]
        self._upsert: Any = sqlite_insert if self._is_sqlite else postgresql_insert

    def add(self, spectra: Spectra) -> int:
        """Store what is new and return its count; a different spectrum under a stored key is a conflict."""
        times = np.round(spectra.time_unix * 1e6).astype(np.int64)
        events = self._number_events(spectra, times)
        paths = self._number_paths(spectra)
        order = np.lexsort((paths, events))
        buffer = spectra.power[order].astype(POWER).tobytes()
        width = len(buffer) // max(len(order), 1)
        powers = [buffer[k : k + width] for k in range(0, len(buffer), width)]
        columns = [column[order].tolist() for column in (paths, events, times, spectra.blocks)]
        rows: list[Row] = list(zip(*columns, powers, strict=True))
        stored = self._insert("spectrum", rows)
        if stored < len(rows):
            self._require_same(spectra, order, rows)
        return stored

    def find_receipts(self, digests: Sequence[str]) -> dict[str, int]:
        """How many spectra bodies hold that were stored whole before, by SHA-256."""
        rows = self._connection.execute(select(receipt).where(receipt.c.sha256.in_(digests)))
        return {row.sha256: row.spectra for row in rows}

    def keep_receipt(self, digest: str, spectra: int, at: Instant) -> None:
        """Remember that all spectra of a body are stored. Spectra are never deleted, so it stays true."""
        self._connection.execute(
            self._upsert(receipt).on_conflict_do_nothing(), {"sha256": digest, "spectra": spectra, "at_us": at}
        )

    def _insert(self, table: str, rows: Sequence[Row]) -> int:
        """Insert rows that are not there, and return how many were not."""
        inserted = 0
        for some in _parts(rows):
            values: Any = list(some) if self._is_sqlite else tuple(list(column) for column in zip(*some, strict=True))
            inserted += self._connection.exec_driver_sql(self._sql[table], values).rowcount
        return inserted

    def _number_events(self, spectra: Spectra, times: NDArray[np.int64]) -> NDArray[np.int64]:
        """Row number of the event of each spectrum, shape (row,); events not there are made."""
        found, first, of_row = np.unique(spectra.event_id, return_index=True, return_inverse=True)
        names: list[str] = found.tolist()
        covariates = _covariates_of_events(spectra, of_row, len(names))
        texts = [json.dumps(given) if given else None for given in covariates]
        self._insert("event", list(zip(names, times[first].tolist(), texts, strict=True)))
        stored = self._stored_events(names)
        self._require_one_time(names, of_row, times, stored)
        self._add_covariates({stored[name]: given for name, given in zip(names, covariates, strict=True) if given})
        return np.array([stored[name].id for name in names], dtype=np.int64)[of_row]

    def _stored_events(self, names: Sequence[str]) -> dict[str, Any]:
        wanted = [select(event).where(event.c.event_id.in_(some)) for some in _parts(names)]
        return {row.event_id: row for statement in wanted for row in self._connection.execute(statement)}

    def _require_one_time(
        self, names: Sequence[str], of_row: NDArray[np.int64], times: NDArray[np.int64], stored: Mapping[str, Any]
    ) -> None:
        of_event = np.array([stored[name].time_us for name in names], dtype=np.int64)
        off = np.flatnonzero(np.abs(times - of_event[of_row]) > EVENT_SPAN_US)
        if off.size:
            name = names[of_row[off[0]]]
            apart = abs(int(times[off[0]]) - stored[name].time_us) / 1e6
            raise ConflictError(
                f"event {name} is stored {apart:.0f} s away from the time sent with it, and one event lasts less than "
                f"{EVENT_SPAN_US / 1e6:.0f} s: give the other event a name of its own"
            )

    def _add_covariates(self, given: Mapping[Any, Mapping[str, float]]) -> None:
        """Covariates belong to the event: the first value given of each stays, a value not known before is added.

        The merge happens inside the statement, so that two clients who add different names both succeed.
        """
        changes = []
        for row, values in given.items():
            known = json.loads(row.env or "{}")
            new = {name: value for name, value in values.items() if name not in known}
            if len(known) + len(new) > MAX_COVARIATES:
                found = f"{len(known)} that are stored and {', '.join(new)}"
                raise BadInputError(f"env of event {row.event_id}", f"at most {MAX_COVARIATES} names", found)
            if new:
                changes.append((json.dumps(new), row.id))
        if changes:
            self._connection.exec_driver_sql(self._sql["env"], sorted(changes, key=lambda change: change[1]))

    def _number_paths(self, spectra: Spectra) -> NDArray[np.int64]:
        """Row number of the path of each spectrum, shape (row,); paths not there are made."""
        keys = list(zip(spectra.station.tolist(), spectra.antenna.tolist(), spectra.dipole.tolist(), strict=True))
        wanted = sorted(set(keys))
        known = self._stored_paths(wanted)
        new = [{"station": s, "antenna": a, "dipole": d} for s, a, d in wanted if (s, a, d) not in known]
        if new:
            self._connection.execute(self._upsert(path).on_conflict_do_nothing(), new)
            known = self._stored_paths(wanted)
        return np.array([known[key] for key in keys], dtype=np.int64)

    def _stored_paths(self, keys: Sequence[tuple[str, int, str]]) -> dict[tuple[str, int, str], int]:
        stations = sorted({station for station, _, _ in keys})
        columns = select(path.c.id, path.c.station, path.c.antenna, path.c.dipole)
        rows = self._connection.execute(columns.where(path.c.station.in_(stations))).all()
        return {(station, antenna, dipole): number for number, station, antenna, dipole in rows}

    def _require_same(self, spectra: Spectra, order: NDArray[np.int64], rows: Sequence[Row]) -> None:
        """Refuse rows whose key is stored with another content."""
        sent = {row[:2]: k for k, row in enumerate(rows)}
        different: list[str] = []
        for some in _parts(rows):
            keys = [row[:2] for row in some]
            values: Any = (json.dumps(keys),) if self._is_sqlite else tuple(list(c) for c in zip(*keys, strict=True))
            for stored in self._connection.exec_driver_sql(self._sql["stored"], values):
                k = sent[(stored.path, stored.event)]
                _, _, time_us, blocks, power = rows[k]
                what = ["blocks"] if stored.blocks != blocks else []
                what += ["power"] if stored.power != power else []
                what += ["time"] if abs(stored.time_us - time_us) > SAME_TIME_US else []
                if what:
                    different.append(f"{spectra.name_row(int(order[k]))} ({', '.join(what)})")
        if different:
            more = f" and {len(different) - ROWS_NAMED} more" if len(different) > ROWS_NAMED else ""
            raise ConflictError(
                "a different spectrum is stored under the same event, station, antenna and dipole: "
                + "; ".join(different[:ROWS_NAMED])
                + more
            )


def _covariates_of_events(spectra: Spectra, of_row: NDArray[np.int64], events: int) -> list[dict[str, float]]:
    """The first value that a batch gives of each covariate of each event."""
    covariates: list[dict[str, float]] = [{} for _ in range(events)]
    for name, values in spectra.environment.items():
        known = np.flatnonzero(np.isfinite(values))
        of_event, first = np.unique(of_row[known], return_index=True)
        for k, value in zip(of_event.tolist(), values[known[first]].tolist(), strict=True):
            covariates[k][name] = value
    return covariates


def _parts(items: Sequence[Item]) -> Iterator[Sequence[Item]]:
    for start in range(0, len(items), _ROWS_AT_ONCE):
        yield items[start : start + _ROWS_AT_ONCE]
