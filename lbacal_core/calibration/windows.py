"""Windows follow the hardware: where antennas changed inside one, as the instrument says or the drift found, it is cut.

A path whose antenna changed is fitted before and after by itself. A mean over antennas leaves out those that changed
inside its window, unless they are most of them: then it is cut at their dates too.
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from lbacal_core.instrument.instrument import Instrument
from lbacal_core.spectra.blocks import AnySpectra, Recorded
from lbacal_core.spectra.spectra import Owner, Rows, Spectra

LARGEST_SHARE_LEFT_OUT = 0.5

Cuts = Mapping[tuple[str, int | None], Sequence[float]]
"""When antennas changed, or (None) all of a station, s UTC, that the instrument does not know of."""
NO_CUTS: Cuts = {}


@dataclass(frozen=True)
class Piece:
    """A part of a window, [since, until) in s UTC, or all of it, with the antennas that did not change in it."""

    since_unix: float
    until_unix: float
    owners: Container[Owner]
    is_whole: bool

    def rows(self, spectra: Spectra) -> Rows:
        """Which spectra of the window are its, shape (row,)."""
        is_inside = (spectra.time_unix >= self.since_unix) & (spectra.time_unix < self.until_unix)
        return np.asarray(is_inside & spectra.is_of(self.owners))


def find_hardware_changes(instrument: Instrument) -> dict[Owner, tuple[float, ...]]:
    """When antennas changed, s UTC and rising, as the instrument says; those that never did are left out."""
    found: dict[Owner, set[float]] = {}
    for record in instrument.antennas:
        dates = {date for date in (record.since, record.until) if date is not None}
        if dates:
            found.setdefault((record.station, record.antenna), set()).update(dates)
    return {owner: tuple(sorted(dates)) for owner, dates in found.items()}


def cut_window(
    spectra: Recorded, instrument: Instrument, scope: str, since_unix: float, until_unix: float, cuts: Cuts = NO_CUTS
) -> list[Piece]:
    """Cut the window of a fit; a piece may have no spectra.

    Parameters
    ----------
    scope
        ``antenna``, ``station`` or ``array``.
    cuts
        Beside what the instrument says.
    """
    owners, ends = (
        sorted({(station, antenna) for station, antenna, _ in spectra.quarter_hashes}),
        (since_unix, until_unix),
    )
    known, changed = find_hardware_changes(instrument), dict[Owner, tuple[float, ...]]()
    for owner in owners:
        dates = {*known.get(owner, ()), *cuts.get(owner, ()), *cuts.get((owner[0], None), ())}
        if inside := tuple(sorted(date for date in dates if since_unix < date < until_unix)):
            changed[owner] = inside
    steady = frozenset(owners) - changed.keys()
    rest = [Piece(*ends, steady, is_whole=not changed)] if steady or not changed else []
    if scope == "antenna":  # those that changed at the same dates share their pieces
        together = {dates: {one for one in changed if changed[one] == dates} for dates in sorted(set(changed.values()))}
        return rest + [piece for dates, own in together.items() for piece in _cut_at(dates, own, ends)]
    if len(changed) <= LARGEST_SHARE_LEFT_OUT * len(owners):
        return rest
    return list(_cut_at(sorted({date for dates in changed.values() for date in dates}), owners, ends))


def leave_out_changed(spectra: AnySpectra, instrument: Instrument) -> AnySpectra | None:
    """The spectra of antennas that did not change while these were recorded; None where there are none."""
    (first, last), changes = spectra.span_unix, find_hardware_changes(instrument)
    owners = {(station, antenna) for station, antenna, _ in spectra.quarter_hashes}
    changed = {one for one in owners if any(first < date <= last for date in changes.get(one, ()))}
    kept = spectra.change(lambda own: own.select(~own.is_of(changed))) if changed else spectra
    return kept if len(kept) else None


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
            record = next(one for one in own if one.covers(float(spectra.time_unix[of_stretch[0]])))
            records.append(replace(record, antenna=number, since=None, until=None))
            antenna[of_stretch] = number
        free += len(most_first)
    if not changed:
        return spectra, instrument
    return replace(spectra, antenna=antenna), replace(instrument, antennas=tuple(records))


def _cut_at(dates: Sequence[float], owners: Container[Owner], ends: tuple[float, float]) -> Iterator[Piece]:
    for start, end in pairwise([ends[0], *dates, ends[1]]):
        yield Piece(start, end, owners, is_whole=False)
