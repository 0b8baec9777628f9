"""Events and spectra: one row a spectrum, its power as bytes."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from sqlalchemy import Connection, Row, Select, func, select, update
from sqlalchemy.dialects.postgresql import insert as postgresql_insert
from sqlalchemy.dialects.sqlite import insert as sqlite_insert

from lbacal_core.grids import Floats
from lbacal_core.spectra import Spectra
from lbacal_core.validity import Instant, Scope
from service.errors import ConflictError, NotFoundError
from service.schema.tables import event, event_flag, path, spectrum

POWER = np.dtype("<f8")
SAME_TIME_US = 1
ROWS_NAMED = 5


@dataclass(frozen=True)
class StoredEvent:
    """An air shower and what is stored of it."""

    number: int
    event_id: str
    time: Instant
    spectra: int
    stations: Sequence[str]
    flag: str | None
    env: Mapping[str, float | None]


@dataclass(frozen=True)
class Window:
    """What a fit reads: the usable events of [since, until), of a scope; None for station means all."""

    since: Instant
    until: Instant
    scope: Scope = Scope()  # noqa: RUF009 - frozen


class SpectraStore:
    """Stores spectra once, whoever sends them how often."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._insert: Any = sqlite_insert if connection.dialect.name == "sqlite" else postgresql_insert

    def add(self, spectra: Spectra) -> int:
        """Store what is new and return its count; a different spectrum under a stored key is a conflict.

        Rows are inserted in key order, so that clients who send the same events at once wait for each other instead of
        blocking each other.
        """
        times = np.round(spectra.time_unix * 1e6).astype(np.int64)
        event_of = self._event_numbers(spectra, times)
        path_of = self._path_numbers(spectra)
        rows: dict[tuple[int, int], dict[str, Any]] = {}
        for k in range(len(spectra)):
            key = (
                path_of[(str(spectra.station[k]), int(spectra.antenna[k]), str(spectra.dipole[k]))],
                event_of[str(spectra.event_id[k])],
            )
            rows[key] = {
                "path": key[0],
                "event": key[1],
                "time_us": int(times[k]),
                "blocks": int(spectra.blocks[k]),
                "power": spectra.power[k].astype(POWER).tobytes(),
            }
        statement = self._insert(spectrum).on_conflict_do_nothing().returning(spectrum.c.path, spectrum.c.event)
        stored = {(row.path, row.event) for row in self._connection.execute(statement, [rows[k] for k in sorted(rows)])}
        self._require_same({key: row for key, row in rows.items() if key not in stored})
        return len(stored)

    def _event_numbers(self, spectra: Spectra, times: Any) -> dict[str, int]:
        names, first = np.unique(spectra.event_id, return_index=True)
        rows = []
        for name, k in zip(names, first, strict=True):
            env = {key: float(v[k]) for key, v in spectra.environment.items() if np.isfinite(v[k])}
            rows.append({"event_id": str(name), "time_us": int(times[k]), "env": json.dumps(env) if env else None})
        self._connection.execute(self._insert(event).on_conflict_do_nothing(), rows)
        self._fill_env([row for row in rows if row["env"]])
        wanted = select(event.c.event_id, event.c.id).where(event.c.event_id.in_([row["event_id"] for row in rows]))
        return {row.event_id: row.id for row in self._connection.execute(wanted)}

    def _fill_env(self, rows: Iterable[dict[str, Any]]) -> None:
        """Covariates belong to the event: the first value given of each stays, a value not known before is added."""
        given = {row["event_id"]: row["env"] for row in rows}
        stored = self._connection.execute(select(event.c.event_id, event.c.env).where(event.c.event_id.in_(given)))
        for row in stored.all():
            old = json.loads(row.env or "{}")
            merged = json.loads(given[row.event_id]) | old
            if merged != old:
                change = update(event).where(event.c.event_id == row.event_id).values(env=json.dumps(merged))
                self._connection.execute(change)

    def _path_numbers(self, spectra: Spectra) -> dict[tuple[str, int, str], int]:
        keys = sorted(
            {(str(s), int(a), str(d)) for s, a, d in zip(spectra.station, spectra.antenna, spectra.dipole, strict=True)}
        )
        return self.path_numbers(keys)

    def path_numbers(self, keys: Sequence[tuple[str, int, str]]) -> dict[tuple[str, int, str], int]:
        """Row numbers of paths, made where they are new."""
        stations = sorted({station for station, _, _ in keys})
        known = {
            (row.station, row.antenna, row.dipole): row.id
            for row in self._connection.execute(select(path).where(path.c.station.in_(stations)))
        }
        new = [key for key in keys if key not in known]
        if not new:
            return known
        rows = [{"station": s, "antenna": a, "dipole": d} for s, a, d in new]
        self._connection.execute(self._insert(path).on_conflict_do_nothing(), rows)
        return self.path_numbers(keys)

    def _require_same(self, rows: Mapping[tuple[int, int], dict[str, Any]]) -> None:
        """Refuse rows whose key is stored with another content."""
        different: list[str] = []
        for number in sorted({event_number for _, event_number in rows}):
            stored = select(spectrum, path.c.station, path.c.antenna, path.c.dipole, event.c.event_id)
            stored = stored.join(path, path.c.id == spectrum.c.path).join(event, event.c.id == spectrum.c.event)
            paths = [p for p, e in rows if e == number]
            same = stored.where(spectrum.c.event == number, spectrum.c.path.in_(paths))
            for old in self._connection.execute(same):
                new = rows[(old.path, old.event)]
                what = [name for name in ("blocks", "power") if new[name] != getattr(old, name)]
                if abs(new["time_us"] - old.time_us) > SAME_TIME_US:
                    what.append("time")
                if what:
                    different.append(
                        f"{old.event_id}, {old.station} antenna {old.antenna} {old.dipole} ({', '.join(what)})"
                    )
        if different:
            more = f" and {len(different) - ROWS_NAMED} more" if len(different) > ROWS_NAMED else ""
            raise ConflictError(
                "a different spectrum is stored under the same event, station, antenna and dipole: "
                + "; ".join(different[:ROWS_NAMED])
                + more
            )

    def load(self, window: Window, frequency_mhz: Floats, resistance_ohm: float) -> Spectra | None:
        """Everything a fit of a window uses, in key order; None where there is nothing."""
        columns = [
            spectrum.c.time_us, spectrum.c.blocks, spectrum.c.power,
            path.c.station, path.c.antenna, path.c.dipole, event.c.event_id, event.c.env,
        ]  # fmt: skip
        statement = _usable(select(*columns), window)
        rows = self._connection.execute(
            statement.order_by(path.c.station, path.c.antenna, path.c.dipole, event.c.event_id)
        ).all()
        if not rows:
            return None
        power = np.frombuffer(b"".join(row.power for row in rows), dtype=POWER).astype(float)
        env = _columns_of_env([row.env for row in rows])
        return Spectra(
            frequency_mhz=frequency_mhz,
            power=power.reshape(len(rows), -1),
            event_id=np.array([row.event_id for row in rows], dtype=np.str_),
            time_unix=np.array([row.time_us for row in rows], dtype=np.int64) / 1e6,
            station=np.array([row.station for row in rows], dtype=np.str_),
            antenna=np.array([row.antenna for row in rows], dtype=np.int64),
            dipole=np.array([row.dipole for row in rows], dtype=np.str_),
            blocks=np.array([row.blocks for row in rows], dtype=np.int64),
            resistance_ohm=resistance_ohm,
            environment=env,
            origin="stored spectra",
        )

    def stations(self) -> list[str]:
        """Stations with spectra, in alphabetical order."""
        return list(self._connection.execute(select(path.c.station).distinct().order_by(path.c.station)).scalars())

    def span(self) -> tuple[Instant, Instant] | None:
        """First and last instant of any event."""
        row = self._connection.execute(select(func.min(event.c.time_us), func.max(event.c.time_us))).one()
        return None if row[0] is None else (int(row[0]), int(row[1]))

    def count_events(self) -> int:
        """How many events are stored."""
        return int(self._connection.execute(select(func.count()).select_from(event)).scalar_one())

    def content(self, window: Window) -> tuple[int, int]:
        """What a window holds: the count of its usable spectra, and the number of the last flag set in it.

        Spectra are only ever added and flags only ever appended, so the pair is the same only if the content is.
        """
        count = self._connection.execute(_usable(select(func.count()), window)).scalar_one()
        flags = select(func.coalesce(func.max(event_flag.c.id), 0)).join(event, event.c.id == event_flag.c.event)
        flags = flags.where(event.c.time_us >= window.since, event.c.time_us < window.until)
        return int(count), int(self._connection.execute(flags).scalar_one())

    def events(
        self,
        *,
        station: str | None,
        since: Instant | None,
        until: Instant | None,
        flag: str | None,
        cursor: int,
        limit: int,
    ) -> list[StoredEvent]:
        """Stored events after a cursor, in the order in which they came."""
        statement = select(event).where(event.c.id > cursor).order_by(event.c.id).limit(limit)
        if since is not None:
            statement = statement.where(event.c.time_us >= since)
        if until is not None:
            statement = statement.where(event.c.time_us < until)
        if flag is not None:
            statement = statement.where(event.c.flag == flag)
        if station is not None:
            of_station = (
                select(spectrum.c.event).join(path, path.c.id == spectrum.c.path).where(path.c.station == station)
            )
            statement = statement.where(event.c.id.in_(of_station))
        return self._with_counts(self._connection.execute(statement).all())

    def event(self, event_id: str) -> StoredEvent:
        """One event by its name."""
        rows = self._connection.execute(select(event).where(event.c.event_id == event_id)).all()
        if not rows:
            raise NotFoundError(f"no event {event_id!r} is stored; GET /v1/events lists them")
        return self._with_counts(rows)[0]

    def _with_counts(self, rows: Sequence[Row[Any]]) -> list[StoredEvent]:
        counted = select(spectrum.c.event, path.c.station, func.count().label("spectra"))
        counted = counted.join(path, path.c.id == spectrum.c.path).where(spectrum.c.event.in_([row.id for row in rows]))
        counts: dict[int, dict[str, int]] = {}
        for row in self._connection.execute(counted.group_by(spectrum.c.event, path.c.station)):
            counts.setdefault(row.event, {})[row.station] = row.spectra
        return [
            StoredEvent(
                row.id, row.event_id, row.time_us, sum(counts.get(row.id, {}).values()),
                sorted(counts.get(row.id, {})), row.flag, json.loads(row.env or "{}"),
            )
            for row in rows
        ]  # fmt: skip

    def set_flag(self, event_id: str, flag: str | None, *, reason: str, by: str, at: Instant) -> None:
        """Set or clear the quality flag of an event; who did it and why is kept."""
        number = self.event(event_id).number
        self._connection.execute(update(event).where(event.c.id == number).values(flag=flag))
        entry = {"event": number, "flag": flag, "reason": reason, "by": by, "at_us": at}
        self._connection.execute(event_flag.insert().values(entry))


def _usable(statement: Select[Any], window: Window) -> Select[Any]:
    """Restrict a statement to the spectra that a fit of a window uses."""
    statement = statement.select_from(spectrum).join(path, path.c.id == spectrum.c.path)
    statement = statement.join(event, event.c.id == spectrum.c.event)
    statement = statement.where(
        spectrum.c.time_us >= window.since, spectrum.c.time_us < window.until, event.c.flag.is_(None)
    )
    scope = window.scope
    if scope.station is not None:
        statement = statement.where(path.c.station == scope.station)
    if scope.antenna is not None:
        statement = statement.where(path.c.antenna == scope.antenna, path.c.dipole == scope.dipole)
    return statement


def _columns_of_env(texts: Sequence[str | None]) -> dict[str, Floats]:
    parsed = {text: json.loads(text) for text in set(texts) if text}
    names = sorted({name for env in parsed.values() for name in env})
    return {
        name: np.array([parsed[text].get(name, np.nan) if text else np.nan for text in texts], dtype=float)
        for name in names
    }
