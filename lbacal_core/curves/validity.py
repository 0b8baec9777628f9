"""Which calibration is in effect: an insert-only ledger of promotions, read at an instant as known at another.

A promotion says "from now on this version (or none) answers for this scope over this interval". Nothing is edited: the
newest promotion that covers an instant wins, promoting an old version again rolls back, and reading the ledger as of an
earlier instant gives the answer that was given then. The conditions databases of particle physics call the interval an
interval of validity. Instants are whole microseconds since 1970 (UTC), so that databases and comparisons are exact.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from lbacal_core.errors import BadInputError
from lbacal_core.instrument.antennas import EXPECTED, is_dipole_name

Instant = int
"""Whole microseconds since 1970-01-01 UTC."""


@dataclass(frozen=True)
class Scope:
    """The scope of a version: the array, a station, or one path (station, antenna, dipole)."""

    station: str | None = None
    antenna: int | None = None
    dipole: str | None = None

    def __post_init__(self) -> None:
        is_path = self.antenna is not None and self.dipole is not None
        if (self.antenna is None) != (self.dipole is None) or (is_path and self.station is None):
            found = ", ".join(f"{k} {v}" for k, v in vars(self).items() if v is not None)
            raise BadInputError("scope", "nothing (array), station, or station with antenna and dipole", found)
        if self.dipole is not None and not is_dipole_name(self.dipole):
            raise BadInputError("dipole", EXPECTED, repr(self.dipole))

    @property
    def parts(self) -> tuple[str | None, int | None, str | None]:
        """Station, antenna and dipole, None where it names none."""
        return self.station, self.antenna, self.dipole

    @property
    def level(self) -> str:
        """``array``, ``station`` or ``antenna``."""
        if self.antenna is not None:
            return "antenna"
        return "array" if self.station is None else "station"

    @property
    def key(self) -> str:
        """One text for one scope: ``array``, ``CS002``, ``CS002/17/X``."""
        if self.antenna is not None:
            return f"{self.station}/{self.antenna}/{self.dipole}"
        return self.station or "array"

    @property
    def widening(self) -> tuple[Scope, ...]:
        """The scope and those that answer for it when it is silent, narrowest first."""
        if self.antenna is not None:
            return self, Scope(self.station), Scope()
        return (self,) if self.station is None else (self, Scope())


def parse_scope(key: str) -> Scope:
    """Parse a `Scope.key`, such as ``CS002/17/X``."""
    station, antenna, dipole = [*key.split("/"), None, None][:3]
    return Scope(None if station == Scope().key else station, None if antenna is None else int(antenna), dipole)


@dataclass(frozen=True)
class Promotion:
    """One line of the ledger; `calibration` None withdraws. `number` orders promotions of the same instant `at`.

    That of a rollback `undoes` the act of another instant.
    """

    number: int
    scope: Scope
    valid_from: Instant
    valid_to: Instant | None
    calibration: str | None
    at: Instant
    by: str = ""
    reason: str = ""
    undoes: Instant | None = None

    def __post_init__(self) -> None:
        if self.valid_to is not None and self.valid_to <= self.valid_from:
            raise BadInputError("valid_to", "an instant after valid_from, or null", "one not after it")

    def covers(self, instant: Instant) -> bool:
        """Whether the half-open interval of validity holds an instant."""
        return self.valid_from <= instant and (self.valid_to is None or instant < self.valid_to)


@dataclass(frozen=True)
class Stretch:
    """An interval [start, end) over which one promotion answers for a path, or none does; None is open."""

    start: Instant | None
    end: Instant | None
    promotion: Promotion | None

    @property
    def calibration(self) -> str | None:
        """Hash of the version that answers; None where none does."""
        return self.promotion.calibration if self.promotion else None


def timeline(promotions: Iterable[Promotion], path: Scope) -> list[Stretch]:
    """Everything that ever answers for a path, in order, without gaps; neighbours differ in their promotion.

    A sweep over the sorted ends of intervals. Each scope keeps a heap of the intervals that have begun, newest first;
    one that has ended leaves the heap when it comes to its top, so each promotion enters and leaves once.
    """
    ranks = {scope: rank for rank, scope in enumerate(path.widening)}
    waiting = sorted((p for p in promotions if p.scope in ranks), key=lambda p: p.valid_from, reverse=True)
    edges = sorted({p.valid_from for p in waiting} | {p.valid_to for p in waiting if p.valid_to is not None})
    begun: list[list[tuple[int, int, Promotion]]] = [[] for _ in ranks]
    starts: list[Instant | None] = [None, *edges]
    stretches: list[Stretch] = []
    for start, end in zip(starts, [*edges, None], strict=True):
        while start is not None and waiting and waiting[-1].valid_from <= start:
            entering = waiting.pop()
            heapq.heappush(begun[ranks[entering.scope]], (-entering.at, -entering.number, entering))
        promotion = None if start is None else _narrowest_answer(begun, start)
        if stretches and stretches[-1].promotion == promotion:
            stretches[-1] = Stretch(stretches[-1].start, end, promotion)
        else:
            stretches.append(Stretch(start, end, promotion))
    return stretches


def list_deciding(
    promotions: Iterable[Promotion], scope: Scope, since: Instant, until: Instant | None
) -> Iterator[Promotion]:
    """The promotions of a scope that decide in [since, until), withdrawals too, each over the part in which it does."""
    # an empty name for none: withdrawals then answer in the timeline
    named = [replace(p, calibration=p.calibration or "") for p in promotions if p.scope == scope]
    for one in timeline(named, scope):
        ends = [end for end in (one.end, until) if end is not None]
        start, end = max(one.start or since, since), min(ends, default=None)
        if one.promotion is not None and (end is None or start < end):
            yield replace(one.promotion, valid_from=start, valid_to=end, calibration=one.calibration or None)


def _narrowest_answer(begun: Iterable[list[tuple[int, int, Promotion]]], instant: Instant) -> Promotion | None:
    for heap in begun:
        while heap and not heap[0][-1].covers(instant):
            heapq.heappop(heap)
        if heap and heap[0][-1].calibration is not None:
            return heap[0][-1]
    return None
