"""How long works take; those that are compared take turns, so that other work on the machine meets all."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import TypeVar

import numpy as np

Result = TypeVar("Result")
Work = Callable[[], object]


def time_once(work: Callable[[], Result]) -> tuple[Result, float, float]:
    """The result, and the time by the clock and of the processor, s."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = work()
    return result, time.perf_counter() - wall, time.process_time() - cpu


def processor_times(works: Mapping[str, Work], rounds: int = 3) -> dict[str, float]:
    """Shortest processor time of each of some works, s."""
    times = [[time_once(work)[2] for work in works.values()] for _ in range(rounds)]
    return dict(zip(works, np.min(times, axis=0).tolist(), strict=True))


def median_times(works: Mapping[str, Callable[[int], object]], turns: int) -> dict[str, float]:
    """Median time by the clock of each of some works, which take the number of the turn, s; the first turn warms up."""
    times = [[time_once(lambda: work(turn))[1] for work in works.values()] for turn in range(turns)]  # noqa: B023
    return dict(zip(works, np.median(times[1:], axis=0).tolist(), strict=True))
