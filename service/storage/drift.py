"""Monthly ratios of C: a cache of what follows from the stored spectra, replaced whole, station by station."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import Connection, delete, select

from lbacal_core.validity import Instant, Scope
from service.schema.tables import monthly_ratio, path


@dataclass(frozen=True)
class MonthlyRatio:
    """C of a path in a month over that of the reference version."""

    path: Scope
    month: Instant
    reference: str
    c_ratio: float
    c_ratio_sigma: float
    events: int


class DriftStore:
    """Monthly ratios by path."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def replace(self, station: str, since: Instant, until: Instant, ratios: Sequence[MonthlyRatio]) -> None:
        """Put the ratios of a station's months in [since, until) in place of the old ones."""
        rows = self._connection.execute(select(path).where(path.c.station == station))
        numbers = {Scope(row.station, row.antenna, row.dipole): row.id for row in rows}
        is_old = monthly_ratio.c.path.in_(numbers.values())
        is_in_window = (monthly_ratio.c.month_us >= since) & (monthly_ratio.c.month_us < until)
        self._connection.execute(delete(monthly_ratio).where(is_old & is_in_window))
        new = [
            {
                "path": numbers[ratio.path], "month_us": ratio.month, "reference": ratio.reference,
                "c_ratio": ratio.c_ratio, "c_ratio_sigma": ratio.c_ratio_sigma, "events": ratio.events,
            }
            for ratio in ratios
        ]  # fmt: skip
        if new:
            self._connection.execute(monthly_ratio.insert(), new)

    def ratios(self, scope: Scope) -> list[MonthlyRatio]:
        """All months of the paths of a scope, in order of path and month."""
        statement = select(monthly_ratio, path.c.station, path.c.antenna, path.c.dipole)
        statement = statement.join(path, path.c.id == monthly_ratio.c.path)
        if scope.station is not None:
            statement = statement.where(path.c.station == scope.station)
        if scope.antenna is not None:
            statement = statement.where(path.c.antenna == scope.antenna, path.c.dipole == scope.dipole)
        statement = statement.order_by(path.c.station, path.c.antenna, path.c.dipole, monthly_ratio.c.month_us)
        return [
            MonthlyRatio(
                Scope(row.station, row.antenna, row.dipole), row.month_us, row.reference,
                row.c_ratio, row.c_ratio_sigma, row.events,
            )
            for row in self._connection.execute(statement)
        ]  # fmt: skip
