"""What the benchmark of the ledger times is what it names; the times themselves are no test."""

from __future__ import annotations

from pathlib import Path

from validation.benchmarks.ledger import PATHS, deeds, fill, opened


def test_each_deed_is_done_on_a_ledger_of_two_nights(tmp_path: Path) -> None:
    with opened(str(tmp_path / "lbacal.sqlite")) as factory:
        every = deeds(factory, fill(factory, 2))
        for deed in every.values():
            deed(0)
        with factory.database.read() as stores:
            newest = stores.ledger.newest_number()
    assert newest == 3 * len(PATHS) + sum(name.startswith("promotion") for name in every)
