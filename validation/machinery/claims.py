"""What a proof claims, and how the figures decide it: shown, refuted or undecided; or what it measures.

A claim is decided by its 95 % interval against what is asked. Shown: the whole interval is within what is asked.
Refuted: none of it is. Undecided: the interval reaches over the limit, or the data sets had been seen before.
Measured: nothing is asked of the figure, it is stated with its interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from scipy.stats import binomtest, chi2, t

from lbacal_core.grids import Floats

SHOWN, REFUTED, UNDECIDED, MEASURED = "shown", "refuted", "undecided", "measured"
CONFIDENCE = 0.95

Interval = tuple[float, float]


@dataclass(frozen=True)
class Asked:
    """What is asked of a number: to be at least `low` and at most `high`; nothing where both are None."""

    low: float | None = None
    high: float | None = None

    def verdict(self, interval: Interval) -> str:
        """What an interval says of it."""
        if self.low is None and self.high is None:
            return MEASURED
        low = -np.inf if self.low is None else self.low
        high = np.inf if self.high is None else self.high
        if low <= interval[0] and interval[1] <= high:
            return SHOWN
        return REFUTED if interval[1] < low or interval[0] > high else UNDECIDED


MEASUREMENT = Asked()
"""A number that a proof states, and that nobody gave a limit."""


def at_least(low: float) -> Asked:
    """Ask for a number that is not smaller."""
    return Asked(low, None)


def at_most(high: float) -> Asked:
    """Ask for a number that is not larger."""
    return Asked(None, high)


def between(low: float, high: float) -> Asked:
    """Ask for a number in a range."""
    return Asked(low, high)


@dataclass(frozen=True)
class Claim:
    """One claim and what was found.

    Attributes
    ----------
    key
        The name of the claim inside its part of a proof; texts that quote the figure refer to it.
    claim
        A sentence.
    found, interval
        The figure and its 95 % interval; equal to the figure where nothing is drawn by chance.
    n
        Independent trials behind the figure.
    unit
        `%` for fractions, which are shown times 100.
    is_fresh
        Whether the data sets had never been seen when the code was written.
    """

    key: str
    claim: str
    asked: Asked
    found: float
    interval: Interval
    n: int
    unit: str = ""
    is_fresh: bool = True

    def __post_init__(self) -> None:
        if not np.all(np.isfinite([self.found, *self.interval])):
            raise ValueError(f"claim {self.key}: figure and interval must be finite")
        if self.interval[0] > self.interval[1]:
            raise ValueError(f"claim {self.key}: the interval {self.interval} ends before it begins")

    @property
    def verdict(self) -> str:
        """Shown, refuted or undecided; measured where nothing is asked."""
        return self.asked.verdict(self.interval) if self.is_fresh and self.n > 0 else UNDECIDED

    def as_dict(self) -> dict[str, Any]:
        """As stored."""
        return {
            "key": self.key, "claim": self.claim, "asked": [self.asked.low, self.asked.high], "found": self.found,
            "interval": list(self.interval), "n": self.n, "unit": self.unit, "is_fresh": self.is_fresh,
            "verdict": self.verdict,
        }  # fmt: skip

    @classmethod
    def from_dict(cls, stored: dict[str, Any]) -> Claim:
        """Read what was stored; the verdict is decided again."""
        names = {field.name for field in fields(cls)}
        values = {name: value for name, value in stored.items() if name in names}
        return cls(**values | {"asked": Asked(*stored["asked"]), "interval": tuple(stored["interval"])})

    def seen_before(self) -> Claim:
        """The same claim of data sets that had been seen before: it decides nothing."""
        return replace(self, is_fresh=False)

    @property
    def words_asked(self) -> str:
        """What is asked, in words."""
        low, high = self.asked.low, self.asked.high
        if low is None and high is None:
            return "nothing"
        if low is None or high is None:
            return f">= {self._number(low)}" if low is not None else f"<= {self._number(high or 0.0)}"
        return f"{self._number(low, has_unit=False)} to {self._number(high)}"

    @property
    def words_found(self) -> str:
        """The figure with its interval, in words."""
        low, high = self.interval
        if low == high == self.found:
            return self._number(self.found)
        ends = f"{self._number(low, has_unit=False)} to {self._number(high, has_unit=False)}"
        return f"{self._number(self.found)} ({ends})"

    def _number(self, value: float, *, has_unit: bool = True) -> str:
        shown = 100 * value if self.unit == "%" else value
        digits = f"{shown:.3g}" if abs(shown) < 1000 else f"{shown:.0f}"
        return f"{digits} {self.unit}" if self.unit and has_unit else digits


def confidence_of_each(count: int) -> float:
    """Confidence of each of several intervals, so that all of them hold together in 95 % (Bonferroni)."""
    return 1.0 - (1.0 - CONFIDENCE) / count


def rate_interval(hits: int, n: int, confidence: float = CONFIDENCE) -> Interval:
    """The interval of a rate (Wilson)."""
    if not n:
        return 0.0, 1.0
    interval = binomtest(hits, n).proportion_ci(confidence, method="wilson")
    return float(interval.low), float(interval.high)


def mean_interval(values: Floats, confidence: float = CONFIDENCE) -> Interval:
    """The interval of a mean (Student's t); the data sets are independent."""
    reach = t.ppf(0.5 + confidence / 2, values.size - 1) * values.std(ddof=1) / values.size**0.5
    return float(values.mean() - reach), float(values.mean() + reach)


def median_interval(values: Floats) -> Interval:
    """The 95 % interval of a median, between two of the values (sign test)."""
    ordered, n = np.sort(values), values.size
    rank = max(int(np.floor(n / 2 - 0.98 * n**0.5)), 0)  # normal approximation of the binomial
    return float(ordered[rank]), float(ordered[n - 1 - rank])


def spread_interval(spread: float, n: int, confidence: float = CONFIDENCE) -> Interval:
    """The interval of a standard deviation (or an r.m.s.) of n draws of a normal distribution."""
    low, high = np.sqrt(n / chi2.ppf([0.5 + confidence / 2, 0.5 - confidence / 2], n))
    return spread * float(low), spread * float(high)


def claim_rate(key: str, claim: str, asked: Asked, hits: int, n: int) -> Claim:
    """A claim about a rate."""
    return Claim(key, claim, asked, hits / max(n, 1), rate_interval(hits, n), n, "%")


def claim_mean(key: str, claim: str, asked: Asked, values: Floats, unit: str = "") -> Claim:
    """A claim about a mean over data sets."""
    return Claim(key, claim, asked, float(values.mean()), mean_interval(values), values.size, unit)


def claim_exact(key: str, claim: str, asked: Asked, found: float, unit: str = "", n: int = 1) -> Claim:
    """A claim about a number in which there is no chance; n says how many cases were compared."""
    return Claim(key, claim, asked, found, (found, found), n, unit)


def claim_worst(key: str, claim: str, asked: Asked, found: Sequence[float], intervals: Sequence[Interval], n: int,
                unit: str = "") -> Claim:  # fmt: skip
    """A claim that every one of several figures must meet: the figure that is farthest from what is asked.

    Its interval reaches from the worst of the near ends to the worst of the far ends, so that the claim is shown if
    every figure shows it and refuted if one refutes it. The intervals should hold together (`confidence_of_each`).
    """
    ends = np.array(intervals)
    if asked.low is not None and asked.high is not None:
        distance = np.abs(np.array(found) - (asked.low + asked.high) / 2)
        refuting = np.array([asked.verdict(one) == REFUTED for one in intervals])
        if np.any(refuting):
            worst = int(np.argmax(np.where(refuting, distance, -1.0)))
            return Claim(key, claim, asked, found[worst], intervals[worst], n, unit)
        whole = float(ends[:, 0].min()), float(ends[:, 1].max())
        return Claim(key, claim, asked, found[int(np.argmax(distance))], whole, n, unit)
    pick = np.min if asked.low is not None else np.max
    return Claim(key, claim, asked, float(pick(found)), (float(pick(ends[:, 0])), float(pick(ends[:, 1]))), n, unit)
