"""An empty service to fill, and a ledger as years of nights leave it, written at once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import islice
from typing import Any

from lbacal_core.curves.validity import Promotion
from service.config import Settings
from service.factory import Factory
from service.schema.tables import promotion
from service.storage.migration import upgrade

BATCH = 20_000
STAND = """
INSERT INTO standing (scope, valid_from_us, valid_to_us, promotion)
SELECT scope, valid_from_us, coalesce(valid_to_us, 9223372036854775807) AS until_us, max(id) FROM promotion
GROUP BY scope, valid_from_us, until_us
"""
EDGES = """
INSERT INTO edge (station, at_us, known_us)
SELECT station, at_us, min(known_us) FROM (
    SELECT coalesce(station, '') AS station, valid_from_us AS at_us, at_us AS known_us FROM promotion
    UNION ALL SELECT coalesce(station, ''), valid_to_us, at_us FROM promotion WHERE valid_to_us IS NOT NULL
) AS ends GROUP BY station, at_us
"""


@contextmanager
def open_factory(url: str, **settings: Any) -> Iterator[Factory]:
    """Open stores and use cases on an empty database, until the block ends."""
    factory = Factory(Settings(database_url=url, **{"max_rate": 1e9} | settings))
    upgrade(factory.database)
    try:
        yield factory
    finally:
        factory.database.close()


def write_promotions(factory: Factory, made: Iterable[Promotion]) -> None:
    """Write promotions with the instants `at` that they have, oldest first, and what stands in the end."""
    with factory.database.engine.begin() as connection:
        rest = iter(made)
        while some := list(islice(rest, BATCH)):
            rows = [
                {
                    "scope": p.scope.key, "station": p.scope.station, "antenna": p.scope.antenna,
                    "dipole": p.scope.dipole, "valid_from_us": p.valid_from, "valid_to_us": p.valid_to,
                    "calibration": p.calibration, "at_us": p.at, "by": p.by, "reason": p.reason,
                    **({"id": p.number} if p.number else {}),
                }
                for p in some
            ]  # fmt: skip
            connection.execute(promotion.insert(), rows)
        for table, fill in (("standing", STAND), ("edge", EDGES)):
            connection.exec_driver_sql(f"DELETE FROM {table}")  # noqa: S608 - those above
            connection.exec_driver_sql(fill)
