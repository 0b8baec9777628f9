"""The paths that change at one date: which of them by one size, and their names."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

SAME_DATE = 3.0
"""Standard deviations of the difference of two dates, or sizes, within which they are one."""


def split_by_size(change: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Split a change into those of one size: both polarisations of an antenna are one, and others whose sizes agree.

    The shape is that of the most significant member, in the first; the others have none.
    """
    groups: list[list[Mapping[str, Any]]] = []
    for member in change["members"]:
        own = next((group for group in groups if _is_of_one_size(group[0], member)), None)
        groups.append([member]) if own is None else own.append(member)
    first, *others = ({**change, **group[0], "members": group} for group in groups)
    return [first, *({**one, "shape": {}} for one in others)]


def _is_of_one_size(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    reach = SAME_DATE * math.hypot(one["sigma"], other["sigma"])
    return bool(one["antenna"] == other["antenna"] or abs(one["size"] - other["size"]) <= reach)


def name_members(members: Sequence[Mapping[str, Any]], most: int) -> str:
    """Name the members of a station that changed: paths, and polarisations as a whole."""
    named = [
        f"all {one['dipole']}" if one["antenna"] is None else f"antenna {one['antenna']} {one['dipole']}"
        for one in members[:most]
    ]
    return ", ".join(named) + (f" and {len(members) - most} more" if len(members) > most else "")
