"""Spectra in: checked against the instrument, stored once, listed, flagged."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lbacal_core.errors import BadInputError
from lbacal_core.grids import require_same_grid
from lbacal_core.instrument import AntennaRecord, Instrument
from lbacal_core.spectra import Spectra
from lbacal_core.validity import Instant
from service.errors import ConflictError
from service.storage.database import Database
from service.storage.spectra import StoredEvent
from service.wire.bodies import SpectraBody, SpectrumBody
from service.wire.instants import parse_instant


@dataclass(frozen=True)
class Receipt:
    """What became of a batch."""

    received: int
    stored: int

    @property
    def duplicates(self) -> int:
        """Spectra that were there already, with the same content."""
        return self.received - self.stored


@dataclass(frozen=True)
class Intake:
    """Takes spectra of one instrument."""

    database: Database
    instrument: Instrument
    resistance_ohm: float
    clock: Callable[[], Instant]

    @cached_property
    def _records(self) -> dict[tuple[str, int], list[AntennaRecord]]:
        records: dict[tuple[str, int], list[AntennaRecord]] = {}
        for record in self.instrument.antennas:
            records.setdefault((record.station, record.antenna), []).append(record)
        return records

    def store(self, body: SpectraBody) -> Receipt:
        """Store a batch whole or not at all."""
        rows, times = _without_repeats(body.spectra)
        require_same_grid(
            "body", np.array(body.frequency_mhz, dtype=float), self.instrument.frequency_mhz,
            f"instrument {self.instrument.name}",
        )  # fmt: skip
        if body.resistance_ohm not in (None, self.resistance_ohm):
            raise BadInputError(
                "body.resistance_ohm", f"{self.resistance_ohm:g} as set here", f"{body.resistance_ohm:g}"
            )
        for k, (row, time) in enumerate(zip(rows, times, strict=True)):
            self._require_known(k, row, time)
            if len(row.power) != self.instrument.frequency_mhz.size:
                channels = f"{self.instrument.frequency_mhz.size} channels"
                raise BadInputError(f"body.spectra[{k}].power", channels, str(len(row.power)))
        spectra = self._as_spectra(rows, times)
        spectra.require_past(self.clock() / 1e6)
        with self.database.write() as stores:
            return Receipt(len(body.spectra), stores.spectra.add(spectra))

    def _require_known(self, k: int, row: SpectrumBody, time: Instant) -> None:
        records = self._records.get((row.station, row.antenna))
        if records is None:
            stations = sorted({station for station, _ in self._records})
            if row.station not in stations:
                raise BadInputError(f"body.spectra[{k}].station", f"one of {', '.join(stations)}", repr(row.station))
            raise BadInputError(f"body.spectra[{k}].antenna", f"an antenna of {row.station}", str(row.antenna))
        if not any(record.covers(time / 1e6) for record in records):
            expected = f"a time at which {row.station} antenna {row.antenna} is on record"
            raise BadInputError(f"body.spectra[{k}].time_utc", expected, row.time_utc)

    def _as_spectra(self, rows: Sequence[SpectrumBody], times: Sequence[Instant]) -> Spectra:
        names = sorted({name for row in rows for name in row.env or {}})
        env = [row.env or {} for row in rows]
        return Spectra(
            frequency_mhz=self.instrument.frequency_mhz,
            power=np.array([row.power for row in rows], dtype=float),
            event_id=np.array([row.event_id for row in rows], dtype=np.str_),
            time_unix=np.array(times, dtype=np.int64) / 1e6,
            station=np.array([row.station for row in rows], dtype=np.str_),
            antenna=np.array([row.antenna for row in rows], dtype=np.int64),
            dipole=np.array([row.dipole for row in rows], dtype=np.str_),
            blocks=np.array([row.blocks for row in rows], dtype=np.int64),
            resistance_ohm=self.resistance_ohm,
            environment={n: np.array([np.nan if e.get(n) is None else e[n] for e in env], dtype=float) for n in names},
            origin="body.spectra",
        )

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
        """What is stored, in order of arrival."""
        with self.database.read() as stores:
            return stores.spectra.events(
                station=station, since=since, until=until, flag=flag, cursor=cursor, limit=limit
            )

    def set_flag(self, event_id: str, flag: str | None, *, reason: str, by: str) -> StoredEvent:
        """Set or clear a quality flag; a flagged event is left out of fits."""
        with self.database.write() as stores:
            stores.spectra.set_flag(event_id, flag, reason=reason, by=by, at=self.clock())
            return stores.spectra.event(event_id)


def _without_repeats(spectra: Sequence[SpectrumBody]) -> tuple[list[SpectrumBody], list[Instant]]:
    """Drop spectra that a batch holds twice with the same content; the same key with another content is a conflict."""
    kept: dict[tuple[str, str, int, str], tuple[SpectrumBody, Instant]] = {}
    for k, row in enumerate(spectra):
        time = parse_instant(f"body.spectra[{k}].time_utc", row.time_utc)
        key = (row.event_id, row.station, row.antenna, row.dipole)
        if key not in kept:
            kept[key] = (row, time)
        elif (kept[key][1], kept[key][0].blocks, kept[key][0].power) != (time, row.blocks, row.power):
            raise ConflictError(
                f"body.spectra[{k}]: the batch holds another spectrum of {row.event_id}, {row.station} "
                f"antenna {row.antenna} {row.dipole}"
            )
    return [row for row, _ in kept.values()], [time for _, time in kept.values()]
