"""Spectra in: checked against the instrument, stored once, listed, flagged."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from statistics import median

import numpy as np

from lbacal.instants import SECOND_US, format_instant, parse_instant
from lbacal_core.curves.validity import Instant
from lbacal_core.errors import BadInputError, name_path, require_antenna, require_name, write_count
from lbacal_core.grids import Floats, require_same_grid
from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.spectra.screening import FAR, find_lasting, measure_level
from lbacal_core.spectra.spectra import Spectra, lay_out_rows
from service.errors import ConflictError
from service.storage.database import Database, Stores
from service.storage.spectra import EVENT_SPAN_US, StoredEvent
from service.wire.bodies import LONGEST_NAME, MAX_SPECTRA, SpectraBody, SpectrumBody, parse_body
from service.wire.hdf5_body import FileReader

POWERS = 1e-100, 1e100
"""What a measurement can be, in whatever unit: fits compute with squares."""
MAX_NAMES_IN_BATCH = 64
"""Names of covariates in one batch: each is a column of it in memory."""
PATHS_NAMED = 20
"""An answer warns of so many paths one by one."""
EVENTS_NAMED = 5
FEWEST_BESIDE = 3
"""So many stored spectra of a path say what is usual; one may be an exception."""
Place = Callable[[str, int], str]
_FIELDS = {"time_unix": "time_utc"}
"""Columns that JSON calls otherwise."""


def name_row(column: str, row: int) -> str:
    """Where a column's row stands in a spectra file."""
    return f"body: {column}, row {row}"


@dataclass(frozen=True)
class Receipt:
    """The result of storing a batch; `warnings` say which spectra wait for the daily run, and which covariates differ.

    `covariates` counts those that became known of events that were there.
    """

    received: int
    stored: int
    warnings: Sequence[str] = ()
    covariates: int = 0

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
    files: FileReader

    @cached_property
    def _records(self) -> dict[tuple[str, int], list[AntennaRecord]]:
        records: dict[tuple[str, int], list[AntennaRecord]] = {}
        for record in self.instrument.antennas:
            records.setdefault((record.station, record.antenna), []).append(record)
        return records

    @cached_property
    def _always(self) -> set[tuple[str, int]]:
        """Antennas whose record has no beginning and no end."""
        return {
            key
            for key, records in self._records.items()
            if any(record.since is None and record.until is None for record in records)
        }

    def receive(self, content: bytes, *, is_file: bool) -> Receipt:
        """Store a body, a spectra file or JSON, whole or not at all; one that was stored before is not even read."""
        digest = hashlib.sha256(content).hexdigest()
        known = self.database.ask(lambda stores: stores.spectra.arrivals.find_receipts([digest]))
        if digest in known:
            received, warnings = known[digest]
            return Receipt(received, 0, warnings)
        if is_file:
            return self.store(self.files.read(content), digest=digest)
        return self._store_json(parse_body(SpectraBody, content), digest)

    def _store_json(self, body: SpectraBody, digest: str) -> Receipt:
        self._require_channels("body", np.array(body.frequency_mhz, dtype=float))
        times = _read_times(body.spectra)
        rows = _without_repeats(body.spectra, times)
        spectra = _as_spectra(body, rows, times, self.resistance_ohm)

        def name_field(column: str, k: int) -> str:
            return f"body.spectra[{rows[k]}].{_FIELDS.get(column, column)}"

        return self.store(spectra, len(body.spectra), name_field, digest)

    def store(
        self, spectra: Spectra, received: int | None = None, name_place: Place = name_row, digest: str | None = None
    ) -> Receipt:
        """Store spectra whole or not at all.

        Parameters
        ----------
        received
            How many were sent, where some of them were sent twice.
        name_place
            Gives the place of a column's row in the request.
        digest
            SHA-256 of the body that held them.
        """
        received = received or len(spectra)
        if len(spectra) > MAX_SPECTRA:
            raise BadInputError(spectra.origin, f"at most {MAX_SPECTRA} spectra", str(len(spectra)))
        self._require_channels(spectra.origin, spectra.frequency_mhz)
        if spectra.resistance_ohm != self.resistance_ohm:
            expected, found = f"{self.resistance_ohm:g} as set here", f"{spectra.resistance_ohm:g}"
            raise BadInputError(f"{spectra.origin}: resistance_ohm", expected, found)
        if not len(spectra):
            raise BadInputError(spectra.origin, "spectra", "none")
        _require_names(spectra, name_place)
        _require_powers(spectra, name_place)
        self._require_on_record(spectra, name_place)
        spectra.require_past(self.clock() / 1e6)
        _require_one_time_an_event(spectra, name_place)
        with self.database.write() as stores:
            far = find_far(stores, spectra)
            added = stores.spectra.arrivals.add(spectra, far)
            warnings = [*warn_of_far(spectra, far), *_warn_of_covariates(added.differing)]
            if digest is not None:
                stores.spectra.arrivals.keep_receipt(digest, received, warnings, self.clock())
            return Receipt(received, added.spectra, warnings, added.covariates)

    def _require_channels(self, place: str, frequency_mhz: Floats) -> None:
        name = f"instrument {self.instrument.name} (lbacal spectra and lbacal import average to them with --instrument;"
        name += " data that stay on other channels need a service of their own)"
        require_same_grid(place, frequency_mhz, self.instrument.frequency_mhz, name)

    def _require_on_record(self, spectra: Spectra, name_place: Place) -> None:
        """Refuse a dipole, station or antenna that the instrument does not have, or does not have at that time."""
        letters = self.instrument.dipoles
        unknown = np.flatnonzero(~np.isin(spectra.dipole, letters))
        if unknown.size:
            k = int(unknown[0])
            require_name(name_place("dipole", k), str(spectra.dipole[k]), letters)
        stations = sorted({station for station, _ in self._records})
        for k, (station, antenna, time) in enumerate(
            zip(spectra.station.tolist(), spectra.antenna.tolist(), spectra.time_unix.tolist(), strict=True)
        ):
            records = self._records.get((station, antenna), ())
            if not records:
                require_name(name_place("station", k), station, stations)
                of_station = {number for name, number in self._records if name == station}
                require_antenna(name_place("antenna", k), antenna, station, of_station)
            if (station, antenna) not in self._always and not any(record.covers(time) for record in records):
                expected = f"a time at which {station} antenna {antenna} is on record"
                found = format_instant(round(time * 1e6))
                raise BadInputError(name_place("time_unix", k), expected, found)

    def set_flag(self, event_id: str, flag: str | None, *, reason: str, by: str) -> StoredEvent:
        """Set or clear a quality flag; a flagged event is left out of fits."""
        with self.database.write() as stores:
            stores.spectra.set_flag(event_id, flag, reason=reason, by=by, at=self.clock())
            return stores.spectra.event(event_id)


# What does not belong, of another campaign, through another attenuator or in decibels, waits for the night.


def find_far(stores: Stores, spectra: Spectra) -> Floats:
    """Power over what is stored of the path nearest in time where it is far from that, shape (row,); NaN elsewhere."""
    keys = list(zip(spectra.station.tolist(), spectra.antenna.tolist(), spectra.dipole.tolist(), strict=True))
    usual: dict[tuple[str, int, str], float] = {}
    for station in np.unique(spectra.station).tolist():
        middle = round(float(np.median(spectra.time_unix[spectra.station == station])) * 1e6)
        of_station = sorted({key for key in keys if key[0] == station})
        for key, levels in stores.spectra.arrivals.find_levels(of_station, middle).items():
            if len(levels) >= FEWEST_BESIDE:
                usual[key] = median(levels)
    if not usual:
        return np.full(len(spectra), np.nan)
    over = measure_level(spectra.power) - np.array([usual.get(key, np.nan) for key in keys])
    return np.exp(np.where(np.abs(over) > FAR, over, np.nan))


def warn_of_far(spectra: Spectra, far: Floats) -> list[str]:
    """One sentence for each of the first paths with spectra far from what is stored, and one for all others.

    `far` is their power over the one stored nearest in time, shape (row,), NaN of others.
    """
    factors: dict[str, list[float]] = {}
    for k in np.flatnonzero(np.isfinite(far)).tolist():
        name = name_path(str(spectra.station[k]), int(spectra.antenna[k]), str(spectra.dipole[k]))
        factors.setdefault(name, []).append(far[k])
    told = [
        f"{name}: {(factor := np.median(found)):.3g} times the power stored nearest in time "
        f"({10 * np.log10(factor):+.1f} dB); {write_count(len(found), 'spectrum', 'spectra')} stored, "
        "and in no fit before the night has judged them"
        for name, found in factors.items()
    ]
    more = len(told) - PATHS_NAMED
    return told if more <= 0 else [*told[:PATHS_NAMED], f"and {more} more paths in the same way"]


def _warn_of_covariates(differing: Mapping[str, Sequence[str]]) -> list[str]:
    """One sentence for each covariate that was sent with another value than the stored one."""
    return [
        f"{name} of {write_count(len(events), 'event')} is stored with another value, and what is stored stays: "
        f"{', '.join(events[:EVENTS_NAMED])}{f' and {more} more' if (more := len(events) - EVENTS_NAMED) > 0 else ''}; "
        "to correct it, flag the event (POST /v1/events/{id}/flag) and send all its spectra under another event"
        for name, events in sorted(differing.items())
    ]


def judge_far(stores: Stores) -> int:
    """Let those that wait into fits where they last, and count them: the path changed, and drift finds that.

    As well as those that are near to what has come since, which had been held against another year or another state.
    """
    judged = 0
    for path, times, is_waiting in list(stores.spectra.waiting()):
        lasting = [times[k] for k in np.flatnonzero(find_lasting(is_waiting))]
        stores.spectra.end_waiting(path, lasting)
        judged += len(lasting)
    for path, times, levels, beside in list(stores.spectra.waiting_beside()):
        if len(beside) >= FEWEST_BESIDE:
            near = [times[k] for k in np.flatnonzero(np.abs(levels - median(beside)) <= FAR)]
            stores.spectra.end_waiting(path, near)
            judged += len(near)
    return judged


def _read_times(spectra: Sequence[SpectrumBody]) -> list[Instant]:
    """The instants of a body; a batch repeats few of them many times."""
    read: dict[str, Instant] = {}
    for k, row in enumerate(spectra):
        if row.time_utc not in read:
            read[row.time_utc] = parse_instant(f"body.spectra[{k}].time_utc", row.time_utc)
    return [read[row.time_utc] for row in spectra]


def _without_repeats(spectra: Sequence[SpectrumBody], times: Sequence[Instant]) -> list[int]:
    """Which spectra of a batch to store, without repeats; another content under the same key is a conflict."""
    kept: dict[tuple[str, str, int, str], int] = {}
    for k, row in enumerate(spectra):
        first = kept.setdefault((row.event_id, row.station, row.antenna, row.dipole), k)
        if first != k and (times[first], spectra[first].blocks, spectra[first].power) != (
            times[k],
            row.blocks,
            row.power,
        ):
            raise ConflictError(
                f"body.spectra[{k}]: the batch holds another spectrum of {row.event_id}, "
                f"{name_path(row.station, row.antenna, row.dipole)}"
            )
    return list(kept.values())


def _as_spectra(body: SpectraBody, rows: Sequence[int], times: Sequence[Instant], resistance_ohm: float) -> Spectra:
    kept = [body.spectra[k] for k in rows]
    env = [row.env or {} for row in kept]
    names = sorted({name for given in env for name in given})
    if len(names) > MAX_NAMES_IN_BATCH:
        raise BadInputError("body", f"at most {MAX_NAMES_IN_BATCH} names in all its env", str(len(names)))
    channels = len(body.frequency_mhz)
    for k, row in zip(rows, kept, strict=True):
        if len(row.power) != channels:
            raise BadInputError(f"body.spectra[{k}].power", f"{channels} channels", str(len(row.power)))
    return Spectra(
        frequency_mhz=np.array(body.frequency_mhz, dtype=float),
        **lay_out_rows(
            [{**vars(row), "time_unix": times[k] / SECOND_US} for k, row in zip(rows, kept, strict=True)], channels
        ),
        resistance_ohm=resistance_ohm if body.resistance_ohm is None else body.resistance_ohm,
        environment={n: np.array([np.nan if e.get(n) is None else e[n] for e in env], dtype=float) for n in names},
        origin="body",
    )


def _require_powers(spectra: Spectra, name_place: Place) -> None:
    lowest, highest = POWERS
    bad = np.argwhere((spectra.power < lowest) | (spectra.power > highest))
    if len(bad):
        row, channel = bad[0].tolist()
        found = f"{float(spectra.power[row, channel])} at {spectra.frequency_mhz[channel]:g} MHz"
        raise BadInputError(name_place("power", row), f"a power from {lowest:g} to {highest:g}", found)


def _require_names(spectra: Spectra, name_place: Place) -> None:
    """Refuse events that no address could name."""
    names, first = np.unique(spectra.event_id, return_index=True)
    for name, k in zip(names.tolist(), first.tolist(), strict=True):
        if len(name) > LONGEST_NAME or not name.isprintable() or "/" in name or name.strip() in ("", ".", ".."):
            expected = f"at most {LONGEST_NAME} printable characters, no '/', not '.' or '..', not blanks alone"
            raise BadInputError(name_place("event_id", k), expected, repr(name))


def _require_one_time_an_event(spectra: Spectra, name_place: Place) -> None:
    """Refuse an event at two times: the sidereal time of its antennas would be wrong for one of them."""
    names, first, of_row = np.unique(spectra.event_id, return_index=True, return_inverse=True)
    apart = np.abs(spectra.time_unix - spectra.time_unix[first][of_row])
    k = int(np.argmax(apart))
    if apart[k] > EVENT_SPAN_US / 1e6:
        expected = f"a time within {EVENT_SPAN_US / 1e6:g} s of the other spectra of event {names[of_row[k]]}"
        raise BadInputError(name_place("time_unix", k), expected, f"{apart[k]:.0f} s")
