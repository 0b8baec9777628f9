"""Dates at which windows of antennas are cut, because the watch found that these changed then."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from sqlalchemy import Connection, select, update

from lbacal_core.validity import Instant
from service.schema.drift import window_cut


@dataclass(frozen=True)
class Cut:
    """A date, with its standard deviation in microseconds, at which the windows of both dipoles are cut."""

    station: str
    antenna: int
    date: Instant
    sigma: int


class CutStore:
    """Cuts that stand and stood: one that is lifted stays on record."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def standing(
        self, station: str | None = None, since: Instant | None = None, until: Instant | None = None
    ) -> list[Cut]:
        """The cuts that stand, of all stations or of one, inside a window, in order of antenna and date."""
        columns = window_cut.c.station, window_cut.c.antenna, window_cut.c.date_us, window_cut.c.sigma_us
        statement = select(*columns).where(window_cut.c.lifted_us.is_(None)).order_by(*columns)
        if station is not None:
            statement = statement.where(window_cut.c.station == station)
        if since is not None:
            statement = statement.where(window_cut.c.date_us > since)
        if until is not None:
            statement = statement.where(window_cut.c.date_us < until)
        return [Cut(*row) for row in self._connection.execute(statement)]

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

    def lift(self, cut: Cut, now: Instant) -> None:
        """End a cut."""
        is_it = (window_cut.c.station == cut.station) & (window_cut.c.antenna == cut.antenna)
        is_it &= (window_cut.c.date_us == cut.date) & window_cut.c.lifted_us.is_(None)
        self._connection.execute(update(window_cut).where(is_it).values(lifted_us=now))
