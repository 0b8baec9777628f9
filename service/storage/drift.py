"""Drift: caches of what follows from the events of every path (`sums`), replaced whole, station by station.

Monthly ratios are for the eye, and what the months of a year say together is kept with them; the report is what was
found in the events last.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import delete, select, text

from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.grids import Floats
from lbacal_core.provenance import canonical_json, hash_arrays, hash_content
from service.schema.tables import drift_report, drift_year
from service.storage.rows import Store, equal, put_rows, to_row

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
        """The hash of these months."""
        return hash_content([[path.key for path in self.paths], hash_arrays(self.months, self.ratios)])


@dataclass(frozen=True)
class StoredYear:
    """The drift of all paths of a station in a year, as JSON, and the months of its paths.

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
        """Drift of years, in order of station and year, without the months of paths; the empty string is the array."""
        columns = [drift_year.c[name] for name in ("station", "since_us", "digest", "months", "matrix")]
        statement = select(*columns).where(drift_year.c.station.in_(stations))
        ordered = statement.order_by(drift_year.c.station, drift_year.c.since_us)
        return [StoredYear(*row) for row in self._connection.execute(ordered)]

    def months_of_paths(self, station: str | None, since: Instant | None = None) -> list[PathMonths]:
        """The months of the paths of a station or of all, of all years or of one, in order of station and year."""
        columns = drift_year.c.station, drift_year.c.paths, drift_year.c.ratios
        asked = drift_year.c.station != "", *equal(drift_year, station=station, since_us=since)
        statement = select(*columns).where(*asked).order_by(drift_year.c.station, drift_year.c.since_us)
        found = []
        for row in self._connection.execute(statement):
            named, months = json.loads(row.paths)
            ratios = np.frombuffer(row.ratios, "<f8").reshape(len(named), len(months), len(NUMBERS))
            paths = [Scope(row.station, antenna, dipole) for antenna, dipole in named]
            found.append(PathMonths(paths, np.array(months, dtype=np.int64), ratios))
        return found

    def state(self) -> list[list[Any]]:
        """The stored content by name: the report, and the months of every year that is kept."""
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
        """The inputs of the stored report, and its date; None where there is none."""
        row = self._connection.execute(select(drift_report.c.inputs, drift_report.c.made_us)).one_or_none()
        return None if row is None else (row.inputs, row.made_us)

    def report(self) -> dict[str, Any] | None:
        """Get the latest report, as `lbacal_core.drift.report` describes it; None before the first."""
        found = self._connection.execute(select(drift_report.c.report)).scalar_one_or_none()
        return None if found is None else dict(json.loads(found))
