"""Nights: those that fail, and those whose data are not as one wishes: dead antennas, late years, clocks that jump."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from lbacal.instants import parse_instant
from lbacal_core.curves.validity import Scope
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.sky.table import read_sky_power
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings
from service import scheduler
from service.factory import Factory
from service.scheduler import look_again, look_for_due_work, persist, run_scheduler, wait_for_quiet
from service.storage.alarms import AlarmsAsked
from service.storage.jobs import PAUSE_US
from service.storage.processes import SCHEDULER
from service.usecases.drift_measurement import find_references
from tests.service.conftest import Clock, add_spectra, flat_spectra, get_job, like, night

DAY_S = 86_400.0
EVERYTHING = AlarmsAsked(("open", "ended"), 99)
Make = Callable[..., Factory]


def at(date: str) -> float:
    return parse_instant("", date) / 1e6


@pytest.fixture(scope="module")
def years(superterp: Instrument, sky_power_file: Path) -> Spectra:
    """Five antennas from 2014 to the first quarter of 2016."""
    settings = TwinSettings(stations=("CS002",), antennas=5, years=2.25, events_per_year=150)
    return simulate_campaign(settings, superterp, read_sky_power(sky_power_file), np.random.default_rng(3)).spectra


@pytest.fixture
def make(make_service: Make) -> Make:
    """Makes a service that looks at one database; data of a past year are not stale."""
    return partial(make_service, lease_s=60.0, gate_change=0.9, stale_days=0)


def pass_nights(factory: Factory, spectra: Spectra, count: int = 2) -> None:
    """Take spectra in, and let nights pass; no job of them fails."""
    add_spectra(factory, spectra)
    for _ in range(count):
        assert not [errors for job in night(factory) for errors in job.errors if errors]
    assert look_for_due_work(factory) == [], "the work of the nights is done"


def tell_alarms(factory: Factory) -> list[tuple[str, str, str]]:
    with factory.database.read() as stores:
        found = stores.alarms.newest(EVERYTHING, factory.clock())
    return [(one.state_at(factory.clock()), one.news.kind, one.news.sentence) for one in found]


def c_in_effect(factory: Factory, path: Scope, date: str) -> tuple[float, float, int] | None:
    """Band mean of C of a path's own version, its error, and its events."""
    with factory.database.read() as stores:
        said = stores.ledger.decisive([path], parse_instant("", date), None).get(path)
        if said is None or said.calibration is None:
            return None
        (mean,) = stores.versions.means([said.calibration])
    return mean.c, mean.c_sigma, mean.events


def test_an_unforeseen_error_in_one_look_does_not_end_all_nights(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scheduler, "FIRST_PAUSE_S", 0.001)
    looks = iter([FileNotFoundError("sky.json"), ZeroDivisionError(), None])

    def look() -> None:
        failure = next(looks)
        if failure:
            raise failure

    persist(look, threading.Event())
    assert list(looks) == []


def test_the_scheduler_looks_again_while_the_sky_is_away_and_tells_that_it_lives(
    factory: Factory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scheduler, "FIRST_PAUSE_S", 0.001)
    stop, seen = threading.Event(), []

    def look(_factory: Factory) -> None:
        with factory.database.read() as stores:
            seen.append({one.kind for one in stores.processes.all()})
        if SCHEDULER not in seen[-1]:
            raise FileNotFoundError("sky.json")
        stop.set()

    monkeypatch.setattr(scheduler, "look_for_due_work", look)
    run_scheduler(factory, stop)
    assert seen[-1] == {SCHEDULER}


@pytest.mark.long
def test_an_antenna_that_dies_and_returns_spoils_no_other_and_one_that_is_dead_is_told(
    make: Make, years: Spectra
) -> None:
    """An antenna that goes on sending spectra without sky was no lost path: nobody heard of it."""
    time_unix, antenna = years.time_unix, years.antenna
    away = (time_unix > at("2015-03-01")) & (time_unix < at("2015-08-01"))
    stays = (antenna == 4) & (time_unix > at("2015-10-01")) & (time_unix < at("2016-01-20"))
    is_dead = (away & (antenna == 1)) | stays
    is_late = (time_unix > at("2015-09-01")) & (time_unix < at("2016-01-01"))
    spectra = replace(
        years,
        power=np.where(is_dead[:, None], 1e-4 * years.power, years.power),
        time_unix=np.where(is_late, time_unix + DAY_S, time_unix),  # a clock that is a day ahead for months
    ).select(~(away & (antenna == 2)))
    factory, is_later = make(), time_unix[~(away & (antenna == 2))] > at("2016-01-20")
    pass_nights(factory, spectra.select(~is_later))
    for dipole in "XY":
        for number, fewest in ((1, 70), (2, 70), (3, 140)):
            before, after = (c_in_effect(factory, Scope("CS002", number, dipole), f"{y}-06-01") for y in (2014, 2015))
            assert before is not None
            assert after is not None
            assert after[2] >= fewest, "events of the year"
            assert abs(after[0] - before[0]) < 4 * np.hypot(before[1], after[1])
    ((state, kind, sentence),) = tell_alarms(factory)
    assert (state, kind) == ("open", "lost_path")
    assert sentence.startswith("2 paths of CS002: no spectrum that sees the sky since 2015-09-30")
    pass_nights(factory, spectra.select(is_later))
    assert [(state, kind) for state, kind, _ in tell_alarms(factory)] == [("ended", "lost_path")], "it returned"


@pytest.mark.long
def test_data_two_years_late_get_versions_of_their_own_and_become_what_drift_is_held_against(
    make: Make, years: Spectra
) -> None:
    factory, path = make(gate_coverage=0.0), Scope("CS002", 3, "Y")
    shifted = replace(years, time_unix=years.time_unix + 365 * DAY_S)
    is_new = (shifted.time_unix >= at("2016-01-01")) & (shifted.time_unix < at("2017-01-01"))
    pass_nights(factory, shifted.select(is_new))
    newer = c_in_effect(factory, path, "2016-06-01")
    pass_nights(factory, years.select(years.time_unix < at("2015-01-01")))
    later = c_in_effect(factory, path, "2016-06-01")
    assert newer is not None
    assert later is not None
    assert abs(later[0] - newer[0]) < newer[1], "what is in effect for later years moves within its error"
    assert later[1] < newer[1], "which another year of the same hardware makes smaller"
    assert c_in_effect(factory, path, "2014-06-01") is not None
    assert c_in_effect(factory, path, "2015-06-01") is None, "a year without data has no version of its own"
    with factory.database.read() as stores:
        reference = stores.versions.get(find_references(stores, factory.instrument, "CS002")[path])
        months = list(factory.drift.series(path).months)
    assert reference.since == parse_instant("", "2014-01-01")
    assert {parse_instant("", "2014-03-01"), parse_instant("", "2016-03-01")} <= {one.month for one in months}
    assert not [one for one in months if at("2015-01-01") <= one.month / 1e6 < at("2016-01-01")]
    assert tell_alarms(factory) == [], "no step over the gap"


@pytest.mark.long
def test_a_clock_that_is_an_hour_ahead_for_months_is_named_by_the_night(make: Make, years: Spectra) -> None:
    is_ahead = (years.time_unix > at("2015-03-01")) & (years.time_unix < at("2015-08-01"))
    jumped = replace(years, time_unix=np.where(is_ahead, years.time_unix + 3600.0, years.time_unix))
    of_year = (jumped.time_unix >= at("2015-01-01")) & (jumped.time_unix < at("2016-01-01")) & (jumped.antenna < 3)
    factory = make(nightly_investigations=True)
    pass_nights(factory, jumped.select(of_year))
    (told,) = factory.investigations.news()
    assert told.newest.report["findings"][0]["cause"] == "lst_offset"


TIME_UNIX = 1_400_000_000.0


@pytest.fixture
def filled(factory: Factory) -> Factory:
    """A service with an event of one antenna of each of its two stations."""
    add_spectra(factory, flat_spectra(*[("a", TIME_UNIX, station, 0, "X") for station in ("CS001", "CS002")]))
    return factory


@pytest.fixture
def rewired(filled: Factory, instrument_file: Path, tmp_path: Path) -> Iterator[Factory]:
    """The same service after an antenna of CS001 got another cable on record."""
    content = json.loads(instrument_file.read_text())
    content["cables"]["50m"] = [0.7] * len(content["frequency_mhz"])
    content["antennas"][0]["cable"] = "50m"
    (tmp_path / "rewired.json").write_text(json.dumps(content))
    with like(filled, instrument=str(tmp_path / "rewired.json")) as made:
        yield made


def stations_of(factory: Factory, numbers: list[int]) -> list[str | None]:
    """Whose refits some jobs are, None for the array."""
    return sorted((get_job(factory, number).request["station"] for number in numbers), key=str)


def test_a_cable_of_one_station_called_for_the_refits_of_all(filled: Factory, rewired: Factory) -> None:
    assert stations_of(filled, filled.due.enqueue()) == ["CS001", "CS001", "CS002", "CS002", None]
    with filled.database.engine.begin() as connection:
        connection.exec_driver_sql("UPDATE job_part SET state = 'done', ended_us = 0")
    assert stations_of(rewired, rewired.due.enqueue()) == ["CS001", "CS001", None]
    assert rewired.due.enqueue() == []


def test_work_given_up_for_another_instrument_is_due_again_at_once(filled: Factory, rewired: Factory) -> None:
    """The name of what CS002 needs is what it was: giving it up must not count as a failure with its pause."""
    filled.due.enqueue()
    assert stations_of(rewired, rewired.due.enqueue()) == ["CS001", "CS001", "CS002", "CS002", None]
    assert rewired.due.enqueue() == []


def test_failed_work_is_looked_at_again_by_day_once_its_pause_is_over(filled: Factory, clock: Clock) -> None:
    assert not filled.due.has_failed_lately()
    filled.due.enqueue()
    ended = clock.now
    with filled.database.engine.begin() as connection:
        connection.exec_driver_sql(f"UPDATE job_part SET state = 'failed', error = 'x', ended_us = {ended}")  # noqa: S608
    assert not filled.due.has_failed_lately(), "its pause has begun"
    assert look_again(filled) == []
    clock.now = ended + PAUSE_US
    assert filled.due.has_failed_lately()
    assert stations_of(filled, look_again(filled)) == ["CS001", "CS001", "CS002", "CS002", None]


def shift(factory: Factory, years: int) -> list[int]:
    """Store an event so many years after that of the service; the years whose refits are due then."""
    add_spectra(factory, flat_spectra((f"{years} years", TIME_UNIX + years * 365.25 * 86_400, "CS001", 0, "X")))
    due = [get_job(factory, number).request["since"] for number in factory.due.enqueue()]
    with factory.database.engine.begin() as connection:
        connection.exec_driver_sql("UPDATE job_part SET state = 'done', ended_us = 0")
    return sorted({datetime.fromtimestamp(since / 1e6, UTC).year for since in due})


def test_a_year_without_data_calls_for_nothing_and_late_data_for_their_own_year(filled: Factory) -> None:
    assert shift(filled, 3) == [2014, 2017]
    assert shift(filled, -2) == [2012], "two years late: the refits of later years stand"
    assert filled.due.enqueue() == []


def test_a_night_waits_for_a_campaign_that_is_being_ingested_and_not_for_ever(
    filled: Factory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half of a year was fitted while it arrived, and all of it a minute later."""
    stop, waited = threading.Event(), []
    monkeypatch.setattr(stop, "wait", waited.append)
    wait_for_quiet(filled, stop)
    assert waited == [], "nothing has ever arrived over HTTP"
    with filled.database.write() as stores:
        stores.spectra.arrivals.keep_receipt("a" * 64, 1, [], filled.clock() - 100_000_000)
    wait_for_quiet(filled, stop)
    assert waited == pytest.approx([500.0] * 6, abs=0.1), "six times, where more arrives all the time"
    stop.set()
    monkeypatch.undo()
    wait_for_quiet(filled, stop)


def test_a_scheduler_that_starts_while_a_campaign_arrives_waits_as_the_night_does(
    filled: Factory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A restart in the middle of an ingest fitted half of a year."""
    stop, seen = threading.Event(), list[str]()
    monkeypatch.setattr(scheduler, "wait_for_quiet", lambda *_: seen.append("waited"))
    monkeypatch.setattr(scheduler, "look_for_due_work", lambda _: (seen.append("looked"), stop.set()))
    run_scheduler(filled, stop)
    assert seen == ["waited", "looked"]
