"""Which channels of a curve are good: flags, and channels with interference that the chain is fitted without.

Steady interference in one channel adds to its intercept and to nothing else, so the intercept lies above the one that
the chain and the other channels predict. Interference that comes and goes scatters more than radiometer noise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lbacal_core.calibration.lines import find_free, free_intercepts
from lbacal_core.calibration.separable import SeparableSolution, solve_separable
from lbacal_core.curves.curves import INTERFERENCE, OK, OUTSIDE, UNCERTAIN, MergedConstants
from lbacal_core.grids import Floats
from lbacal_core.instrument.chain import Intercepts
from lbacal_core.linear import solve_symmetric

Booleans = NDArray[np.bool_]

LARGEST_ERROR = 0.5
"""A channel whose C is less certain than this has no value."""
LARGEST_GOOD_ERROR = 0.13
"""The total error of Table 1 of the paper: beyond it a channel's noise alone is larger than all systematic errors."""
LEAST_LIKELY = 0.01
"""Other antennas of a smaller probability flag no channel (docs/decisions/chain-test.md)."""
SMALLEST_BAND = 0.5
"""A curve with values in less than half of its channels determines nothing."""
FURTHEST_OUTLIER = 6.0
"""Standard deviations by which noise does not reach in 1e7 channels."""
MOST_WITH_INTERFERENCE = 0.1
"""Share of the channels. Where more stand out, the chain is wrong and not a channel."""
MEDIAN_OF_NORMAL = 0.6745
"""The median magnitude of a normal variable, in standard deviations."""
SMALLEST_SHARE = 1e-9
"""An intercept of whose information the fit takes all but this share cannot be tested."""


def solve_without_interference(
    slope: Floats, intercept: Floats, information: Floats, terms: Intercepts, solution: SeparableSolution | None = None
) -> tuple[SeparableSolution, Booleans]:
    """Fit the chain to lines, with the intercept of a channel left free where it stands out above all others.

    Parameters
    ----------
    slope, intercept, information
        Those of `Lines`: shape (path, freq) twice, and (path, 2 freq, 2 freq).
    solution
        That with no intercept free, if it is at hand.

    Returns
    -------
    The solution, and which channels have a free intercept, shape (path, freq).
    """
    solution = solution or solve_separable(slope, intercept, information, terms)
    is_free = find_free(information)
    left = information
    at = np.flatnonzero(solution.is_converged & solution.is_identifiable)
    for _ in range(int(MOST_WITH_INTERFERENCE * slope.shape[1])):
        excess = _excess_of_intercepts(solution.take(at), slope[at], intercept[at], left[at], terms, is_free[at])
        channel = np.argmax(excess, axis=1)
        stands_out = excess[np.arange(at.size), channel] > FURTHEST_OUTLIER
        at, channel = at[stands_out], channel[stands_out]
        if at.size == 0:
            break
        is_free[at, channel] = True
        left = free_intercepts(information, is_free)
        solution = solution.exchange(at, solve_separable(slope[at], intercept[at], left[at], terms))
    return solution, is_free


def flag_channels(relative_error: Floats, has_interference: Booleans) -> NDArray[np.str_]:
    """The flag of each channel, shape (path, freq).

    Parameters
    ----------
    relative_error
        Standard deviation of ln C, shape (path, freq); NaN where the fit gave none.
    has_interference
        Shape (path, freq).
    """
    flag = np.full(relative_error.shape, OK, dtype="U12")
    flag[relative_error > LARGEST_GOOD_ERROR] = UNCERTAIN
    flag[has_interference] = INTERFERENCE
    flag[~(relative_error < LARGEST_ERROR)] = OUTSIDE
    return flag


def _excess_of_intercepts(
    solution: SeparableSolution,
    slope: Floats,
    intercept: Floats,
    information: Floats,
    terms: Intercepts,
    is_free: Booleans,
) -> Floats:
    """By how many standard deviations each intercept lies above what all else predicts; shape (path, freq).

    A shift of one measured number, here an intercept, lowers chi^2 by (P r)_f^2 / P_ff, with the residual r and the
    information P that is left once the fit has taken its share. Where the chain as a whole misfits, the median channel
    widens the standard deviation of all.
    """
    paths, channels = slope.shape
    x, before = solution.x, terms.before(solution.n)
    derivative = np.zeros((paths, 2 * channels, channels + len(terms.names)))
    at = np.arange(channels)
    derivative[:, at, at] = 1.0
    derivative[:, channels + at, at] = before
    derivative[:, channels:, channels : channels + len(terms.front)] = x[:, :, None] * terms.front.T
    derivative[:, channels:, channels + len(terms.front) :] = terms.design
    residual = np.concatenate([slope - x, intercept - terms.on_line(x, solution.n, solution.q)], axis=1)
    side = np.matmul(information, derivative)
    normal = np.matmul(derivative.transpose(0, 2, 1), side)
    of_intercept = side[:, channels:]
    taken = np.matmul(of_intercept, solve_symmetric(normal, of_intercept.transpose(0, 2, 1)))
    own = np.einsum("pii->pi", information)[:, channels:]
    left = own - np.einsum("pii->pi", taken)
    pull = np.matmul(information[:, channels:], residual[:, :, None])[:, :, 0]
    is_tested = ~is_free & (left > SMALLEST_SHARE * own)
    excess = np.where(is_tested, pull / np.sqrt(np.where(is_tested, left, 1.0)), 0.0)
    typical = np.median(np.abs(excess), axis=1, keepdims=True) / MEDIAN_OF_NORMAL
    return np.asarray(excess / np.maximum(typical, 1.0))


# Noise constants that the data of a path do not tell apart: what they add together, and why they are merged.
#
# In a flat receiver the noise in front of it and behind it add the same at every frequency: the data determine their
# sum. C does not depend on how the constants share it.

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
