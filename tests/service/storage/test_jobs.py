from __future__ import annotations

from sqlalchemy import text

from service.factory import Factory
from service.storage.jobs import Order


def test_open_parts_are_counted_and_of_the_ended_those_that_ended_lately(factory: Factory) -> None:
    parts = [{"station": f"CS{k:03d}"} for k in range(8)]
    with factory.database.write() as stores:
        stores.jobs.add(Order("refit", {}, parts, "test", "test"), 1)
    states = [("running", None), ("failed", 9), ("failed", 11), ("cancelled", 11)]
    states += [("done", ended) for ended in (9, 10, 11)]
    with factory.database.engine.begin() as connection:
        numbers = connection.execute(text("SELECT id FROM job_part ORDER BY id")).scalars().all()
        for number, (state, ended) in zip(numbers, states, strict=False):
            change = text("UPDATE job_part SET state = :state, ended_us = :ended WHERE id = :number")
            connection.execute(change, {"state": state, "ended": ended, "number": number})
    with factory.database.read() as stores:
        counts = stores.jobs.count_by_state(10)
    assert counts == {"queued": 1, "running": 1, "done": 2, "failed": 1, "cancelled": 1}
