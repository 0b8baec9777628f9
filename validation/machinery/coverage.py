"""How often a truth lies within the error that is stated, one number a trial and standard deviation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lbacal_core.grids import Floats
from validation.machinery.claims import Asked, Claim, between, claim_mean, claim_rate
from validation.machinery.parts import Row

WITHIN = {1: between(0.60, 0.76), 2: between(0.91, 0.98)}
"""What is asked of the share within one and two standard deviations: 68 and 95 % if errors are normal and right."""


def count_within(name: str, pull: Floats) -> Row:
    """Shares of some numbers within one and two of their standard deviations."""
    return {f"{name}_{k}": float(np.mean(np.abs(pull) < k)) for k in WITHIN}


def claim_coverage(rows: Sequence[Row], name: str, what: str, asked: dict[int, Asked] | None = None) -> list[Claim]:
    """Claims about the mean of `count_within` over trials; `what` is the beginning of the sentence.

    Where a trial has one number, it is within or not, and the interval is that of a rate.
    """
    claims = []
    for k, limits in (asked or WITHIN).items():
        values, text = np.array([row[f"{name}_{k}"] for row in rows]), f"{what} lies within {k} sigma"
        if np.all(np.isin(values, (0.0, 1.0))):
            claims.append(claim_rate(f"{name}_{k}", text, limits, int(values.sum()), values.size))
        else:
            claims.append(claim_mean(f"{name}_{k}", text, limits, values, "%"))
    return claims
