"""Two and three hidden effects at once: all of them should be named."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

import numpy as np

from validation.hidden.data_sets import LARGEST_CHANGE, DataSet, Planted, correlations, moving_causes
from validation.machinery.claims import Found, rate_of
from validation.machinery.parts import Part, Row

SNR = 10.0
LARGEST_CORRELATION = 0.9
FIRST_SEED = 300_000


def are_all_named(causes: Sequence[str], sets: Sequence[Sequence[str]]) -> bool:
    """Whether each effect is in the set of a finding of its own."""
    return any(
        all(cause in named for cause, named in zip(causes, chosen, strict=True))
        for chosen in permutations(sets, len(causes))
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


def hide_several(number: int, count: int) -> Row:
    """Make data set `number` with `count` effects and ask the finder."""
    rng = np.random.default_rng([count, number])
    data = DataSet(FIRST_SEED + 10_000 * count + number)
    planted, correlation = next(found for _ in range(500) if (found := draw_several(data, count, rng)))
    answer = data.ask([one.fault for one in planted])
    return {
        "planted": [[one.cause, one.label] for one in planted],
        "correlation": round(correlation, 4),
        "verdict": answer.verdict,
        "sets": answer.sets,
        "are_all_named": are_all_named([one.cause for one in planted], answer.sets),
    }


def try_several(seed: int) -> Row:
    return hide_several(seed, 2 + seed % 2)


def judge(rows: Sequence[Row]) -> list[Found]:
    claims = []
    for key, count in (("two", 2), ("three", 3)):
        here = [row for row in rows if len(row["planted"]) == count]
        claims.append(rate_of(key, sum(row["are_all_named"] for row in here), len(here)))
    return claims


PARTS = (Part("several", try_several, judge, 40, headlines=("two",)),)
