"""Drift: caches of what follows from the stored spectra, replaced whole, station by station.

Monthly ratios are for the eye, and what the months of a year say together is kept with them; the events of every path
are what steps and slopes are found in; the report is what was found last.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection, Row, Select, delete, func, select, update

from lbacal.instants import DAY_US
from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.provenance import canonical_json
from service.errors import NotFoundError
from service.schema.tables import (
    cut_decision,
    drift_report,
    drift_source,
    drift_year,
    event_modes,
    monthly_ratio,
    path,
    window_cut,
)

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


class CutStore:
    """Cuts that stand and stood."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

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
        rows = [
            {
                "station": one.station, "antenna": one.antenna, "date_us": one.date, "sigma_us": one.sigma,
                "made_us": now,
            }
            for one in cuts
        ]  # fmt: skip
        if rows:
            self._connection.execute(window_cut.insert(), rows)

    def end(self, cut: Cut, now: Instant) -> None:
        """End a cut, whose change is found no more."""
        is_it = (window_cut.c.station == cut.station) & (window_cut.c.antenna == cut.antenna)
        is_it &= (window_cut.c.date_us == cut.date) & window_cut.c.lifted_us.is_(None)
        self._connection.execute(update(window_cut).where(is_it).values(lifted_us=now))

    def decide(self, number: int, decision: Decision) -> KeptCut:
        """Write a decision about a cut."""
        row = {
            "cut": number, "act": decision.act, "at_us": decision.at, "by": decision.by, "reason": decision.reason,
        }  # fmt: skip
        self._connection.execute(cut_decision.insert().values(row))
        return self.get(number)

    def _read(self, statement: Select[Any], as_of: Instant | None = None) -> list[KeptCut]:
        rows = self._connection.execute(statement).all()
        if not rows:
            return []
        last = select(func.max(cut_decision.c.id)).where(cut_decision.c.cut.in_([row.id for row in rows]))
        if as_of is not None:
            last = last.where(cut_decision.c.at_us <= as_of)
        newest = select(cut_decision).where(cut_decision.c.id.in_(last.group_by(cut_decision.c.cut)))
        decisions = {
            row.cut: Decision(row.act, row.at_us, row.by, row.reason) for row in self._connection.execute(newest)
        }
        return [replace(_kept(row), decision=decisions.get(row.id)) for row in rows]


def _kept(row: Row[Any]) -> KeptCut:
    return KeptCut(row.id, Cut(row.station, row.antenna, row.date_us, row.sigma_us), row.made_us, row.lifted_us)


def _inside(statement: Select[Any], station: str | None, since: Instant | None, until: Instant | None) -> Select[Any]:
    """The same for the cuts of a station inside a window."""
    if station is not None:
        statement = statement.where(window_cut.c.station == station)
    if since is not None:
        statement = statement.where(window_cut.c.date_us > since)
    if until is not None:
        statement = statement.where(window_cut.c.date_us < until)
    return statement
