"""Many independent trials on both cores, and the statistics that are told of them."""

from __future__ import annotations

import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from scipy.optimize import minimize
from scipy.stats import binomtest, norm
from threadpoolctl import threadpool_limits

from lbacal_core.grids import Floats

Task = TypeVar("Task")
Outcome = TypeVar("Outcome")


def run_trials(trial: Callable[[Task], Outcome], tasks: Sequence[Task], name: str) -> list[Outcome]:
    """Do every task, on both cores where there are some to do, and say how far it is."""
    if len(tasks) < 4:
        with threadpool_limits(1):
            return [trial(task) for task in tasks]
    # Children are forked once and keep what they have built; linear algebra of one thread each.
    with multiprocessing.get_context("fork").Pool(min(2, os.cpu_count() or 1), _one_thread) as pool:
        return list(_tell(pool.imap(trial, tasks), len(tasks), name))


def _one_thread() -> None:
    threadpool_limits(1)


def _tell(outcomes: Iterable[Outcome], count: int, name: str) -> Iterable[Outcome]:
    begin = last = time.monotonic()
    for done, outcome in enumerate(outcomes, 1):
        yield outcome
        now = time.monotonic()
        if done == count or now - last > 20:
            left = (now - begin) * (count - done) / done
            print(f"{name}: {done} of {count}, {left:.0f} s left", file=sys.stderr, flush=True)
            last = now


@dataclass(frozen=True)
class Rate:
    """A rate with its 95 % interval (Wilson)."""

    hits: int
    count: int

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper end."""
        if not self.count:
            return 0.0, 1.0
        interval = binomtest(self.hits, self.count).proportion_ci(method="wilson")
        return float(interval.low), float(interval.high)

    def __str__(self) -> str:
        low, high = self.interval
        share = self.hits / max(self.count, 1)
        return f"{self.hits} of {self.count} ({100 * share:.1f} %, {100 * low:.1f}-{100 * high:.1f} %)"

    def is_at_least(self, share: float) -> bool:
        """Whether the interval contains the share or lies above it."""
        return self.interval[1] >= share

    def is_at_most(self, share: float) -> bool:
        """Whether the interval contains the share or lies below it."""
        return self.interval[0] <= share


@dataclass(frozen=True)
class DetectionCurve:
    """P(detected) = Phi((SNR - snr_50) / width), fitted to single trials.

    Attributes
    ----------
    snr_50, width
        The fit.
    draws
        (snr_50, width) of refits to trials drawn again from the fit, shape (draw, 2).
    """

    snr_50: float
    width: float
    draws: Floats

    def snr_at(self, probability: float) -> tuple[float, float, float]:
        """The SNR that is detected with a probability, and its 95 % interval."""
        step = norm.ppf(probability)
        low, high = np.quantile(self.draws[:, 0] + step * self.draws[:, 1], [0.025, 0.975])
        return self.snr_50 + step * self.width, float(low), float(high)

    def probability(self, snr: Floats) -> Floats:
        """Of detection."""
        return np.asarray(norm.cdf((snr - self.snr_50) / self.width))


def fit_detection(snr: Floats, is_detected: Floats, draws: int = 300) -> DetectionCurve:
    """Fit the curve by maximum likelihood; its errors from trials drawn again."""
    best = _fit_normal(snr, is_detected)
    rng = np.random.default_rng(0)
    chance = norm.cdf((snr - best[0]) / best[1])
    again = [_fit_normal(snr, (rng.random(snr.size) < chance).astype(float)) for _ in range(draws)]
    return DetectionCurve(float(best[0]), float(best[1]), np.array(again))


def _fit_normal(snr: Floats, is_detected: Floats) -> Floats:
    sign = np.where(is_detected > 0.5, 1.0, -1.0)

    def cost(place: Floats) -> float:
        middle, log_width = place
        return float(-norm.logcdf(sign * (snr - middle) / np.exp(log_width)).sum())

    found = minimize(cost, (5.5, 0.0), method="Nelder-Mead", bounds=((0.0, 30.0), (-2.0, 3.0)))
    return np.array([found.x[0], np.exp(found.x[1])])
