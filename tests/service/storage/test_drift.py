from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.curves.validity import Scope
from service.factory import Factory
from service.scheduler import look_for_due_work
from service.storage.drift import StoredModes
from tests.service.test_worker import work

YEAR = 31_536_000_000_000


def make(since: int, antennas: int = 2, events: int = 5) -> StoredModes:
    rng = np.random.default_rng(since % 1000)
    ln_c = rng.standard_normal((antennas, events, 3)).astype(np.float32)
    ln_c[0, 1] = np.nan
    return StoredModes("CS001", "X", since, tuple(range(antennas)), since + np.arange(events), ln_c)


def test_events_come_back_as_they_were_and_a_year_is_replaced_whole(factory: Factory) -> None:
    with factory.database.write() as stores:
        stores.drift.replace("CS001", 0, YEAR, [], [make(0)])
        stores.drift.replace("CS001", YEAR, 2 * YEAR, [], [make(YEAR)])
        before = stores.drift.digests()
        stores.drift.replace("CS001", 0, YEAR, [], [make(1, antennas=3)])
    with factory.database.read() as stores:
        first, second = stores.drift.modes()
        after = stores.drift.digests()
    assert first.antennas == (0, 1, 2)
    assert np.array_equal(second.ln_c, make(YEAR).ln_c, equal_nan=True)
    assert np.array_equal(second.time_us, make(YEAR).time_us)
    assert (before[0] != after[0], before[1] == after[1]) == (True, True)


def test_the_last_report_is_the_one_that_is_kept(factory: Factory) -> None:
    with factory.database.write() as stores:
        assert stores.drift.report() is None
        stores.drift.keep_report("a", {"changes": []}, 1)
        stores.drift.keep_report("b", {"changes": [1]}, 2)
        assert stores.drift.report() == {"changes": [1]}


@pytest.mark.long
def test_months_have_a_gain_and_two_modes(station: Factory) -> None:

    look_for_due_work(station)
    work(station)
    with station.database.read() as stores:
        ratios = stores.drift.ratios(Scope("CS002", 1, "X"))
    assert len(ratios) == 24
    for one in ratios:
        assert one.shape is not None
        assert one.shape_sigma is not None
        assert np.abs(np.array(one.shape) / np.array(one.shape_sigma)).max() < 6.0
