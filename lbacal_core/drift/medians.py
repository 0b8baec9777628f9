"""What the series of a group have in common in an event: their median."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FEWEST_COMPANIONS = 3
"""The median of fewer series is too much the series itself."""


def median_of_members(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Median of the series of a group at every event, shape (event, mode); NaN where fewer than three are known."""
    median = median_over(values, axis=0)
    median[np.isfinite(values).sum(axis=0) < FEWEST_COMPANIONS] = np.nan
    return median


def median_over(values: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Median of the known values along an axis, NaN where there is none; some times faster than `nanmedian`."""
    ordered = np.sort(np.moveaxis(values, axis, -1), axis=-1)  # NaN last
    count = np.isfinite(ordered).sum(axis=-1, keepdims=True)
    upper, lower = np.minimum(count // 2, values.shape[axis] - 1), np.maximum((count - 1) // 2, 0)
    pair = np.take_along_axis(ordered, np.concatenate([lower, upper], axis=-1), axis=-1)
    return np.asarray(np.where(count[..., 0] > 0, pair.mean(axis=-1), np.nan), dtype=np.float32)
