"""Drift: caches of what follows from the events of every path (`sums`), replaced whole, station by station.

Monthly ratios are for the eye, and what the months of a year say together is kept with them; the report is what was
found in the events last.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Select, delete, func, select, text, update

from lbacal.instants import DAY_US
from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.grids import Floats
from lbacal_core.provenance import canonical_json, hash_arrays, hash_content
from service.errors import NotFoundError
from service.schema.tables import cut_decision, drift_report, drift_year, window_cut
from service.storage.rows import Store, from_row, put_rows, to_row

LOCK = 5_240_123
"""Names the one lock under which months are written on PostgreSQL."""
NUMBERS = ("c_ratio", "c_ratio_sigma", "tilt", "curvature", "events")
"""What is known of a path's month: C over that of the reference version, tilt and curvature of ln C, and its events."""


@dataclass(frozen=True)
class PathMonths:
    """The months of paths: `NUMBERS` in shape (path, month, number), NaN where a month has too few events."""

    paths: Sequence[Scope]
    months: NDArray[np.int64]
    ratios: Floats

    @property
    def digest(self) -> str:
        """The hash of all of it."""
        return hash_content([[path.key for path in self.paths], hash_arrays(self.months, self.ratios)])


@dataclass(frozen=True)
class StoredYear:
    """What the months of a year of a station say together, as JSON, and the months of its paths.

    `digest` names what it says. The station of the array is the empty string. `matrix` holds every path beside the
    station's median; the array has neither it nor paths.
    """

    station: str
    since: Instant
    digest: str
    months: str
    matrix: str | None = None
    of_paths: PathMonths | None = None


class DriftStore(Store):
    """Months by station and year, and what was found in the events."""

    def lock(self) -> None:
        """Wait until nobody else writes months; held until the transaction ends, which on SQLite is alone anyway."""
        if self._connection.dialect.name == "postgresql":
            self._connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": LOCK})

    def keep_year(self, year: StoredYear) -> None:
        """Keep what the months of a year say in place of what was kept."""
        own, more = year.of_paths, dict[str, Any]()
        if own is not None:
            named = [[path.antenna, path.dipole] for path in own.paths], own.months.tolist()
            more = {"paths": canonical_json(named), "ratios": own.ratios.astype("<f8").tobytes()}
        put_rows(self._connection, drift_year, [to_row(year, drift_year, **more)])

    def years(self, stations: Collection[str]) -> list[StoredYear]:
        """What years say, in order of station and year, without the months of paths; the empty string is the array."""
        columns = [drift_year.c[name] for name in ("station", "since_us", "digest", "months", "matrix")]
        statement = select(*columns).where(drift_year.c.station.in_(stations))
        ordered = statement.order_by(drift_year.c.station, drift_year.c.since_us)
        return [StoredYear(*row) for row in self._connection.execute(ordered)]

    def months_of_paths(self, station: str | None, since: Instant | None = None) -> list[PathMonths]:
        """The months of the paths of a station or of all, of all years or of one, in order of station and year."""
        columns = drift_year.c.station, drift_year.c.paths, drift_year.c.ratios
        statement = select(*columns).where(drift_year.c.station != "")
        statement = statement.order_by(drift_year.c.station, drift_year.c.since_us)
        if station is not None:
            statement = statement.where(drift_year.c.station == station)
        if since is not None:
            statement = statement.where(drift_year.c.since_us == since)
        found = []
        for row in self._connection.execute(statement):
            named, months = json.loads(row.paths)
            ratios = np.frombuffer(row.ratios, "<f8").reshape(len(named), len(months), len(NUMBERS))
            paths = [Scope(row.station, antenna, dipole) for antenna, dipole in named]
            found.append(PathMonths(paths, np.array(months, dtype=np.int64), ratios))
        return found

    def state(self) -> list[list[Any]]:
        """What there is, by name: the report, and the months of every year that is kept."""
        years = select(drift_year.c.station, drift_year.c.since_us, drift_year.c.digest)
        ordered = years.order_by(drift_year.c.station, drift_year.c.since_us)
        reports = self._connection.execute(select(drift_report.c.inputs, drift_report.c.made_us)).all()
        return [list(row) for row in (*reports, *self._connection.execute(ordered))]

    def keep_report(self, inputs: str, report: Mapping[str, Any], now: Instant) -> None:
        """Keep what was found in place of what was found before."""
        self._connection.execute(delete(drift_report))
        row = {"inputs": inputs, "report": canonical_json(report), "made_us": now}
        self._connection.execute(drift_report.insert().values(row))

    def report_made(self) -> tuple[str, Instant] | None:
        """What the report that is kept was made from, and when; None where there is none."""
        row = self._connection.execute(select(drift_report.c.inputs, drift_report.c.made_us)).one_or_none()
        return None if row is None else (row.inputs, row.made_us)

    def report(self) -> dict[str, Any] | None:
        """What was found last."""
        found = self._connection.execute(select(drift_report.c.report)).scalar_one_or_none()
        return None if found is None else dict(json.loads(found))


# Dates at which windows of antennas are cut, because the watch found that these changed then, and what people decided.
#
# A cut stands from the night on which its change is found until it is found no more, unless a person lifted it. Nothing
# is deleted: a cut that ended and every decision stay on record.

LIFTED, RESTORED = "lifted", "restored"


@dataclass(frozen=True)
class Cut:
    """A date, with its standard deviation in microseconds, at which the windows of both dipoles are cut."""

    station: str
    antenna: int
    date: Instant
    sigma: int

    @property
    def sigma_days(self) -> float:
        """The standard deviation of the date, days."""
        return self.sigma / DAY_US


@dataclass(frozen=True)
class Decision:
    """What a person decided about a cut: to lift it, or to restore it."""

    act: str
    at: Instant
    by: str
    reason: str


@dataclass(frozen=True)
class KeptCut:
    """A cut on record; `ended` is when the watch no longer found its change, `decision` the last one about it.

    `is_refitted`: no version in effect answers on both sides of it.
    """

    number: int
    cut: Cut
    made: Instant
    ended: Instant | None
    decision: Decision | None = None
    is_refitted: bool = True

    @property
    def stands(self) -> bool:
        """Whether windows are cut there."""
        return self.ended is None and (self.decision is None or self.decision.act == RESTORED)


class CutStore(Store):
    """Cuts that stand and stood."""

    def standing(
        self, station: str | None = None, since: Instant | None = None, until: Instant | None = None
    ) -> list[Cut]:
        """The cuts that stand, of all stations or of one, inside a window, in order of antenna and date."""
        return [one.cut for one in self.kept(station, since, until) if one.stands]

    def found(self) -> list[Cut]:
        """The cuts whose change the watch still finds, those among them that a person lifted."""
        return [one.cut for one in self.kept() if one.ended is None]

    def kept(
        self, station: str | None = None, since: Instant | None = None, until: Instant | None = None
    ) -> list[KeptCut]:
        """All cuts on record, with the last decision about each, in order of antenna and date."""
        order = window_cut.c.station, window_cut.c.antenna, window_cut.c.date_us, window_cut.c.id
        return self._read(_inside(select(window_cut).order_by(*order), station, since, until))

    def known(self, as_of: Instant | None) -> list[Cut]:
        """The cuts that stood at an instant; those that stand where it is None."""
        if as_of is None:
            return self.standing()
        stood = window_cut.c.lifted_us.is_(None) | (window_cut.c.lifted_us > as_of)
        found = self._read(select(window_cut).where(window_cut.c.made_us <= as_of, stood), as_of)
        return [one.cut for one in found if replace(one, ended=None).stands]

    def get(self, number: int) -> KeptCut:
        """One of them."""
        found = self._read(select(window_cut).where(window_cut.c.id == number))
        if not found:
            raise NotFoundError(f"no cut {number}; GET /v1/cuts lists them")
        return found[0]

    def last_change(self, station: str | None, since: Instant, until: Instant) -> list[int]:
        """How often cuts of a window ended, and the number of the last decision about one: nothing where neither was.

        A cut that was lifted leaves the windows that there were before it: the pair says that these are due again.
        """
        ended = select(func.count()).select_from(window_cut).where(window_cut.c.lifted_us.is_not(None))
        decided = select(func.coalesce(func.max(cut_decision.c.id), 0)).join(window_cut)
        pair = [
            int(self._connection.execute(_inside(one, station, since, until)).scalar_one()) for one in (ended, decided)
        ]
        return pair if any(pair) else []

    def add(self, cuts: Collection[Cut], now: Instant) -> None:
        """Write new cuts."""
        if cuts:
            self._connection.execute(window_cut.insert(), [to_row(one, window_cut, made_us=now) for one in cuts])

    def end(self, cut: Cut, now: Instant) -> None:
        """End a cut, whose change is found no more."""
        is_it = (window_cut.c.station == cut.station) & (window_cut.c.antenna == cut.antenna)
        is_it &= (window_cut.c.date_us == cut.date) & window_cut.c.lifted_us.is_(None)
        self._connection.execute(update(window_cut).where(is_it).values(lifted_us=now))

    def decide(self, number: int, decision: Decision) -> KeptCut:
        """Write a decision about a cut."""
        self._connection.execute(cut_decision.insert().values(to_row(decision, cut_decision, cut=number)))
        return self.get(number)

    def _read(self, statement: Select[Any], as_of: Instant | None = None) -> list[KeptCut]:
        rows = self._connection.execute(statement).all()
        if not rows:
            return []
        last = select(func.max(cut_decision.c.id)).where(cut_decision.c.cut.in_([row.id for row in rows]))
        if as_of is not None:
            last = last.where(cut_decision.c.at_us <= as_of)
        newest = select(cut_decision).where(cut_decision.c.id.in_(last.group_by(cut_decision.c.cut)))
        decisions = {row.cut: from_row(Decision, row) for row in self._connection.execute(newest)}
        return [KeptCut(row.id, from_row(Cut, row), row.made_us, row.lifted_us, decisions.get(row.id)) for row in rows]


def _inside(statement: Select[Any], station: str | None, since: Instant | None, until: Instant | None) -> Select[Any]:
    """The same for the cuts of a station inside a window."""
    if station is not None:
        statement = statement.where(window_cut.c.station == station)
    if since is not None:
        statement = statement.where(window_cut.c.date_us > since)
    if until is not None:
        statement = statement.where(window_cut.c.date_us < until)
    return statement
