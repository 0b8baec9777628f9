"""Paths that do not receive as the others of their station do: dead, deaf, oscillating, clipped, outlying.

Every path is compared with the median of its station's polarisation, each through its own cable: by its level, by its
spectrum, and by how much of the others' change with time it follows. Thresholds are wide of what working antennas do:
gains of a station's receivers spread by 3-5 % (its gain tables), shapes by less.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.audit.finding import WRONG, Line
from lbacal_core.audit.station import AuditedStation, spread
from lbacal_core.grids import Floats

DEAD_LEVEL = -np.log(10.0)
"""A path with less than a tenth of the others' power sends nothing of the sky."""
DEAF_SHARE, DEAF_LEVEL = 0.6, -0.25
"""A deaf path follows less than this of the others' spectrum or of their change with time, and lies lower."""
PEAK, PEAK_SHARE = np.log(2.0), 1 / 3
"""An oscillating path exceeds its own level by a factor 2 in fewer than a third of its channels, or is loud."""
LOUD = np.log(3.0)
CLIPPED_SHARE = 0.7
"""A clipped path is loud and follows less than this of the others' change with time."""
OUTLYING_SIGMA, OUTLYING = 6.0, 0.2
"""An outlying path is this many robust standard deviations and this factor from the others."""
SMALLEST_SPREAD = 0.01
CLASS = 3
"""Antennas of one cable name that are compared among themselves; of a rarer name, with all."""
MEASURABLE = 0.03
"""Change with time of the median path, r.m.s. of ln P, that a comparison needs."""


@dataclass(frozen=True)
class Comparison:
    """Each path against the median of its polarisation, shape (antenna, dipole) and for the profile (..., freq).

    Attributes
    ----------
    level, profile
        Median of ln P over the others' in time and frequency, and what is left of it along frequency.
    follows
        Slope of a path's change with time on that of the median path; NaN where it does not change enough.
    shares
        Slope of a path's spectrum on the others', both about their means: 1 for a working path, 0 for a flat one.
    """

    level: Floats
    profile: Floats
    follows: Floats
    shares: Floats


def compare_paths(station: AuditedStation) -> Comparison:
    """Compare every path with the median of its polarisation and cable name."""
    power = station.before_cable()
    typical = np.nanmedian(power, axis=0)
    difference = np.nanmedian(power - typical, axis=2)
    for cable in np.unique(station.cables):  # noise behind long cables lifts them where the sky is weak
        rows = station.cables == cable
        if rows.sum() >= CLASS:
            difference[rows] -= np.nanmedian(difference[rows], axis=0)
    level = np.nanmedian(difference, axis=-1)
    seen = typical.mean(axis=-1)
    change = seen - seen.mean(axis=-1, keepdims=True)
    own = np.nanmean(power, axis=-1)
    own = np.where(np.isfinite(own), own, np.nan)
    own = own - np.nanmean(own, axis=-1, keepdims=True)
    is_known = np.isfinite(own)
    variance = np.sum(np.where(is_known, change**2, 0.0), axis=-1)
    follows = np.sum(np.where(is_known, own, 0.0) * change, axis=-1) / np.where(variance > 0, variance, 1.0)
    follows[:, change.std(axis=-1) < MEASURABLE] = np.nan
    shape = np.median(typical, axis=1) + np.log(station.loss).mean(axis=0)
    shape = shape - shape.mean(axis=-1, keepdims=True)
    contrast = np.sum(shape**2, axis=-1)
    shares = 1.0 + np.sum((difference - level[..., None]) * shape, axis=-1) / np.where(contrast > 0, contrast, 1.0)
    return Comparison(level, difference - level[..., None], follows, shares)


def find_ill_paths(station: AuditedStation, comparison: Comparison) -> tuple[list[Line], NDArray[np.bool_]]:
    """Name the paths that do not work; shape (antenna, dipole) of those that must not count among the others."""
    lines = []
    is_ill = np.zeros(comparison.level.shape, dtype=bool)
    names, counts = np.unique(station.cables, return_counts=True)
    is_comparable = counts[np.searchsorted(names, station.cables)] >= CLASS
    level_spread = np.maximum(spread(comparison.level), SMALLEST_SPREAD)
    rms = np.sqrt(np.mean(comparison.profile**2, axis=-1))
    typical_rms = np.maximum(np.nanmedian(rms, axis=0), SMALLEST_SPREAD)
    centre = np.nanmedian(comparison.level, axis=0)
    for a, d in np.ndindex(*comparison.level.shape):
        level = comparison.level[a, d] - centre[d]
        if not np.isfinite(level):
            continue
        sigma, shape_ratio = float(level / level_spread[d]), float(rms[a, d] / typical_rms[d])
        kind = _name(comparison, a, d, float(level), sigma, shape_ratio)
        if kind is None or (kind == "outlying" and not is_comparable[a]):
            continue
        is_ill[a, d] = True
        lines.append(
            Line(
                check=kind,
                verdict=WRONG,
                station=station.name,
                sentence=f"antenna {station.antennas[a]} {station.dipoles[d]} {_SENTENCES[kind]}: "
                f"{10 / np.log(10) * level:+.1f} dB from the others",
                antennas=(int(station.antennas[a]),),
                dipole=station.dipoles[d],
                value=10 / np.log(10) * level,
                unit="dB",
            )
        )
    return lines, is_ill


_SENTENCES = {
    "dead": "is dead (a tenth of the others' power at most)",
    "deaf": "is deaf (its receiver works, its antenna does not)",
    "oscillating": "oscillates (strong in part of the band)",
    "clipped": "is clipped (loud, and follows the others' change too little)",
    "outlying": "lies outside what the others do",
}


def _name(comparison: Comparison, a: int, d: int, level: float, sigma: float, shape_ratio: float) -> str | None:
    """The first kind whose description a path meets, or None."""
    follows = float(np.nan_to_num(comparison.follows[a, d], nan=1.0))
    receives = min(float(comparison.shares[a, d]), follows)
    profile = comparison.profile[a, d]
    is_far = abs(sigma) > OUTLYING_SIGMA
    is_peaked = profile.max() > PEAK and np.mean(profile > PEAK / 2) < PEAK_SHARE
    is_odd = shape_ratio > OUTLYING_SIGMA and np.sqrt(np.mean(profile**2)) > OUTLYING / 2
    kinds = {
        "dead": level < DEAD_LEVEL,
        "deaf": level < DEAF_LEVEL and is_far and receives < DEAF_SHARE,
        "clipped": level > LOUD and follows < CLIPPED_SHARE,
        "oscillating": level > LOUD or is_peaked,
        "outlying": (abs(level) > OUTLYING and is_far) or is_odd,
    }
    return next((kind for kind, is_met in kinds.items() if is_met), None)
