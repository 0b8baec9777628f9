"""What a proof claims, and how its figures decide it: shown, refuted or undecided; or what it measures.

Sentences and limits stand in `validation/claims.toml`. A claim is decided by the interval of its figure. Shown: the
whole interval is within what is asked. Refuted: none of it is. Undecided: it reaches over the limit. Measured: nothing
is asked of the figure, it is stated with its interval.

A claim may be looked at again with every further block of seeds. The k-th look has an interval of the confidence
1 - 0.05 * 6 / (pi^2 k^2): the chances of error of all looks add up to 5 % at most, however long somebody goes on and
whenever they stop (a union bound; spending of the error, Lan and DeMets 1983).
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binom, binomtest, chi2, norm, t

from lbacal_core.grids import Floats

SHOWN, REFUTED, UNDECIDED, MEASURED = "shown", "refuted", "undecided", "measured"
CONFIDENCE = 0.95
CLAIMS = Path(__file__).parents[1] / "claims.toml"

Interval = tuple[float, float]
Bounds = Callable[[float], Interval]
"""The interval of a figure at a confidence."""


def confidence_of_look(k: int) -> float:
    """The confidence of the k-th look, so that the intervals of all looks hold together in 95 %."""
    return 1.0 - (1.0 - CONFIDENCE) * 6.0 / (np.pi * k) ** 2


@dataclass(frozen=True)
class Asked:
    """A sentence, and what is asked of its number: nothing where both limits are None.

    Attributes
    ----------
    changed
        What was asked before, where an earlier record does not tell: a date and words.
    """

    says: str = ""
    at_least: float | None = None
    at_most: float | None = None
    changed: str = ""

    def verdict(self, interval: Interval) -> str:
        """Decide a claim by an interval."""
        if self.at_least is None and self.at_most is None:
            return MEASURED
        low = -np.inf if self.at_least is None else self.at_least
        high = np.inf if self.at_most is None else self.at_most
        if low <= interval[0] and interval[1] <= high:
            return SHOWN
        return REFUTED if interval[1] < low or interval[0] > high else UNDECIDED


@cache
def read_claims(path: Path = CLAIMS) -> dict[str, dict[str, dict[str, Asked]]]:
    """Read the claims: proof, part, key."""
    stored = tomllib.loads(path.read_text(encoding="utf-8"))
    return {
        proof: {part: {key: Asked(**one) for key, one in asked.items()} for part, asked in parts.items()}
        for proof, parts in stored.items()
    }


@dataclass(frozen=True)
class One:
    """A figure of a proof: the number that decides the claim of a key, from n independent trials.

    `%` is the unit of fractions, which are shown times 100.
    """

    key: str
    found: float
    bounds: Bounds
    n: int
    unit: str = ""

    def at(self, confidence: float, asked: Asked) -> tuple[float, Interval]:  # noqa: ARG002  (of the worst figure)
        """The number and its interval."""
        return self.found, self.bounds(confidence)


@dataclass(frozen=True)
class Worst:
    """The figure that is farthest from what is asked, of several that must all meet it.

    Its interval reaches from the worst of the near ends to the worst of the far ends, so that the claim is shown if
    every figure shows it and refuted if one refutes it. The intervals hold together (Bonferroni).
    """

    key: str
    figures: Sequence[Found]
    n: int
    unit: str = ""

    def at(self, confidence: float, asked: Asked) -> tuple[float, Interval]:
        """The number and its interval."""
        of_each = 1.0 - (1.0 - confidence) / len(self.figures)
        found, ends = (np.array(one) for one in zip(*(f.at(of_each, asked) for f in self.figures), strict=True))
        low, high = asked.at_least, asked.at_most
        if low is None or high is None:
            pick = np.max if low is None else np.min
            return float(pick(found)), (float(pick(ends[:, 0])), float(pick(ends[:, 1])))
        distance = np.abs(found - (low + high) / 2)
        refuting = np.array([asked.verdict((a, b)) == REFUTED for a, b in ends])
        if np.any(refuting):
            worst = int(np.argmax(np.where(refuting, distance, -1.0)))
            return float(found[worst]), (float(ends[worst, 0]), float(ends[worst, 1]))
        return float(found[int(np.argmax(distance))]), (float(ends[:, 0].min()), float(ends[:, 1].max()))


Found = One | Worst
"""What decides a claim."""


def rate_interval(hits: int, n: int, confidence: float = CONFIDENCE) -> Interval:
    """The interval of a rate (Wilson); nothing is known of no trials."""
    if not n:
        return 0.0, 1.0
    interval = binomtest(int(hits), n).proportion_ci(confidence, method="wilson")
    return float(interval.low), float(interval.high)


def mean_interval(values: Floats, confidence: float = CONFIDENCE) -> Interval:
    """The interval of a mean (Student's t); the data sets are independent."""
    reach = t.ppf(0.5 + confidence / 2, values.size - 1) * values.std(ddof=1) / values.size**0.5
    return float(values.mean() - reach), float(values.mean() + reach)


def median_interval(values: Floats, confidence: float = CONFIDENCE) -> Interval:
    """The interval of a median, between two of the values (sign test)."""
    ordered, n = np.sort(values), values.size
    rank = max(int(binom.ppf(0.5 - confidence / 2, n, 0.5)) - 1, 0)
    return float(ordered[rank]), float(ordered[n - 1 - rank])


def spread_interval(spread: float, n: int, confidence: float = CONFIDENCE) -> Interval:
    """The interval of a standard deviation (or an r.m.s.) of n draws of a normal distribution."""
    low, high = np.sqrt(n / chi2.ppf([0.5 + confidence / 2, 0.5 - confidence / 2], n))
    return spread * float(low), spread * float(high)


def rate_of(key: str, hits: int, n: int) -> Found:
    return One(key, hits / max(n, 1), partial(rate_interval, hits, n), n, "%")


def mean_of(key: str, values: Floats, unit: str = "") -> Found:
    return One(key, float(values.mean()), partial(mean_interval, values), values.size, unit)


def root_mean_of(key: str, squares: Floats) -> Found:
    """The root of a mean over data sets."""

    def bounds(confidence: float) -> Interval:
        low, high = mean_interval(squares, confidence)
        return max(low, 0.0) ** 0.5, high**0.5

    return One(key, float(squares.mean()) ** 0.5, bounds, squares.size)


def spread_of(key: str, spread: float, n: int) -> Found:
    return One(key, spread, partial(spread_interval, spread, n), n)


def measured(key: str, value: float, sigma: float, n: int) -> Found:
    """A number with a standard deviation of its own."""

    def bounds(confidence: float) -> Interval:
        reach = float(norm.ppf(0.5 + confidence / 2)) * sigma
        return value - reach, value + reach

    return One(key, value, bounds, n)


def exactly(key: str, found: float, unit: str = "", n: int = 1) -> Found:
    """A number in which there is no chance; n says how many cases were compared."""
    return One(key, found, lambda _: (found, found), n, unit)


def worst_of(figures: Iterable[Found], n: int, unit: str = "") -> Found:
    each = tuple(figures)
    return Worst(each[0].key, each, n, unit)


SIGMAS = (1, 2)


def count_within(name: str, pull: Floats) -> dict[str, Any]:
    """Shares of some numbers within one and two of their standard deviations: how often an error holds the truth."""
    return {f"{name}_{k}": float(np.mean(np.abs(pull) < k)) for k in SIGMAS}


def coverage(rows: Sequence[Mapping[str, Any]], name: str) -> list[Found]:
    """Means of `count_within` over trials; where a trial has one number, which is within or not, rates."""
    figures: list[Found] = []
    for key in (f"{name}_{k}" for k in SIGMAS):
        values = np.array([row[key] for row in rows])
        is_rate = bool(np.all(np.isin(values, (0.0, 1.0))))
        figures.append(rate_of(key, int(values.sum()), values.size) if is_rate else mean_of(key, values, "%"))
    return figures


@dataclass(frozen=True)
class Claim:
    """One claim and what was found, as it is stored.

    Attributes
    ----------
    key
        The name of the claim inside its part of a proof; texts that quote the figure refer to it.
    interval
        The interval of the look that decides; equal to the figure where nothing is drawn by chance.
    """

    key: str
    asked: Asked
    found: float
    interval: Interval
    n: int
    unit: str = ""

    def __post_init__(self) -> None:
        if not np.all(np.isfinite([self.found, *self.interval])):
            raise ValueError(f"claim {self.key}: figure and interval must be finite")
        if self.interval[0] > self.interval[1]:
            raise ValueError(f"claim {self.key}: the interval {self.interval} ends before it begins")

    @property
    def verdict(self) -> str:
        """Shown, refuted or undecided; measured where nothing is asked."""
        return self.asked.verdict(self.interval) if self.n > 0 else UNDECIDED

    def as_dict(self) -> dict[str, Any]:
        """Describe the claim as it is stored."""
        asked = {name: value for name, value in asdict(self.asked).items() if value not in (None, "")}
        rest = {"found": self.found, "interval": list(self.interval), "n": self.n, "unit": self.unit}
        return {"key": self.key, **asked, **rest, "verdict": self.verdict}

    @classmethod
    def from_dict(cls, stored: dict[str, Any]) -> Claim:
        """Read what was stored; the verdict is decided again."""
        asked = Asked(**{name: stored[name] for name in asdict(Asked()) if name in stored})
        return cls(stored["key"], asked, stored["found"], tuple(stored["interval"]), stored["n"], stored["unit"])

    @property
    def words_asked(self) -> str:
        """The limit in words."""
        low, high = self.asked.at_least, self.asked.at_most
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


def decide(figures: Sequence[Found], asked: dict[str, Asked], look: int = 1) -> tuple[Claim, ...]:
    """The claims of figures at their k-th look; raises ValueError where `claims.toml` has no sentence for one."""
    without = [figure.key for figure in figures if figure.key not in asked]
    if without:
        raise ValueError(f"{CLAIMS.name} has no sentence for {', '.join(without)}: write it there")
    claims = []
    for one in figures:
        found, interval = one.at(confidence_of_look(look), asked[one.key])
        claims.append(Claim(one.key, asked[one.key], found, interval, one.n, one.unit))
    return tuple(claims)
