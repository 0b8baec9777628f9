"""Why versions of a station stand beside its monthly line: which of what they are made from is another."""

from __future__ import annotations

import math

from service.storage.versions import Version

NOTICEABLE = 2.0
"""Standard deviations from which on a noise constant is told to be another."""


def explain_version(version: Version, first: Version, dipole: str) -> str:
    """What differs between a version and the first of its polarisation, besides the spectra; in words."""
    if version.id == first.id:
        return "the first"
    now, before = version.chains.get(dipole), first.chains.get(dipole)
    told = []
    if now is not None and before is not None and now.member_set != before.member_set:
        gone, new = len(before.member_set - now.member_set), len(now.member_set - before.member_set)
        told.append(f"other antennas ({gone} left out, {new} more)")
    was, is_now = (one.curve_of(dipole).parameters for one in (first, version))
    for name in is_now:
        if name not in was:
            continue
        change = is_now[name].value / was[name].value - 1.0
        sigma = math.hypot(was[name].sigma / was[name].value, is_now[name].sigma / is_now[name].value)
        if abs(change) > NOTICEABLE * sigma:
            told.append(f"N_{name.removeprefix('n_').upper()} {change:+.0%} ± {sigma:.0%}")
    return ", ".join(told) or "the same antennas, noise constants within their errors"
