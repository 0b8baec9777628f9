"""The paths that change at one date: which of them by one size, and their names."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

SAME_DATE = 3.0
"""Standard deviations of the difference of two dates, or sizes, within which they are one."""


def split_by_size(change: Mapping[str, Any], *, keep_antennas: bool = False) -> list[dict[str, Any]]:
    """Split a change into those of one size, that of the most significant member, which gives its shape as well.

    Parameters
    ----------
    keep_antennas
        Both polarisations of an antenna are one change, whatever their sizes.
    """
    groups: list[list[Mapping[str, Any]]] = []
    for member in change["members"]:
        alike = (
            group for group in groups
            if is_of_one_size(group[0], member) or (keep_antennas and group[0]["antenna"] == member["antenna"])
        )  # fmt: skip
        own = next(alike, None)
        groups.append([member]) if own is None else own.append(member)
    bare = {**change, "shape": {}}  # as members of reports that were stored without shapes have it
    return [{**(bare if k else change), **group[0], "members": group} for k, group in enumerate(groups)]


def is_of_one_size(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether the sizes of two members agree within their errors."""
    return bool(abs(one["size"] - other["size"]) <= SAME_DATE * math.hypot(one["sigma"], other["sigma"]))


def name_members(members: Sequence[Mapping[str, Any]], most: int) -> str:
    """Name the members of a station that changed: paths, and polarisations as a whole."""
    named = [
        f"all {one['dipole']}" if one["antenna"] is None else f"antenna {one['antenna']} {one['dipole']}"
        for one in members[:most]
    ]
    return ", ".join(named) + (f" and {len(members) - most} more" if len(members) > most else "")
