"""Windows follow the hardware: where antennas changed inside one, as the instrument says or the drift found, it is cut.

A path whose antenna changed is fitted before and after by itself. A mean over antennas leaves out those that changed
inside its window, unless they are most of them: then it is cut at their dates too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lbacal_core.instrument.instrument import Instrument
from lbacal_core.spectra.spectra import Spectra

LARGEST_SHARE_LEFT_OUT = 0.5

Owner = tuple[str, int]
"""Station and antenna."""
Cuts = Mapping[tuple[str, int | None], Sequence[float]]
"""When antennas changed, or (None) all of a station, s UTC, that the instrument does not know of."""
NO_CUTS: Cuts = {}


@dataclass(frozen=True)
class Piece:
    """A part of a window, [since, until) in s UTC; `rows` are its spectra, of antennas that did not change in it."""

    since_unix: float
    until_unix: float
    rows: NDArray[np.bool_]


def find_hardware_changes(instrument: Instrument) -> dict[Owner, tuple[float, ...]]:
    """When antennas changed, s UTC and rising, as the instrument says; those that never did are left out."""
    found: dict[Owner, set[float]] = {}
    for record in instrument.antennas:
        dates = {date for date in (record.since, record.until) if date is not None}
        if dates:
            found.setdefault((record.station, record.antenna), set()).update(dates)
    return {owner: tuple(sorted(dates)) for owner, dates in found.items()}


def cut_window(
    spectra: Spectra, instrument: Instrument, scope: str, since_unix: float, until_unix: float, cuts: Cuts = NO_CUTS
) -> list[Piece]:
    """Cut the window of a fit; pieces without spectra are left out.

    Parameters
    ----------
    scope
        ``antenna``, ``station`` or ``array``.
    cuts
        Beside what the instrument says; an antenna of which it names a change in the window keeps to these.
    """
    owners, owner_at = _find_owners(spectra)
    known, changed, ends = find_hardware_changes(instrument), dict[Owner, tuple[float, ...]](), (since_unix, until_unix)
    for owner in owners:
        own = _inside(known.get(owner, ()), *ends) or _inside(cuts.get(owner, ()), *ends)
        of_station = _inside(cuts.get((owner[0], None), ()), *ends)
        if own or of_station:
            changed[owner] = tuple(sorted({*own, *of_station}))
    if not changed:
        return [Piece(since_unix, until_unix, np.ones(len(spectra), dtype=bool))]
    has_changed = np.array([owner in changed for owner in owners])[owner_at]
    rest = [] if np.all(has_changed) else [Piece(since_unix, until_unix, ~has_changed)]
    if scope == "antenna":
        return rest + list(_cut_each(spectra, owners, owner_at, changed, (since_unix, until_unix)))
    if len(changed) <= LARGEST_SHARE_LEFT_OUT * len(owners):
        return rest
    edges = [since_unix, *sorted({date for dates in changed.values() for date in dates}), until_unix]
    return list(_pieces(spectra, np.ones(len(spectra), dtype=bool), edges))


def _inside(dates: Sequence[float], since_unix: float, until_unix: float) -> list[float]:
    return [date for date in dates if since_unix < date < until_unix]


def leave_out_changed(spectra: Spectra, instrument: Instrument) -> Spectra | None:
    """The spectra of antennas that did not change while these were recorded; None where there are none."""
    first, last = float(spectra.time_unix.min()), float(spectra.time_unix.max())
    changes = find_hardware_changes(instrument)
    owners, owner_at = _find_owners(spectra)
    is_whole = np.array([not any(first < d <= last for d in changes.get(o, ())) for o in owners])[owner_at]
    return spectra if np.all(is_whole) else spectra.select(is_whole) if np.any(is_whole) else None


def set_apart(spectra: Spectra, instrument: Instrument) -> tuple[Spectra, Instrument]:
    """Take an antenna that changed while these were recorded for several, one a stretch, each with one cable.

    The stretch with the most spectra keeps the number of the antenna, the others get numbers that no antenna has: what
    is said of this antenna alone is said of that stretch.
    """
    if not len(spectra):
        return spectra, instrument
    first, last = float(spectra.time_unix.min()), float(spectra.time_unix.max())
    changed = {
        owner: inside
        for owner, dates in find_hardware_changes(instrument).items()
        if (inside := [date for date in dates if first < date <= last])
    }
    antenna, records = spectra.antenna.copy(), list(instrument.antennas)
    free = 1 + max(record.antenna for record in records)
    for owner, dates in sorted(changed.items()):
        rows = np.flatnonzero((spectra.station == owner[0]) & (spectra.antenna == owner[1]))
        stretch = np.searchsorted(dates, spectra.time_unix[rows], side="right")
        if rows.size == 0:
            continue
        found, counts = np.unique(stretch, return_counts=True)
        own = [record for record in records if (record.station, record.antenna) == owner]
        records = [record for record in records if (record.station, record.antenna) != owner]
        most_first = found[np.argsort(-counts, kind="stable")].tolist()
        for number, k in zip((owner[1], *range(free, free + len(most_first) - 1)), most_first, strict=True):
            of_stretch = rows[stretch == k]
            record = next(one for one in own if _holds(one.since, one.until, float(spectra.time_unix[of_stretch[0]])))
            records.append(replace(record, antenna=number, since=None, until=None))
            antenna[of_stretch] = number
        free += len(most_first)
    if not changed:
        return spectra, instrument
    return replace(spectra, antenna=antenna), replace(instrument, antennas=tuple(records))


def _holds(since: float | None, until: float | None, time_unix: float) -> bool:
    return (since is None or since <= time_unix) and (until is None or time_unix < until)


def _find_owners(spectra: Spectra) -> tuple[list[Owner], NDArray[np.int64]]:
    """The antennas that spectra are of, rising, and which of them each row is of, shape (row,)."""
    (stations, station_at), (antennas, antenna_at) = spectra.key_codes["station"], spectra.key_codes["antenna"]
    codes, owner_at = np.unique(station_at * antennas.size + antenna_at, return_inverse=True)
    return [(str(stations[one // antennas.size]), int(antennas[one % antennas.size])) for one in codes], owner_at


def _cut_each(
    spectra: Spectra,
    owners: list[Owner],
    owner_at: NDArray[np.int64],
    changed: dict[Owner, tuple[float, ...]],
    ends: tuple[float, float],
) -> Iterator[Piece]:
    """The pieces of antennas that changed; those that changed at the same dates share theirs."""
    for dates in sorted(set(changed.values())):
        is_one = np.array([changed.get(owner) == dates for owner in owners])[owner_at]
        yield from _pieces(spectra, is_one, [ends[0], *dates, ends[1]])


def _pieces(spectra: Spectra, is_one: NDArray[np.bool_], edges: list[float]) -> Iterator[Piece]:
    for start, end in pairwise(edges):
        rows = is_one & (spectra.time_unix >= start) & (spectra.time_unix < end)
        if np.any(rows):
            yield Piece(start, end, rows)
