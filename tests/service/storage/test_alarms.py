from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sqlalchemy import text

from lbacal_core.curves.validity import Scope
from lbacal_core.drift.events import EventModes, average_months
from service.errors import NotFoundError
from service.factory import Factory
from service.storage.alarms import (
    ACKNOWLEDGED,
    ENDED,
    FAILED_JOB,
    LOST_PATH,
    OPEN,
    SLOPE,
    STATES,
    STEP,
    Acknowledgement,
    Alarm,
    AlarmsAsked,
    News,
)
from service.storage.jobs import Order
from service.storage.sums import Sums
from service.usecases.drift_measurement import KIND, read_events, write_events
from tests.service.conftest import night

DAY = 86_400_000_000
NOW = 1_600_000_000_000_000
JUMP = News(STEP, Scope("CS002"), "", "it jumped", {"size": 0.03}, NOW - 100 * DAY, 2 * DAY)


def raise_alarm(factory: Factory, news: News, now: int = NOW) -> int:
    with factory.database.write() as stores:
        return stores.alarms.raise_alarm(news, now)


def settle(factory: Factory, kinds: tuple[str, ...], *present: News, now: int) -> list[int]:
    with factory.database.write() as stores:
        return stores.alarms.settle(kinds, present, now)


def read(factory: Factory, *states: str, now: int = NOW) -> list[Alarm]:
    with factory.database.read() as stores:
        return stores.alarms.newest(AlarmsAsked(states or STATES, 100), now)


def test_a_problem_is_raised_once_and_seen_again_another_night(factory: Factory) -> None:
    number = raise_alarm(factory, JUMP)
    later = replace(JUMP, sentence="it jumped, said better", since=NOW - 97 * DAY, since_error=DAY)
    assert raise_alarm(factory, later, NOW + DAY) == number
    (alarm,) = read(factory)
    assert (alarm.raised, alarm.seen, alarm.news) == (NOW, NOW + DAY, later)


def test_steps_of_two_dates_are_two_alarms(factory: Factory) -> None:
    numbers = {raise_alarm(factory, replace(JUMP, since=NOW - days * DAY)) for days in (100, 80, 40)}
    assert len(numbers) == 3
    assert raise_alarm(factory, replace(JUMP, since=NOW - 81 * DAY)) == sorted(numbers)[1]


def test_two_steps_found_in_one_night_never_share_an_alarm(factory: Factory) -> None:
    near = replace(JUMP, since=NOW - 98 * DAY)
    assert len(settle(factory, (STEP,), JUMP, near, now=NOW)) == 2
    assert settle(factory, (STEP,), JUMP, near, now=NOW + DAY) == []


def test_what_is_gone_has_ended_and_what_comes_back_is_the_same_alarm(factory: Factory) -> None:
    slope = News(SLOPE, Scope("CS002", 3, "X"), "", "it slopes")
    first = settle(factory, (STEP, SLOPE), JUMP, slope, now=NOW)
    assert settle(factory, (STEP, SLOPE), JUMP, now=NOW + DAY) == []
    assert [one.news.kind for one in read(factory, ENDED)] == [SLOPE]
    assert settle(factory, (STEP, SLOPE), JUMP, slope, now=NOW + 2 * DAY) == [], "no news: it was raised before"
    assert {one.number for one in read(factory, OPEN)} == set(first)


def test_an_antenna_that_dies_again_is_a_new_problem(factory: Factory) -> None:
    lost = News(LOST_PATH, Scope("CS002", 3, "X"), "", "no spectrum", since=NOW - 50 * DAY)
    first = settle(factory, (LOST_PATH,), lost, now=NOW)
    settle(factory, (LOST_PATH,), now=NOW + DAY)
    again = settle(factory, (LOST_PATH,), replace(lost, since=NOW + 5 * DAY), now=NOW + 30 * DAY)
    assert len(again) == 1
    assert again != first


def test_settling_some_kinds_leaves_the_others_alone(factory: Factory) -> None:
    other = replace(JUMP, scope=Scope("CS003"))
    for news in (JUMP, other, News(FAILED_JOB, Scope(), "refit", "it failed")):
        raise_alarm(factory, news)
    settle(factory, (STEP,), other, now=NOW + DAY)
    assert {one.news.scope.key for one in read(factory, OPEN)} == {"CS003", "array"}


def test_an_acknowledged_alarm_is_open_again_after_its_time(factory: Factory) -> None:
    number = raise_alarm(factory, JUMP)
    with factory.database.write() as stores:
        stores.alarms.acknowledge(number, Acknowledgement("me", NOW, "ordered", NOW + 10 * DAY))
    assert [one.state_at(NOW) for one in read(factory, ACKNOWLEDGED)] == [ACKNOWLEDGED]
    assert read(factory, OPEN, now=NOW + 9 * DAY) == []
    assert [one.number for one in read(factory, OPEN, now=NOW + 11 * DAY)] == [number]
    with factory.database.write() as stores:
        stores.alarms.acknowledge(number, Acknowledgement("me", NOW, "never mind", None))
    assert read(factory, OPEN, now=NOW + 1000 * DAY) == []
    with factory.database.read() as stores:
        assert stores.alarms.count(NOW + 1000 * DAY, ACKNOWLEDGED) == {STEP: 1}
        assert stores.alarms.count_raised(NOW - 1) == 1
        with pytest.raises(NotFoundError):
            stores.alarms.get(number + 1)


def test_an_unknown_kind_is_refused() -> None:
    with pytest.raises(ValueError, match="not one of"):
        News("noise", Scope(), "", "2 sigma")


YEAR = 31_536_000_000_000


def make(since: int, antennas: int = 2, events: int = 5) -> Sums:
    rng = np.random.default_rng(since % 1000)
    ln_c = rng.standard_normal((antennas, events, 3))
    ln_c[0, 1] = np.nan
    modes = {"X": EventModes(np.arange(antennas), (since + np.arange(events)) / 1e6, ln_c)}
    since -= since % YEAR
    return Sums(KIND, Scope("CS001"), since, since + YEAR, "", 0, 0, 0, 0, write_events(modes))


def test_a_year_in_which_no_path_has_a_reference_calls_for_no_watch(factory: Factory) -> None:
    """Its watch failed: there was nothing to follow."""
    with factory.database.write() as stores:
        stores.sums.put(replace(make(0), arrays={}))
        assert len(list(stores.sums.of_kind(KIND))) == 1
        assert factory.watch.name_inputs(stores) is None


def test_events_come_back_as_they_were_and_a_year_is_replaced_whole(factory: Factory) -> None:
    with factory.database.write() as stores:
        stores.sums.put(make(0))
        stores.sums.put(make(YEAR))
        before = stores.sums.digests(KIND)
        stores.sums.put(make(1, antennas=3))
    with factory.database.read() as stores:
        first, second = (read_events(one.arrays)["X"] for one in stores.sums.of_kind(KIND))
        after = stores.sums.digests(KIND)
    assert first.antennas.tolist() == [0, 1, 2]
    written = make(YEAR).arrays
    assert np.array_equal(second.ln_c.astype(np.float32), written["X.ln_c"], equal_nan=True)
    assert np.array_equal(np.round(second.time_unix * 1e6), written["X.time_us"])
    assert (before[0] != after[0], before[1] == after[1]) == (True, True)


def test_the_last_report_is_the_one_that_is_kept(factory: Factory) -> None:
    with factory.database.write() as stores:
        assert (stores.drift.report(), stores.drift.report_made(), stores.drift.state()) == (None, None, [])
        stores.drift.keep_report("a", {"changes": []}, 1)
        stores.drift.keep_report("b", {"changes": [1]}, 2)
        assert (stores.drift.report(), stores.drift.report_made()) == ({"changes": [1]}, ("b", 2))
        assert stores.drift.state() == [["b", 2]]


@pytest.mark.long
def test_months_have_a_gain_and_two_modes(station: Factory) -> None:

    night(station)
    with station.database.read() as stores:
        years = [read_events(one.arrays)["X"] for one in stores.sums.of_kind(KIND)]
        kept = stores.drift.months_of_paths("CS002")
    months = [average_months(modes) for modes in years]
    assert [found.months.size for found in months] == [12, 12]
    for found, year in zip(months, kept, strict=True):
        assert np.abs(found.shape[1] / found.shape_sigma[1]).max() < 6.0
        path = year.ratios[year.paths.index(Scope("CS002", 1, "X"))]
        np.testing.assert_array_equal(path[:, 2:4], found.shape[1])


def test_open_parts_are_counted_and_of_the_ended_those_that_ended_lately(factory: Factory) -> None:
    parts = [{"station": f"CS{k:03d}"} for k in range(9)]
    with factory.database.write() as stores:
        stores.jobs.add(Order("refit", {}, parts, "test", "test", inputs="a sky"), 1)
    states = [("running", None), ("failed", 9), ("failed", 11), ("cancelled", 11)]
    states += [("done", ended) for ended in (9, 10, 11)]
    with factory.database.engine.begin() as connection:
        numbers = connection.execute(text("SELECT id FROM job_part ORDER BY id")).scalars().all()
        for number, (state, ended) in zip(numbers, states, strict=False):
            change = text("UPDATE job_part SET state = :state, ended_us = :ended WHERE id = :number")
            connection.execute(change, {"state": state, "ended": ended, "number": number})
    with factory.database.read() as stores:
        counts, waiting = stores.jobs.count_by_state(10), stores.jobs.waiting()
    assert counts == {"queued": 2, "running": 1, "done": 2, "failed": 1, "cancelled": 1}
    assert waiting == {"a sky": 2}, "what runs waits for no worker"
