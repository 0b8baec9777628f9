"""Events and spectra: one row a spectrum, its power as bytes."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import compress, groupby
from math import isnan
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import ColumnElement, Connection, Row, Select, bindparam, exists, func, select, union_all, update

from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.spectra.screening import LASTING_EVENTS, SHARE_OF_STATE, measure_level
from lbacal_core.spectra.spectra import MAX_COVARIATES, Spectra
from service.errors import ConflictError
from service.schema.tables import IS_FAR, event, event_flag, event_station, path, receipt, spectrum
from service.storage.rows import Store, add_rows, equal, insert_into, require_one, select_many

# Spectra as they arrive: each event, covariate and spectrum is stored once, whoever sends it how often.
#
# One statement inserts thousands of rows, and one join finds what is stored under their keys already, so that a
# spectrum costs the same however large its batch is. Events go in by name, then spectra by key: clients who send the
# same events at once wait for each other instead of blocking each other.

POWER = np.dtype("<f8")
SAME_TIME_US = 1
EVENT_SPAN_US = 60_000_000
"""An event is one read-out of all antennas: two times further apart under one name are two events."""
ROWS_NAMED = 5
EVENTS_BESIDE = 4
"""Events before and after an instant whose power says what is usual of a path."""
_ROWS_AT_ONCE = 4096

# Arrays instead of a COPY into a staging table: 0.9 of its speed for 20 events, 1.2 for one (docs/decisions/intake.md).
# %b: as bytes; psycopg writes arrays as text otherwise, in twice the time.
_SQL = {
    "sqlite": {
        "event": "INSERT INTO event (event_id, time_us, env) VALUES (?, ?, ?) ON CONFLICT DO NOTHING",
        "spectrum": "INSERT INTO spectrum (path, event, time_us, blocks, power, far) VALUES (?, ?, ?, ?, ?, ?) "
        "ON CONFLICT DO NOTHING",
        "env": "UPDATE event SET env = json_patch(?, coalesce(env, '{}')) WHERE id = ?",
        "stored": "SELECT spectrum.path, spectrum.event, time_us, blocks, power FROM json_each(?) AS sent "
        "JOIN spectrum ON spectrum.path = json_extract(sent.value, '$[0]') "
        "AND spectrum.event = json_extract(sent.value, '$[1]')",
    },
    "postgresql": {
        "event": "INSERT INTO event (event_id, time_us, env) "
        "SELECT * FROM unnest(%b::text[], %b::bigint[], %b::text[]) ON CONFLICT DO NOTHING",
        "spectrum": "INSERT INTO spectrum (path, event, time_us, blocks, power, far) "
        "SELECT * FROM unnest(%b::int[], %b::bigint[], %b::bigint[], %b::int[], %b::bytea[], %b::float8[]) "
        "ON CONFLICT DO NOTHING",
        "env": "UPDATE event SET env = (%s::jsonb || coalesce(env, '{}')::jsonb)::text WHERE id = %s",
        "stored": "SELECT path, event, time_us, blocks, power "
        "FROM unnest(%b::int[], %b::bigint[]) AS sent (path, event) JOIN spectrum USING (path, event)",
    },
}

ArrivalRow = tuple[Any, ...]
Item = TypeVar("Item")
OfStation = tuple[int, str]
"""Number of an event, and a station."""


@dataclass(frozen=True)
class Added:
    """The new part of a batch.

    Attributes
    ----------
    spectra
        How many are stored now that were not.
    covariates
        How many became known of events that were there.
    differing
        Events of which another value than the stored one was sent, by covariate; the stored one stays.
    """

    spectra: int
    covariates: int
    differing: Mapping[str, Sequence[str]]


class Arrivals:
    """Stores what is new of a batch and refuses what contradicts the store."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._is_sqlite = connection.dialect.name == "sqlite"
        self._sql = _SQL[connection.dialect.name]

    def add(self, spectra: Spectra, far: Floats | None = None) -> Added:
        """Store what is new and count it; a different spectrum under a stored key is a conflict.

        `far` is power over the usual power of a path, shape (row,), for spectra that wait; NaN for others.
        """
        times = np.round(spectra.time_unix * 1e6).astype(np.int64)
        events, covariates, differing = self._number_events(spectra, times)
        paths = self._number_paths(spectra)
        order = np.lexsort((paths, events))
        buffer = spectra.power[order].astype(POWER).tobytes()
        width = len(buffer) // max(len(order), 1)
        powers = [buffer[k : k + width] for k in range(0, len(buffer), width)]
        columns = [column[order].tolist() for column in (paths, events, times, spectra.blocks)]
        far = np.full(len(spectra), np.nan) if far is None else far
        waiting = [None if isnan(one) else one for one in far[order].tolist()]
        rows: list[ArrivalRow] = list(zip(*columns, powers, waiting, strict=True))
        new = self._insert_spectra(rows)
        keys = list(zip(columns[1], spectra.station[order].tolist(), strict=True))
        is_far = np.isfinite(far[order])
        added, waits = (Counter(compress(keys, which.tolist())) for which in (new, new & is_far))
        _count(self._connection, added, waits)
        if not np.all(new):
            self._require_same(spectra, order, rows)
        return Added(int(np.sum(new)), covariates, differing)

    def find_receipts(self, digests: Sequence[str]) -> dict[str, tuple[int, list[str]]]:
        """How many spectra bodies hold that were stored whole before, and what was said of them, by SHA-256."""
        rows = self._connection.execute(select(receipt).where(receipt.c.sha256.in_(digests)))
        return {row.sha256: (row.spectra, json.loads(row.warnings or "[]")) for row in rows}

    def newest(self) -> Instant | None:
        """Find when spectra arrived last over HTTP; None where none ever did."""
        newest: Instant | None = self._connection.execute(select(func.max(receipt.c.at_us))).scalar_one()
        return newest

    def keep_receipt(self, digest: str, spectra: int, warnings: Sequence[str], at: Instant) -> None:
        """Remember that all spectra of a body are stored. Spectra are never deleted, so it stays true."""
        row = {
            "sha256": digest,
            "spectra": spectra,
            "warnings": json.dumps(warnings) if warnings else None,
            "at_us": at,
        }
        add_rows(self._connection, receipt, [row])

    def find_levels(
        self, paths: Sequence[tuple[str, int, str]], at: Instant
    ) -> dict[tuple[str, int, str], list[float]]:
        """The levels of some paths of a station, ln of power, in the events nearest to an instant that are not flagged.

        At most `EVENTS_BESIDE` events until then and as many later, those that any of the paths has. A spectrum that
        waits has the usual level of its path: its own without the factor.
        """
        stored = self._stored_paths(paths)
        key = {stored[one]: one for one in paths if one in stored}
        has_any = exists().where(spectrum.c.event == event.c.id, spectrum.c.path.in_(key))
        near = select(event.c.id).where(event.c.flag.is_(None), has_any).limit(EVENTS_BESIDE)
        before = near.where(event.c.time_us <= at).order_by(event.c.time_us.desc()).subquery()
        after = near.where(event.c.time_us > at).order_by(event.c.time_us).subquery()
        columns = select(spectrum.c.path, spectrum.c.power, spectrum.c.far).where(spectrum.c.path.in_(key))
        of_events = columns.where(spectrum.c.event.in_(union_all(select(before), select(after))))
        rows = self._connection.execute(of_events).all() if key else ()
        levels: dict[tuple[str, int, str], list[float]] = {}
        if rows:
            usual = _levels_of(rows) - np.log([row.far or 1.0 for row in rows])
            for row, level in zip(rows, usual.tolist(), strict=True):
                levels.setdefault(key[row.path], []).append(level)
        return levels

    def _insert(self, table: str, rows: Sequence[ArrivalRow]) -> int:
        """Insert rows that are not there, and return how many were not."""
        inserted = 0
        for some in _parts(rows):
            values: Any = list(some) if self._is_sqlite else tuple(list(column) for column in zip(*some, strict=True))
            inserted += self._connection.exec_driver_sql(self._sql[table], values).rowcount
        return inserted

    def _insert_spectra(self, rows: Sequence[ArrivalRow]) -> NDArray[np.bool_]:
        """Insert spectra that are not there, and return which were not, shape (row,)."""
        if not self._is_sqlite:
            found: set[tuple[int, int]] = set()
            for some in _parts(rows):
                values = tuple(list(column) for column in zip(*some, strict=True))
                done = self._connection.exec_driver_sql(self._sql["spectrum"] + " RETURNING path, event", values)
                found.update((row.path, row.event) for row in done)
            return np.array([row[:2] in found for row in rows], dtype=bool)
        # the one who writes finds what it wrote behind what was there
        last = self._connection.exec_driver_sql("SELECT coalesce(max(rowid), 0) FROM spectrum").scalar_one()
        if self._insert("spectrum", rows) == len(rows):
            return np.ones(len(rows), dtype=bool)
        written = self._connection.exec_driver_sql("SELECT path, event FROM spectrum WHERE rowid > ?", (last,))
        found = {(row.path, row.event) for row in written}
        return np.array([row[:2] in found for row in rows], dtype=bool)

    def _number_events(
        self, spectra: Spectra, times: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], int, dict[str, list[str]]]:
        """Row number of the event of each spectrum, shape (row,), and what `_add_covariates` returns.

        Events not there are made.
        """
        found, first, of_row = np.unique(spectra.event_id, return_index=True, return_inverse=True)
        names: list[str] = found.tolist()
        covariates = _covariates_of_events(spectra, of_row, len(names))
        texts = [json.dumps(given) if given else None for given in covariates]
        self._insert("event", list(zip(names, times[first].tolist(), texts, strict=True)))
        rows = select_many(self._connection, select(event), event.c.event_id, names)
        stored: dict[str, Any] = {row.event_id: row for row in rows}
        self._require_one_time(names, of_row, times, stored)
        told = self._add_covariates(
            {stored[name]: given for name, given in zip(names, covariates, strict=True) if given}
        )
        return np.array([stored[name].id for name in names], dtype=np.int64)[of_row], *told

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

    def _add_covariates(self, given: Mapping[Any, Mapping[str, float]]) -> tuple[int, dict[str, list[str]]]:
        """Covariates belong to the event: the first value given of each stays, a value not known before is added.

        The merge happens inside the statement, so that two clients who add different names both succeed. Returns how
        many were added, and the events that have another value by covariate.
        """
        changes, added = [], 0
        differing: dict[str, list[str]] = {}
        for row, values in given.items():
            known = json.loads(row.env or "{}")
            new = {name: value for name, value in values.items() if name not in known}
            if len(known) + len(new) > MAX_COVARIATES:
                found = f"{len(known)} that are stored and {', '.join(new)}"
                raise BadInputError(f"env of event {row.event_id}", f"at most {MAX_COVARIATES} names", found)
            if new:
                changes.append((json.dumps(new), row.id))
            added += len(new)
            for name in known.keys() & values.keys():
                if known[name] != values[name]:
                    differing.setdefault(name, []).append(row.event_id)
        if changes:
            self._connection.exec_driver_sql(self._sql["env"], sorted(changes, key=lambda change: change[1]))
        return added, differing

    def _number_paths(self, spectra: Spectra) -> NDArray[np.int64]:
        """Row number of the path of each spectrum, shape (row,); paths not there are made."""
        keys = list(zip(spectra.station.tolist(), spectra.antenna.tolist(), spectra.dipole.tolist(), strict=True))
        wanted = sorted(set(keys))
        known = self._stored_paths(wanted)
        new = [{"station": s, "antenna": a, "dipole": d} for s, a, d in wanted if (s, a, d) not in known]
        if new:
            add_rows(self._connection, path, new)
            known = self._stored_paths(wanted)
        return np.array([known[key] for key in keys], dtype=np.int64)

    def _stored_paths(self, keys: Sequence[tuple[str, int, str]]) -> dict[tuple[str, int, str], int]:
        stations = sorted({station for station, _, _ in keys})
        columns = select(path.c.id, path.c.station, path.c.antenna, path.c.dipole)
        rows = self._connection.execute(columns.where(path.c.station.in_(stations))).all()
        return {(station, antenna, dipole): number for number, station, antenna, dipole in rows}

    def _require_same(self, spectra: Spectra, order: NDArray[np.int64], rows: Sequence[ArrivalRow]) -> None:
        """Refuse rows whose key is stored with another content."""
        sent = {row[:2]: k for k, row in enumerate(rows)}
        different: list[str] = []
        for some in _parts(rows):
            keys = [row[:2] for row in some]
            values: Any = (json.dumps(keys),) if self._is_sqlite else tuple(list(c) for c in zip(*keys, strict=True))
            for stored in self._connection.exec_driver_sql(self._sql["stored"], values):
                k = sent[(stored.path, stored.event)]
                time_us, blocks, power = rows[k][2:5]
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
                + "; what is stored stays: to correct it, flag the event (POST /v1/events/{id}/flag) and send all its "
                "spectra under another event"
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


def _count(connection: Connection, spectra: Mapping[OfStation, int], waiting: Mapping[OfStation, int]) -> None:
    """Add to the numbers of spectra that are stored and that wait, by event and station."""
    rows = [
        {"event": event, "station": station, "spectra": spectra.get(key, 0), "waiting": waiting.get(key, 0)}
        for key in sorted({*spectra, *waiting})
        for event, station in [key]
    ]
    statement = insert_into(connection, event_station)
    sums = {name: event_station.c[name] + statement.excluded[name] for name in ("spectra", "waiting")}
    if rows:
        connection.execute(statement.on_conflict_do_update(index_elements=["event", "station"], set_=sums), rows)


def _levels_of(rows: Sequence[Any]) -> Floats:
    """The levels of stored spectra, shape (row,)."""
    return measure_level(np.array([np.frombuffer(row.power, POWER) for row in rows])) if rows else np.empty(0)


FAR_LEVEL = "far_level"
"""The flag under which events are listed of which a spectrum waits."""


@dataclass(frozen=True)
class StoredEvent:
    """An air shower and what is stored of it."""

    number: int
    event_id: str
    time: Instant
    spectra: int
    stations: Sequence[str]
    waiting: int
    flag: str | None
    env: Mapping[str, float | None]


@dataclass(frozen=True)
class Window:
    """The spectra of a fit: the usable events of [since, until), of a scope; None for station means all."""

    since: Instant
    until: Instant
    scope: Scope = Scope()  # noqa: RUF009 - frozen


Content = tuple[int, int]
"""Count of usable spectra, and number of the last flag."""


class SpectraStore(Store):
    """Stored events and spectra."""

    @property
    def arrivals(self) -> Arrivals:
        """Where they come in."""
        return Arrivals(self._connection)

    def add(self, spectra: Spectra, far: Floats | None = None) -> int:
        """Store what is new and return the count of its spectra; `far` as in `Arrivals.add`."""
        return self.arrivals.add(spectra, far).spectra

    def load(
        self,
        window: Window,
        frequency_mhz: Floats,
        resistance_ohm: float,
        *,
        after: int = 0,
        with_covariates: bool = False,
    ) -> Spectra | None:
        """Everything a fit of a window uses, path by path; None where there is nothing. Fits use no covariates.

        With `after` only the events that came after that one. Rows go into arrays as they are read, one path at a time:
        what a fit needs is the arrays and little more.
        """
        paths = self._paths(window.scope)
        most, rows_of_paths = self._read_rows(window, paths, after)
        power = np.empty((most, frequency_mhz.size))
        event_at, time_us, blocks, path_at = np.empty((4, most), dtype=np.int64)
        names: dict[int, str] = {}
        end = 0
        for k, rows in rows_of_paths:
            start, end = end, end + len(rows)
            event_at[start:end], time_us[start:end], blocks[start:end], powers, ids = zip(*rows, strict=True)
            power[start:end] = np.frombuffer(b"".join(powers), POWER).reshape(len(rows), -1)
            path_at[start:end] = k
            names.update(zip(event_at[start:end].tolist(), ids, strict=True))
        if end == 0:
            return None
        path_at, event_at, time_us, blocks = (values[:end] for values in (path_at, event_at, time_us, blocks))
        numbers, event_of = np.unique(event_at, return_inverse=True)
        return Spectra(
            frequency_mhz=frequency_mhz,
            power=power[:end],
            event_id=np.array([names[number] for number in numbers.tolist()], dtype=np.str_)[event_of],
            time_unix=time_us / 1e6,
            station=np.array([one.station for one in paths], dtype=np.str_)[path_at],
            antenna=np.array([one.antenna for one in paths], dtype=np.int64)[path_at],
            dipole=np.array([one.dipole for one in paths], dtype=np.str_)[path_at],
            blocks=blocks,
            resistance_ohm=resistance_ohm,
            environment=self._covariates(event_at) if with_covariates else {},
            origin="stored spectra",
        )

    def _read_rows(
        self, window: Window, paths: Sequence[Row[Any]], after: int
    ) -> tuple[int, Iterator[tuple[int, Sequence[Any]]]]:
        """How many rows there may be, and those of each path that has any, with its place among the paths."""
        if after:  # a few events: one statement
            columns = _usable(select(spectrum.c.path, *_COLUMNS), window).where(event.c.id > after)
            rows = self._connection.execute(columns.order_by(spectrum.c.path, spectrum.c.event)).all()
            place = {one.id: k for k, one in enumerate(paths)}
            grouped = groupby(rows, key=lambda row: row.path)
            return len(rows), ((place[path_id], [row[1:] for row in of_path]) for path_id, of_path in grouped)
        of_path = _usable(select(*_COLUMNS), window).order_by(spectrum.c.event)
        found = (self._connection.execute(of_path.where(spectrum.c.path == one.id)).all() for one in paths)
        events = select(func.count()).select_from(event).where(*_of_events(_near(window), event.c.flag.is_(None)))
        most = len(paths) * int(self._connection.execute(events).scalar_one())
        return most, ((k, rows) for k, rows in enumerate(found) if rows)

    def _covariates(self, numbers: NDArray[np.int64]) -> dict[str, Floats]:
        """Covariates by name at the events of some row numbers, shape (row,); NaN where unknown."""
        found, at = np.unique(numbers, return_inverse=True)
        known: dict[str, Floats] = {}
        statement = select(event.c.id, event.c.env).where(event.c.env.is_not(None))
        for row in select_many(self._connection, statement, event.c.id, found.tolist()):
            for name, value in json.loads(row.env).items():
                values = known.setdefault(name, np.full(found.size, np.nan))
                values[np.searchsorted(found, row.id)] = np.nan if value is None else value
        return {name: values[at] for name, values in known.items()}

    def _paths(self, scope: Scope) -> Sequence[Row[Any]]:
        """The stored paths of a scope, in key order."""
        statement = select(path).where(*_of_scope(scope))
        return self._connection.execute(statement.order_by(path.c.station, path.c.antenna, path.c.dipole)).all()

    def stations(self) -> list[str]:
        """Stations with spectra, in alphabetical order."""
        return list(self._connection.execute(select(path.c.station).distinct().order_by(path.c.station)).scalars())

    def antennas(self) -> set[tuple[str, int]]:
        """Stations and antennas with spectra."""
        rows = self._connection.execute(select(path.c.station, path.c.antenna).distinct())
        return {(row.station, row.antenna) for row in rows}

    def span(self) -> tuple[Instant, Instant] | None:
        """First and last instant of any event; None without events."""
        row = self._connection.execute(select(func.min(event.c.time_us), func.max(event.c.time_us))).one()
        return None if row[0] is None else (int(row[0]), int(row[1]))

    def newest_until(self, instant: Instant) -> Instant | None:
        """The newest event not after an instant: a clock that is ahead dates some after now; None without."""
        newest: Instant | None = self._connection.execute(
            select(func.max(event.c.time_us)).where(event.c.time_us <= instant)
        ).scalar_one()
        return newest

    def newest_by_path(self) -> dict[Scope, Instant]:
        """The instant of the newest spectrum of every path that has any, in order of the paths."""
        last = select(event.c.id).order_by(event.c.time_us.desc()).limit(EVENTS_BESIDE).subquery()
        times = select(spectrum.c.path, func.max(spectrum.c.time_us).label("newest"))
        times = times.where(spectrum.c.event.in_(select(last))).group_by(spectrum.c.path)
        found = {row.path: int(row.newest) for row in self._connection.execute(times)}
        # of what was silent then, walks back to the first event that has the path
        newest = select(spectrum.c.time_us).join(event, event.c.id == spectrum.c.event)
        newest = newest.where(spectrum.c.path == path.c.id).order_by(event.c.time_us.desc()).limit(1)
        silent = select(path.c.id, newest.scalar_subquery().label("newest")).where(
            path.c.id.in_(bindparam("some", expanding=True))
        )
        paths = self._paths(Scope())
        for some in _parts([row.id for row in paths if row.id not in found]):
            found |= {row.id: int(row.newest) for row in self._connection.execute(silent, {"some": some}) if row.newest}
        return {Scope(row.station, row.antenna, row.dipole): found[row.id] for row in paths if row.id in found}

    def count(self, window: Window) -> int:
        """Count the spectra of a window whose events are not flagged."""
        return int(self._connection.execute(_unflagged(select(func.count()), window)).scalar_one())

    def has_usable(self, window: Window) -> bool:
        """Whether a fit of a window would have any spectrum."""
        return self._connection.execute(_usable(select(spectrum.c.event), window).limit(1)).first() is not None

    def covariates_by_month(self, since: Instant, until: Instant) -> dict[str, list[tuple[Instant, Floats]]]:
        """Covariates at events of [since, until) by name: first instant and values, shape (event,), of each month."""
        statement = select(event.c.time_us, event.c.env).where(event.c.env.is_not(None)).order_by(event.c.time_us)
        rows = self._connection.execute(statement.where(*_of_events(Window(since, until)))).all()
        known: dict[str, list[tuple[int, float]]] = {}
        for time_us, env in rows:
            for name, value in json.loads(env).items():
                if value is not None:
                    known.setdefault(name, []).append((time_us, value))
        found = {}
        for name, values in sorted(known.items()):
            times, numbers = (np.array(column) for column in zip(*values, strict=True))
            months = times.astype("datetime64[us]").astype("datetime64[M]")
            first, at = np.unique(months, return_index=True)
            starts = first.astype("datetime64[us]").astype(np.int64).tolist()
            found[name] = list(zip(starts, np.split(numbers, at[1:]), strict=True))
        return found

    def count_events(self) -> int:
        """Count the stored events that are not flagged."""
        usable = select(func.count()).select_from(event).where(event.c.flag.is_(None))
        return int(self._connection.execute(usable).scalar_one())

    def content(self, window: Window) -> Content:
        """The content of a window: the count of its usable spectra, and the number of the last flag set in it.

        Spectra are only ever added and flags only ever appended, so the pair is the same only if the content is.
        """
        return self._count_usable(window).total(), self.last_flag(window.since, window.until)

    def contents(self, since: Instant, until: Instant, station: str | None = None) -> dict[str, Content]:
        """`content` of one station or of all, of those that hold usable spectra, in alphabetical order."""
        flag, counts = self.last_flag(since, until), self._count_usable(Window(since, until, Scope(station)))
        return {station: (count, flag) for station, count in sorted(counts.items()) if count}

    def count_covariates(self, since: Instant, until: Instant, station: str | None = None) -> Counter[str]:
        """How many covariates are known of the usable events of a window, by station.

        They are only ever added, as spectra are: beside `content` the number is the same only if all of them are.
        """
        known = func.length(event.c.env) - func.length(func.replace(event.c.env, ":", ""))  # a colon in JSON has each
        counted = select(event_station.c.station, func.sum(known).label("known"))
        counted = counted.join(event, event.c.id == event_station.c.event).where(
            *_of_events(_near(Window(since, until)), event.c.flag.is_(None), event.c.env.is_not(None)),
            *equal(event_station, station=station),
        )
        rows = self._connection.execute(counted.group_by(event_station.c.station))
        return Counter({row.station: int(row.known) for row in rows})

    def last_flag(self, since: Instant, until: Instant) -> int:
        """The number of the last flag set or cleared in a window; 0 where none ever was."""
        flags = select(func.coalesce(func.max(event_flag.c.id), 0)).join(event, event.c.id == event_flag.c.event)
        return int(self._connection.execute(flags.where(*_of_events(Window(since, until)))).scalar_one())

    def count_flagged(self, window: Window, after: Instant | None = None) -> int:
        """Count the flagged events of a window; with `after` those that were not yet flagged then."""
        of, scope = _of_events(window, event.c.flag.is_not(None)), window.scope
        statement = select(func.count()).select_from(event).where(*of)
        if after is not None:
            then = select(func.max(event_flag.c.id)).where(event_flag.c.at_us <= after).group_by(event_flag.c.event)
            was = select(event_flag.c.event).where(event_flag.c.id.in_(then), event_flag.c.flag.is_not(None))
            statement = statement.where(event.c.id.not_in(was))
        if scope.antenna is not None:
            has = select(spectrum.c.event).join(path, path.c.id == spectrum.c.path)
            has = has.where(spectrum.c.event == event.c.id, *_of_scope(scope))
            statement = statement.where(has.exists())
        elif scope.station is not None:
            has = select(event_station.c.event).where(event_station.c.station == scope.station)
            statement = statement.where(event.c.id.in_(has))
        return int(self._connection.execute(statement).scalar_one())

    def scopes_of(self, station: str | None) -> list[Scope]:
        """All scopes of a station with spectra, or the array."""
        if station is None:
            return [Scope()]
        return [Scope(station), *(Scope(*one[1:]) for one in self._paths(Scope(station)))]

    def _count_usable(self, window: Window) -> Counter[str]:
        """How many spectra a fit of a window uses, by station, from the numbers that are kept of events."""
        counted = _usable(select(path.c.station, func.count().label("spectra")), window).group_by(path.c.station)
        inner = Window(window.since + EVENT_SPAN_US, window.until - EVENT_SPAN_US)
        if window.scope.antenna is not None or inner.since >= inner.until:
            return self._add_up(counted)
        kept = select(
            event_station.c.station, func.sum(event_station.c.spectra - event_station.c.waiting).label("spectra")
        )
        kept = kept.join(event, event.c.id == event_station.c.event).where(
            *_of_events(inner, event.c.flag.is_(None)), *equal(event_station, station=window.scope.station)
        )
        # only of an event within a minute of an end may some spectra lie beyond it
        ends = [
            counted.where(*_of_events(Window(since, since + 2 * EVENT_SPAN_US)))
            for since in (window.since - EVENT_SPAN_US, window.until - EVENT_SPAN_US)
        ]
        return self._add_up(kept.group_by(event_station.c.station), *ends)

    def _add_up(self, *statements: Select[Any]) -> Counter[str]:
        found = Counter[str]()
        for statement in statements:
            for row in self._connection.execute(statement):
                found[row.station] += int(row.spectra)
        return found

    def newest_event(self, window: Window) -> int:
        """The number of the event that came last into a window, of whatever scope; 0 where there is none."""
        newest = select(func.coalesce(func.max(event.c.id), 0))
        newest = newest.where(*_of_events(_near(window)))
        return int(self._connection.execute(newest).scalar_one())

    def stations_with(self, since: Instant, until: Instant, least: int) -> dict[str, Content]:
        """`contents` of the stations any path of which has so many usable spectra."""
        of_station = select(path.c.station, func.count().label("paths")).group_by(path.c.station)
        paths = {row.station: row.paths for row in self._connection.execute(of_station)}
        return {
            station: content
            for station, content in self.contents(since, until).items()
            # where their mean has as many one of them does, and all together have fewer where the sum has
            if content[0] >= least * paths[station]
            or (content[0] >= least and self._most_of_a_path(Window(since, until, Scope(station))) >= least)
        }

    def _most_of_a_path(self, window: Window) -> int:
        of_paths = _usable(select(func.count().label("spectra")), window).group_by(spectrum.c.path).subquery()
        return int(self._connection.execute(select(func.max(of_paths.c.spectra))).scalar_one() or 0)

    def events(
        self, cursor: int = 0, limit: int = 100, station: str | None = None, since: Instant | None = None,
        until: Instant | None = None, flag: str | None = None,
    ) -> list[StoredEvent]:  # fmt: skip
        """Stored events after a cursor in the order in which they came; of a station, a time, a flag where given.

        The cursor is the `number` of the last event of the page before; [since, until) are us UTC.
        """
        statement = select(event).where(event.c.id > cursor).order_by(event.c.id).limit(limit)
        if since is not None:
            statement = statement.where(event.c.time_us >= since)
        if until is not None:
            statement = statement.where(event.c.time_us < until)
        if flag is not None:
            is_waiting = event.c.id.in_(select(event_station.c.event).where(event_station.c.waiting > 0))
            statement = statement.where(is_waiting if flag == FAR_LEVEL else event.c.flag == flag)
        if station is not None:
            of_station = select(event_station.c.event).where(event_station.c.station == station)
            statement = statement.where(event.c.id.in_(of_station))
        return self._with_counts(self._connection.execute(statement).all())

    def event(self, event_id: str) -> StoredEvent:
        """Get one event by its name; `NotFoundError` for an unknown one."""
        found = self._with_counts(self._connection.execute(select(event).where(event.c.event_id == event_id)).all())
        return require_one(found, f"no event {event_id!r} is stored; GET /v1/events lists them")

    def _with_counts(self, rows: Sequence[Row[Any]]) -> list[StoredEvent]:
        numbers = [row.id for row in rows]
        counts: dict[int, dict[str, int]] = {}
        waiting = Counter[int]()
        for row in self._connection.execute(select(event_station).where(event_station.c.event.in_(numbers))):
            counts.setdefault(row.event, {})[row.station] = row.spectra
            waiting[row.event] += row.waiting
        return [
            StoredEvent(
                row.id, row.event_id, row.time_us, sum(counts.get(row.id, {}).values()),
                sorted(counts.get(row.id, {})), waiting[row.id], row.flag, json.loads(row.env or "{}"),
            )
            for row in rows
        ]  # fmt: skip

    def set_flag(self, event_id: str, flag: str | None, *, reason: str, by: str, at: Instant) -> None:
        """Set or clear the quality flag of an event; who did it and why is kept. None of its spectra waits longer."""
        number = self.event(event_id).number
        self._end_waiting(spectrum.c.event == number)
        self._connection.execute(update(event).where(event.c.id == number).values(flag=flag))
        entry = {"event": number, "flag": flag, "reason": reason, "by": by, "at_us": at}
        self._connection.execute(event_flag.insert().values(entry))

    def waiting(self) -> Iterator[tuple[int, list[Instant], NDArray[np.bool_]]]:
        """The paths of which enough spectra wait to last: number, times of spectra, and which wait, shape (event,).

        As many of the newest and of the oldest as can be a state with so many that wait (`find_lasting`).
        """
        counted = select(spectrum.c.path, func.count()).where(IS_FAR).group_by(spectrum.c.path)
        for number, count in self._connection.execute(counted.having(func.count() >= LASTING_EVENTS)).all():
            of_path = select(spectrum.c.time_us, spectrum.c.event, spectrum.c.far).where(spectrum.c.path == number)
            some = of_path.join(event, event.c.id == spectrum.c.event).limit(int(count / SHARE_OF_STATE))
            ends = (self._connection.execute(some.order_by(by)) for by in (event.c.time_us, event.c.time_us.desc()))
            is_far = {(time_us, name): far is not None for rows in ends for time_us, name, far in rows}
            yield number, [time_us for time_us, _ in sorted(is_far)], np.array([is_far[one] for one in sorted(is_far)])

    def waiting_beside(self) -> Iterator[tuple[int, list[Instant], Floats, Floats]]:
        """Yield the spectra that wait, and what is in fits beside them: path, times, levels of both, shape (row,).

        What waits between the same `EVENTS_BESIDE` events before and after comes together.
        """
        held = select(spectrum, event.c.time_us.label("at")).join(event).where(IS_FAR)
        rows = self._connection.execute(held.order_by(spectrum.c.path, event.c.time_us)).all()
        for number, of_path in groupby(rows, key=lambda row: row.path):
            rest = list(of_path)
            while rest:
                took_part = select(spectrum.c.power, event.c.time_us).join(event).limit(EVENTS_BESIDE)
                took_part = took_part.where(spectrum.c.path == number, spectrum.c.far.is_(None), event.c.flag.is_(None))
                before = took_part.where(event.c.time_us <= rest[0].at).order_by(event.c.time_us.desc())
                after = took_part.where(event.c.time_us > rest[0].at).order_by(event.c.time_us)
                earlier, later = (self._connection.execute(one).all() for one in (before, after))
                here = [row for row in rest if not later or row.at < later[0].time_us]
                yield number, [row.time_us for row in here], _levels_of(here), _levels_of([*earlier, *later])
                rest = rest[len(here) :]

    def end_waiting(self, number: int, times: Sequence[Instant]) -> None:
        """Spectra of a path take part in fits from now on."""
        for some in _parts(times):
            self._end_waiting(spectrum.c.path == number, spectrum.c.time_us.in_(some))

    def _end_waiting(self, *which: ColumnElement[bool]) -> None:
        ended = update(spectrum).where(IS_FAR, *which).values(far=None).returning(spectrum.c.path, spectrum.c.event)
        rows = self._connection.execute(ended).all()
        if rows:
            of_paths = select(path.c.id, path.c.station).where(path.c.id.in_({row.path for row in rows}))
            station_of = {row.id: row.station for row in self._connection.execute(of_paths)}
            _count(
                self._connection,
                {},
                {key: -n for key, n in Counter((r.event, station_of[r.path]) for r in rows).items()},
            )


def _usable(statement: Select[Any], window: Window) -> Select[Any]:
    """Restrict a statement to the spectra that a fit of a window uses."""
    return _unflagged(statement, window).where(spectrum.c.far.is_(None))


def _unflagged(statement: Select[Any], window: Window) -> Select[Any]:
    """Restrict a statement to the spectra of a window whose events, by whose times they are found, are not flagged."""
    statement = statement.select_from(spectrum).join(path, path.c.id == spectrum.c.path)
    return statement.join(event, event.c.id == spectrum.c.event).where(
        *_of_scope(window.scope), *_of_events(_near(window), event.c.flag.is_(None)),
        spectrum.c.time_us >= window.since, spectrum.c.time_us < window.until,
    )  # fmt: skip


def _near(window: Window) -> Window:
    """Where the events of its spectra lie."""
    return Window(window.since - EVENT_SPAN_US, window.until + EVENT_SPAN_US)


def _of_events(window: Window, *more: ColumnElement[bool]) -> tuple[ColumnElement[bool], ...]:
    """What holds for events of a window."""
    return (event.c.time_us >= window.since, event.c.time_us < window.until, *more)


def _of_scope(scope: Scope) -> list[ColumnElement[bool]]:
    dipole = None if scope.antenna is None else scope.dipole
    return equal(path, station=scope.station, antenna=scope.antenna, dipole=dipole)


_COLUMNS = spectrum.c.event, spectrum.c.time_us, spectrum.c.blocks, spectrum.c.power, event.c.event_id
