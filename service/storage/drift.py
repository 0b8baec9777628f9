"""Drift: caches of what follows from the stored spectra, replaced whole, station by station.

Monthly ratios are for the eye, and what the months of a year say together is kept with them; the events of every path
are what steps and slopes are found in; the report is what was found last.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, delete, select

from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.provenance import canonical_json
from service.schema.drift import drift_report, drift_source, drift_year, event_modes, monthly_ratio
from service.schema.tables import path

SINGLE = "<f4"
MODES = 3


@dataclass(frozen=True)
class MonthlyRatio:
    """C of a path in a month over that of the reference version, and the tilt and curvature of ln C along frequency."""

    path: Scope
    month: Instant
    reference: str
    c_ratio: float
    c_ratio_sigma: float
    events: int
    shape: tuple[float, float] | None = None
    shape_sigma: tuple[float, float] | None = None


@dataclass(frozen=True)
class StoredModes:
    """ln(C / C_reference) of one polarisation of a station in the events of a year, shape (antenna, event, mode)."""

    station: str
    dipole: str
    since: Instant
    antennas: tuple[int, ...]
    time_us: NDArray[np.int64]
    ln_c: NDArray[np.float32]


@dataclass(frozen=True)
class DriftSource:
    """What the events of a station's year were measured from.

    Attributes
    ----------
    inputs
        Hash of all inputs but the spectra.
    spectra, flag, event
        The count of usable spectra, the last flag that was set in the year and the newest event.
    screened
        The count of usable spectra when the whole year was read last.
    """

    inputs: str
    spectra: int
    flag: int
    event: int
    screened: int


@dataclass(frozen=True)
class StoredYear:
    """What the months of a year of a station say together, as JSON; None where that is still to be computed.

    `inputs` names the months that it was made from: for the array, whose station is the empty string, those of all
    stations. `matrix` holds every path beside the station's median; the array has none.
    """

    station: str
    since: Instant
    inputs: str
    months: str | None
    matrix: str | None = None


class DriftStore:
    """Months and events by path, and what was found in them."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def replace(
        self,
        station: str,
        since: Instant,
        until: Instant,
        ratios: Sequence[MonthlyRatio],
        modes: Sequence[StoredModes] = (),
    ) -> None:
        """Put what was measured in a station's year [since, until) in place of the old.

        What its months say together is then to be kept anew (`keep_year`), in the same transaction.
        """
        rows = self._connection.execute(select(path).where(path.c.station == station))
        numbers = {Scope(row.station, row.antenna, row.dipole): row.id for row in rows}
        is_old = monthly_ratio.c.path.in_(numbers.values())
        is_in_window = (monthly_ratio.c.month_us >= since) & (monthly_ratio.c.month_us < until)
        self._connection.execute(delete(monthly_ratio).where(is_old & is_in_window))
        new = [
            {
                "path": numbers[ratio.path], "month_us": ratio.month, "reference": ratio.reference,
                "c_ratio": ratio.c_ratio, "c_ratio_sigma": ratio.c_ratio_sigma, "events": ratio.events,
                **_shape(ratio),
            }
            for ratio in ratios
        ]  # fmt: skip
        if new:
            self._connection.execute(monthly_ratio.insert(), new)
        is_of = event_modes.c.station == station
        is_within = (event_modes.c.since_us >= since) & (event_modes.c.since_us < until)
        self._connection.execute(delete(event_modes).where(is_of & is_within))
        blobs = [
            {
                "station": one.station, "dipole": one.dipole, "since_us": one.since,
                "antennas": json.dumps(one.antennas),
                "time_us": (times := one.time_us.astype("<i8").tobytes()),
                "ln_c": (content := one.ln_c.astype(SINGLE).tobytes()),
                "sha256": hashlib.sha256(times + content).hexdigest(),
            }
            for one in modes
        ]  # fmt: skip
        if blobs:
            self._connection.execute(event_modes.insert(), blobs)

    def keep_year(self, year: StoredYear) -> None:
        """Keep what the months of a year say together in place of what was kept."""
        is_same = (drift_year.c.station == year.station) & (drift_year.c.since_us == year.since)
        self._connection.execute(delete(drift_year).where(is_same))
        row = {
            "station": year.station, "since_us": year.since, "inputs": year.inputs,
            "months": year.months, "matrix": year.matrix,
        }  # fmt: skip
        self._connection.execute(drift_year.insert(), row)

    def years(self, stations: Collection[str], *, with_matrix: bool = False) -> list[StoredYear]:
        """What is kept of stations, in order of station and year; the empty string is the array."""
        columns = [drift_year.c.station, drift_year.c.since_us, drift_year.c.inputs, drift_year.c.months]
        columns += [drift_year.c.matrix] * with_matrix
        statement = select(*columns).where(drift_year.c.station.in_(stations))
        ordered = statement.order_by(drift_year.c.station, drift_year.c.since_us)
        return [StoredYear(*row) for row in self._connection.execute(ordered)]

    def state(self) -> list[list[Any]]:
        """What there is, by name: the report, and the months of every year that is kept."""
        years = select(drift_year.c.station, drift_year.c.since_us, drift_year.c.inputs)
        ordered = years.order_by(drift_year.c.station, drift_year.c.since_us)
        reports = self._connection.execute(select(drift_report.c.inputs, drift_report.c.made_us)).all()
        return [list(row) for row in (*reports, *self._connection.execute(ordered))]

    def inputs_of_years(self) -> dict[Instant, dict[str, str]]:
        """The hashes of the months of all stations, by year and station."""
        columns = drift_year.c.since_us, drift_year.c.station, drift_year.c.inputs
        found: dict[Instant, dict[str, str]] = {}
        for since, station, inputs in self._connection.execute(select(*columns).where(drift_year.c.station != "")):
            found.setdefault(since, {})[station] = inputs
        return found

    def ratios(self, scope: Scope, since: Instant | None = None, until: Instant | None = None) -> list[MonthlyRatio]:
        """The months of the paths of a scope, all or those of [since, until), in order of path and month."""
        statement = select(monthly_ratio, path.c.station, path.c.antenna, path.c.dipole)
        statement = statement.join(path, path.c.id == monthly_ratio.c.path)
        if scope.station is not None:
            statement = statement.where(path.c.station == scope.station)
        if scope.antenna is not None:
            statement = statement.where(path.c.antenna == scope.antenna, path.c.dipole == scope.dipole)
        if since is not None:
            statement = statement.where(monthly_ratio.c.month_us >= since)
        if until is not None:
            statement = statement.where(monthly_ratio.c.month_us < until)
        statement = statement.order_by(path.c.station, path.c.antenna, path.c.dipole, monthly_ratio.c.month_us)
        return [
            MonthlyRatio(
                Scope(row.station, row.antenna, row.dipole), row.month_us, row.reference,
                row.c_ratio, row.c_ratio_sigma, row.events,
                None if row.tilt is None else (row.tilt, row.curvature),
                None if row.tilt is None else (row.tilt_sigma, row.curvature_sigma),
            )
            for row in self._connection.execute(statement)
        ]  # fmt: skip

    def digests(self) -> list[str]:
        """Hashes of all stored events, in order of station, polarisation and year."""
        columns = event_modes.c.station, event_modes.c.dipole, event_modes.c.since_us
        return list(self._connection.execute(select(event_modes.c.sha256).order_by(*columns)).scalars())

    def source(self, station: str, since: Instant) -> DriftSource | None:
        """What a station's year was measured from; None where it was not."""
        columns = [drift_source.c[name] for name in DriftSource.__dataclass_fields__]
        is_it = (drift_source.c.station == station) & (drift_source.c.since_us == since)
        row = self._connection.execute(select(*columns).where(is_it)).one_or_none()
        return None if row is None else DriftSource(*row)

    def keep_source(self, station: str, since: Instant, source: DriftSource) -> None:
        """Keep what a station's year was measured from in place of what was kept."""
        is_it = (drift_source.c.station == station) & (drift_source.c.since_us == since)
        self._connection.execute(delete(drift_source).where(is_it))
        self._connection.execute(drift_source.insert(), {"station": station, "since_us": since, **vars(source)})

    def modes(self, station: str | None = None, since: Instant | None = None) -> list[StoredModes]:
        """Everything that steps and slopes are found in, of all or of one station's year."""
        columns = event_modes.c.station, event_modes.c.dipole, event_modes.c.since_us
        statement, found = select(event_modes).order_by(*columns), []
        if station is not None:
            statement = statement.where(event_modes.c.station == station, event_modes.c.since_us == since)
        for row in self._connection.execute(statement):
            antennas = tuple(json.loads(row.antennas))
            times = np.frombuffer(row.time_us, "<i8").astype(np.int64)
            ln_c = np.frombuffer(row.ln_c, SINGLE).astype(np.float32).reshape(len(antennas), times.size, MODES)
            found.append(StoredModes(row.station, row.dipole, row.since_us, antennas, times, ln_c))
        return found

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
        text = self._connection.execute(select(drift_report.c.report)).scalar_one_or_none()
        return None if text is None else dict(json.loads(text))


def _shape(ratio: MonthlyRatio) -> dict[str, float | None]:
    value, sigma = ratio.shape or (None, None), ratio.shape_sigma or (None, None)
    return {"tilt": value[0], "curvature": value[1], "tilt_sigma": sigma[0], "curvature_sigma": sigma[1]}
