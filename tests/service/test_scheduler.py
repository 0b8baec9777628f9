from __future__ import annotations

import threading

import pytest

from service import scheduler
from service.factory import Factory
from service.scheduler import persist, run_scheduler
from service.storage.processes import SCHEDULER


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
