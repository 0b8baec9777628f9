from __future__ import annotations

import json
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest

from service.factory import Factory
from service.scheduler import look_again
from service.storage.jobs import PAUSE_US
from tests.service.conftest import Clock, add_spectra, flat_spectra, like

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
    return sorted((factory.jobs.get(number).request["station"] for number in numbers), key=str)


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
    due = [factory.jobs.get(number).request["since"] for number in factory.due.enqueue()]
    with factory.database.engine.begin() as connection:
        connection.exec_driver_sql("UPDATE job_part SET state = 'done', ended_us = 0")
    return sorted({datetime.fromtimestamp(since / 1e6, UTC).year for since in due})


def test_a_year_without_data_calls_for_nothing_and_late_data_for_their_own_year(filled: Factory) -> None:
    assert shift(filled, 3) == [2014, 2017]
    assert shift(filled, -2) == [2012], "two years late: the refits of later years stand"
    assert filled.due.enqueue() == []
