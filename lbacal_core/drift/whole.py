"""What all paths share: the trend of the whole, beside its scatter from year to year.

The mean of many paths has no companions to be compared with. It moves by about 5 % from year to year (Mulrey et al.
2019, section 4), and a slope must be told from that: the season is removed, the residual means of whole years are
fitted with a line, and the error of its slope is their own scatter about it, by Student's t with two degrees of freedom
fewer than there are years. With 5 % a year and seven years that is about 1 % a year: no method can do better.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from lbacal_core.drift.monthly import find_months
from lbacal_core.drift.terms import SLOPE, YEAR_S, smooth_columns
from lbacal_core.grids import Floats

FEWEST_YEARS = 3
FEWEST_MONTHS = 6
"""Months that make a year, from the first event on."""
ONE_SIGMA, LIMIT = 0.8413447460685429, 0.975


@dataclass(frozen=True)
class Whole:
    """The trend of what all paths share; changes of ln C, one entry a mode.

    Attributes
    ----------
    slope, sigma, limit
        A year; the standard deviation holds 68.3 % and the limit 95 % by Student's t.
    scatter
        Standard deviation of a year about the line.
    years
        How many there are.
    p_value
        Probability of so large a slope without one, of the gain.
    middle_unix
        Mean time of the years, s UTC.
    season
        Coefficients of the columns of `smooth_columns`, shape (4, mode).
    """

    slope: Floats
    sigma: Floats
    limit: Floats
    scatter: Floats
    years: int
    p_value: float
    middle_unix: float
    season: Floats


def measure_whole(time_unix: Floats, values: Floats) -> Whole | None:
    """Fit the trend; None where there are fewer than three years.

    Parameters
    ----------
    values
        What all paths share, shape (event, mode), NaN where unknown.
    """
    is_known = np.isfinite(values[:, 0])
    time_unix, values = time_unix[is_known], values[is_known]
    if time_unix.size == 0:
        return None
    _, starts = find_months(time_unix)
    events = np.diff(np.append(starts, time_unix.size))[:, None]
    y = np.add.reduceat(values, starts, axis=0, dtype=float) / events
    smooth = np.add.reduceat(smooth_columns(time_unix, time_unix[0]), starts, axis=0) / events
    year = np.floor(smooth[:, SLOPE]).astype(int)
    kept = [number for number in range(int(year.max()) + 1) if np.sum(year == number) >= FEWEST_MONTHS]
    if len(kept) < FEWEST_YEARS:
        return None
    is_of = (year[:, None] == np.arange(int(year.max()) + 1)).astype(float)
    columns = np.hstack([is_of, smooth[:, 1:SLOPE], smooth[:, SLOPE, None]])
    season = np.linalg.lstsq(columns, y, rcond=None)[0][is_of.shape[1] : -1]
    mean = is_of.T[kept] / is_of.T[kept].sum(axis=1, keepdims=True)
    level, when = mean @ (y - smooth[:, 1:SLOPE] @ season), mean @ smooth[:, SLOPE]
    middle_unix = float(time_unix[0] + when.mean() * YEAR_S)
    when = when - when.mean()
    slope = when @ level / np.sum(when**2)
    left = level - level.mean(axis=0) - when[:, None] * slope
    freedom = len(kept) - 2
    scatter = np.sqrt(np.sum(left**2, axis=0) / freedom)
    error = scatter / np.sqrt(np.sum(when**2))
    p_value = 2.0 * float(stats.t.sf(abs(slope[0]) / max(error[0], 1e-300), freedom))
    sigma, limit = (error * stats.t.ppf(q, freedom) for q in (ONE_SIGMA, LIMIT))
    return Whole(slope, sigma, limit, scatter, len(kept), p_value, middle_unix, season)
