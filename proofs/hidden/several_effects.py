"""Two and three hidden effects at once: all of them should be named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from proofs.hidden.data_sets import LARGEST_CHANGE, DataSet, Planted, correlations, moving_causes
from proofs.machinery.trials import Rate, run_trials

SNR = 10.0
LARGEST_CORRELATION = 0.9
ASKED = 0.85
FIRST_SEED = 300_000


@dataclass(frozen=True)
class Outcome:
    """What was planted, and what was said."""

    planted: Sequence[Planted]
    correlation: float
    verdict: str
    sets: Sequence[Sequence[str]]

    @property
    def are_all_named(self) -> bool:
        """Whether each effect is in the set of a finding of its own."""
        causes = [one.cause for one in self.planted]
        return any(
            all(cause in named for cause, named in zip(causes, chosen, strict=True))
            for chosen in permutations(self.sets, len(causes))
        )


def draw_several(data: DataSet, count: int, rng: np.random.Generator) -> tuple[list[Planted], float] | None:
    """Different causes, their signatures correlated by less than 0.9, each of SNR 10 given the others."""
    causes = rng.choice(moving_causes(), size=count, replace=False)
    drawn = [data.with_snr(data.draw(str(cause), rng), SNR) for cause in causes]
    planted = [one for one in drawn if one is not None]
    if len(planted) < count:
        return None
    information = data.detector.information_together([one.fault for one in planted])
    largest = float(np.abs(np.triu(correlations(information), 1)).max())
    if largest >= LARGEST_CORRELATION:
        return None
    given_others = 1.0 / np.sqrt(np.diag(np.linalg.inv(information)))
    sized = [one.sized(one.fault.size * SNR / float(snr)) for one, snr in zip(planted, given_others, strict=True)]
    for one in sized:
        is_too_large = np.abs(data.detector.template([one.fault])).max() > LARGEST_CHANGE
        if is_too_large or (one.cause == "dipole_swap" and abs(one.fault.size) > 1):
            return None
    return sized, largest


def hide_several(task: tuple[int, int]) -> Outcome:
    """Make data set `number` with `count` effects and ask the finder."""
    number, count = task
    rng = np.random.default_rng([count, number])
    data = DataSet(FIRST_SEED + 10_000 * count + number)
    planted = next(found for _ in range(500) if (found := draw_several(data, count, rng)))
    answer = data.ask([one.fault for one in planted[0]])
    return Outcome(planted[0], planted[1], answer.verdict, answer.sets)


def prove_several(each: int) -> tuple[bool, list[str]]:
    """Pairs and triples, `each` data sets of both."""
    tasks = [(number, count) for count in (2, 3) for number in range(each)]
    outcomes = run_trials(hide_several, tasks, "several effects")
    lines = ["", f"**Several effects at once**, SNR {SNR:g} each given the others, signatures pairwise |r| < 0.9."]
    holds = True
    for count in (2, 3):
        here = [o for o in outcomes if len(o.planted) == count]
        rate = Rate(sum(o.are_all_named for o in here), len(here))
        holds &= rate.is_at_least(ASKED)
        lines.append(f"{count} effects: all named in {rate}; asked {100 * ASKED:g} %.")
    failed = [o for o in outcomes if not o.are_all_named]
    if failed:
        lines += ["", "| planted | largest abs(r) | verdict | named |", "|---|---|---|---|"]
    for o in failed:
        said = "; ".join(" or ".join(names) for names in o.sets)
        what = ", ".join(f"{one.cause} ({one.label})" for one in o.planted)
        lines.append(f"| {what} | {o.correlation:.2f} | {o.verdict} | {said} |")
    return holds, lines
