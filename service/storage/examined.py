"""Inputs that a scheduled fit looked at without storing a curve, because C hardly moved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, select
from sqlalchemy.dialects.postgresql import insert as postgresql_insert
from sqlalchemy.dialects.sqlite import insert as sqlite_insert

from lbacal_core.curves.validity import Instant, Scope, parse_scope
from service.schema.tables import examined


@dataclass(frozen=True)
class Examined:
    """The fit of a scope's window whose C is that of the version in effect, but for `shift` standard deviations.

    `inputs` is the id that its version would have; where an earlier fit was continued, the hash of its version and of
    the spectra that came since.
    """

    scope: Scope
    since: Instant
    until: Instant
    inputs: str
    calibration: str
    shift: float
    made: Instant


class ExaminedStore:
    """One row for each scope and window: the inputs examined last."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._insert: Any = sqlite_insert if connection.dialect.name == "sqlite" else postgresql_insert

    def put(self, found: Sequence[Examined]) -> None:
        """Write what was examined, in place of what was before."""
        rows = [
            {
                "scope": one.scope.key, "since_us": one.since, "until_us": one.until, "inputs": one.inputs,
                "calibration": one.calibration, "shift": one.shift, "made_us": one.made,
            }
            for one in sorted(found, key=lambda one: one.scope.key)
        ]  # fmt: skip
        if rows:
            insert = self._insert(examined)
            keys = ["scope", "since_us", "until_us"]
            changed = {name: insert.excluded[name] for name in rows[0] if name not in keys}
            self._connection.execute(insert.on_conflict_do_update(index_elements=keys, set_=changed), rows)

    def of_calibration(self, calibration: str) -> Examined | None:
        """The fit that confirmed a version last."""
        statement = select(examined).where(examined.c.calibration == calibration)
        row = self._connection.execute(statement.order_by(examined.c.made_us.desc()).limit(1)).one_or_none()
        if row is None:
            return None
        window = row.since_us, row.until_us
        return Examined(parse_scope(row.scope), *window, row.inputs, row.calibration, row.shift, row.made_us)
