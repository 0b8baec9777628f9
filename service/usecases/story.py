"""Why versions of a station stand beside its monthly line: which of what they are made from is another."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lbacal_core.curves.reference_chain import ReferenceChain
from lbacal_core.errors import write_percent
from service.storage.versions import Version
from service.usecases.gate import find_change_of_mean

NOTICEABLE = 2.0
"""Standard deviations from which on a noise constant is told to be another."""
LEAST_CABLES = 0.001
"""A smaller change of C by the cables of other antennas is not told: errors of a version are ten times it."""


@dataclass(frozen=True)
class Story:
    """How a version stands beside the first of its polarisation.

    Attributes
    ----------
    change
        Change of the mean of C over the band through one and the same cable, a fraction.
    words
        What else is another.
    """

    change: float
    words: str


def tell_story(version: Version, first: Version, dipole: str) -> Story:
    """Compare a version with the first of its polarisation."""
    change = find_change_of_mean(version, first, dipole)
    return Story(change or 0.0, explain_version(version, first, dipole))


def explain_version(version: Version, first: Version, dipole: str) -> str:
    """What differs between a version and the first of its polarisation, besides the spectra; in words."""
    if version.id == first.id:
        return "the first"
    now, before = version.chains.get(dipole), first.chains.get(dipole)
    told = []
    if now is not None and before is not None and now.member_set != before.member_set:
        gone, new = len(before.member_set - now.member_set), len(now.member_set - before.member_set)
        told.append(f"other antennas ({gone} left out, {new} more)" + _tell_cables(before, now))
    was, is_now = (one.curve_of(dipole).parameters for one in (first, version))
    for name in is_now:
        if name not in was:
            continue
        change = is_now[name].value / was[name].value - 1.0
        sigma = math.hypot(was[name].sigma / was[name].value, is_now[name].sigma / is_now[name].value)
        if abs(change) > NOTICEABLE * sigma:
            told.append(f"N_{name.removeprefix('n_').upper()} {change:+.0%} ± {sigma:.0%}")
    return ", ".join(told) or "the same antennas, noise constants within their errors"


def _tell_cables(before: ReferenceChain, now: ReferenceChain) -> str:
    """What the mean loss of other cables does to C, which is as L_ref^-1/2."""
    change = float(np.median((before.mean_loss / now.mean_loss) ** 0.5)) - 1.0
    return "" if abs(change) < LEAST_CABLES else f", whose cables change C by {write_percent(change, 1)}"
