"""A ledger as years of nights leave it, written at once."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

from lbacal_core.validity import Promotion
from service.factory import Factory
from service.schema.tables import promotion

BATCH = 20_000
STAND = """
INSERT INTO standing (scope, valid_from_us, valid_to_us, promotion)
SELECT scope, valid_from_us, coalesce(valid_to_us, 9223372036854775807) AS until_us, max(id) FROM promotion
GROUP BY scope, valid_from_us, until_us
"""


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
        connection.exec_driver_sql("DELETE FROM standing")
        connection.exec_driver_sql(STAND)
