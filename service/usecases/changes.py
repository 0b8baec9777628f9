"""A change of C in words: in the mean over the band, as a tilt, as a curvature, and where along frequency each is felt.

A change is found by all three together, and any of them may carry it. The most significant is told first, then the mean
and what else is plain. Tilt and curvature are the Legendre polynomials 1 and 2 over the band
(`lbacal_core.drift.events`): 1 at its top, where the bottom has -1 and 1, and the middle of the curvature -1/2.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lbacal_core.errors import write_change, write_percent
from lbacal_core.grids import Floats

PLAIN, BESIDE = 3.0, 1.0 / 3.0
"""A part beside the most significant one is told from so many standard deviations on, and from this share of it."""
TILT = "tilt"
Shape = Mapping[str, Mapping[str, float]]
"""Tilt and curvature of ln C by their names, each a `value` with its `sigma`."""


@dataclass(frozen=True)
class _Part:
    significance: float
    words: str


def drop_noise(report: dict[str, Any]) -> dict[str, Any]:
    """The report of a watch without members of changes that are below its threshold.

    Among few antennas the median of a station follows the step of one, and the search finds another one stepping the
    other way. Once the medians are settled, what is left of that is noise.
    """
    threshold = report["threshold_sigma"]
    for change in report["changes"]:
        if not change["is_known"]:
            first, *others = change["members"]
            change["members"] = [first, *(one for one in others if one["significance"] >= threshold)]
    return report


def name_members(members: Sequence[Mapping[str, Any]], most: int) -> str:
    """Who of a station changed: paths, and polarisations as a whole."""
    named = [
        f"all {one['dipole']}" if one["antenna"] is None else f"antenna {one['antenna']} {one['dipole']}"
        for one in members[:most]
    ]
    return ", ".join(named) + (f" and {len(members) - most} more" if len(members) > most else "")


def tell_change(mean: float, sigma: float, shape: Shape, frequency_mhz: Floats) -> str:
    """By how much C changed, `mean` over the band with its error and along frequency: ``-3.10 ± 0.20 %``."""
    of_mean = abs(mean) / sigma
    shapes = _rank_shapes(of_mean, shape, frequency_mhz)
    whole = _Part(of_mean, write_change(mean, sigma) + (" in the mean over the band" if shapes else ""))
    return " and by ".join(part.words for part in sorted([whole, *shapes], key=lambda part: -part.significance))


def tell_shapes(change: Mapping[str, Any], frequency_mhz: Floats) -> str:
    """What changed along frequency beside the mean over the band; nothing where the mean says it all."""
    of_mean = abs(change["size"]) / change["sigma"]
    return " and ".join(part.words for part in _rank_shapes(of_mean, change["shape"], frequency_mhz))


def _rank_shapes(of_mean: float, shape: Shape, frequency_mhz: Floats) -> list[_Part]:
    """The shapes that are told beside a mean of some significance, the most significant first."""
    found = [
        _Part(abs(one["value"]) / one["sigma"], _tell_shape(name, one["value"], one["sigma"], frequency_mhz))
        for name, one in shape.items()
    ]
    most = max(of_mean, *(part.significance for part in found))
    least = min(most, max(PLAIN, BESIDE * most))
    told = [part for part in found if part.significance >= least]
    return sorted(told, key=lambda part: -part.significance)


def _tell_shape(name: str, value: float, sigma: float, frequency_mhz: Floats) -> str:
    """A shape of ln C, with its error where it is largest."""
    bottom, top = f"{frequency_mhz[0]:.0f}", f"{frequency_mhz[-1]:.0f}"
    largest = write_change(math.expm1(value), math.exp(value) * sigma)
    if name == TILT:
        return f"a tilt ({largest} at {top} MHz, {write_percent(math.expm1(-value))} at {bottom} MHz)"
    return f"a curvature ({largest} at {bottom} and {top} MHz, {write_percent(math.expm1(-value / 2))} halfway)"
