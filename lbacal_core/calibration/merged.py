"""Noise constants that the data of a path do not tell apart: what they add together, and why they are merged.

In a flat receiver the noise in front of it and behind it add the same at every frequency: the data determine their
sum. C does not depend on how the constants share it.
"""

from __future__ import annotations

import numpy as np

from lbacal_core.calibration.separable import SeparableSolution
from lbacal_core.curves import MergedConstants
from lbacal_core.grids import Floats
from lbacal_core.intercepts import Intercepts

FLAT = 1e-3
"""Standard deviation over mean of a form along frequency below which it is called flat."""


def describe_merged(solution: SeparableSolution, path: int, terms: Intercepts) -> MergedConstants | None:
    """Which constants of a path are merged, and what they add to the recorded power; None where none are.

    Parameters
    ----------
    terms
        What each constant adds to an intercept.
    """
    merged = np.flatnonzero(solution.is_merged[path])
    names = [terms.names[k] for k in merged.tolist()]
    if merged.size == 0:
        return None
    slope, channels = solution.x[path], solution.x.shape[1]
    # What each constant adds at the output per unit, mean over the channels.
    forms = np.concatenate([terms.front * slope, terms.behind])[merged]
    of_constant = forms.mean(axis=1)
    values = np.concatenate([solution.n[path], solution.q[path]])[merged]
    at = channels + merged
    covariance = solution.covariance[path][np.ix_(at, at)]
    return MergedConstants(
        constants=tuple(names),
        value=float(of_constant @ values),
        sigma=float(np.sqrt(of_constant @ covariance @ of_constant)),
        reason=_reason(names, forms),
    )


def _reason(merged: list[str], forms: Floats) -> str:
    """Why these data do not tell them apart, in one sentence."""
    names = ", ".join(f"N_{name.removeprefix('n_').upper()}" for name in merged)
    spread = forms.std(axis=1) / np.abs(forms.mean(axis=1))
    why = "what they add has nearly the same form along frequency"
    if np.all(spread < FLAT):
        why = "the chain behind them is flat along frequency, so that they add the same in every channel"
    return f"{names} cannot be told apart: {why}; their sum is determined, and C does not depend on how they share it"
