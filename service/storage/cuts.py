"""Dates at which windows of antennas are cut, because the watch found that these changed then, and what people decided.

A cut stands from the night on which its change is found until it is found no more, unless a person lifted it. Nothing
is deleted: a cut that ended and every decision stay on record.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

from sqlalchemy import Connection, Row, Select, func, select, update

from lbacal_core.curves.validity import Instant
from service.errors import NotFoundError
from service.schema.drift import cut_decision, window_cut
from service.wire.instants import DAY_US

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
