"""How often a truth lies within the error that is stated, one number a trial and standard deviation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lbacal_core.grids import Floats
from proofs.machinery.claims import Asked, Claim, between, claim_mean
from proofs.machinery.parts import Row

WITHIN = {1: between(0.60, 0.76), 2: between(0.91, 0.98)}
"""What is asked of the share within one and two standard deviations: 68 and 95 % if errors are normal and right."""


def count_within(name: str, pull: Floats) -> Row:
    """Shares of some numbers within one and two of their standard deviations."""
    return {f"{name}_{k}": float(np.mean(np.abs(pull) < k)) for k in WITHIN}


def claim_coverage(rows: Sequence[Row], name: str, what: str, asked: dict[int, Asked] | None = None) -> list[Claim]:
    """Claims about the mean of `count_within` over trials; `what` is the beginning of the sentence."""
    return [
        claim_mean(
            f"{name}_{k}", f"{what} lies within {k} sigma", limits, np.array([r[f"{name}_{k}"] for r in rows]), "%"
        )
        for k, limits in (asked or WITHIN).items()
    ]
