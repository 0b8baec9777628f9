"""How often a truth lies within the error that is stated, one number a trial and standard deviation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lbacal_core.grids import Floats
from validation.machinery.claims import Found, mean_of, rate_of
from validation.machinery.parts import Row

SIGMAS = (1, 2)


def count_within(name: str, pull: Floats) -> Row:
    """Shares of some numbers within one and two of their standard deviations."""
    return {f"{name}_{k}": float(np.mean(np.abs(pull) < k)) for k in SIGMAS}


def coverage(rows: Sequence[Row], name: str) -> list[Found]:
    """Means of `count_within` over trials; where a trial has one number, which is within or not, rates."""
    figures: list[Found] = []
    for key in (f"{name}_{k}" for k in SIGMAS):
        values = np.array([row[key] for row in rows])
        is_rate = bool(np.all(np.isin(values, (0.0, 1.0))))
        figures.append(rate_of(key, int(values.sum()), values.size) if is_rate else mean_of(key, values, "%"))
    return figures
