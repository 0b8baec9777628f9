"""The life of a path, a station or the array: what was in effect when, and what happened, in words."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from lbacal.client import Client
from lbacal_core.errors import BadInputError, name_path


def ask_life(client: Client, station: str | None, antenna: int | None, dipole: str | None) -> dict[str, Any]:
    """Ask the server for the history of a path, of a station (no antenna and dipole) or of the array (no station).

    The answer has `epochs`, `in_effect`, `versions`, `changes` and more, as `GET /v1/life` says.
    """
    if (antenna is None) != (dipole is None) or (station is None and antenna is not None):
        raise BadInputError("life", "station, antenna and dipole, a station alone, or nothing", "a part of a path")
    whose = (
        "" if station is None else f"stations/{station}/" if dipole is None else f"paths/{station}/{antenna}/{dipole}/"
    )
    found: dict[str, Any] = client.get(f"/v1/{whose}life")
    return found


def tell_life(found: Mapping[str, Any]) -> list[tuple[str, str]]:
    """List the events of a history in order of time: the day, empty where it is open, and a sentence."""
    told: dict[str, Callable[[Any], tuple[str | None, str]]] = {
        "in_effect": lambda one: (
            one["from"],
            f"version {one['calibration'][:12]} answers until {one['to'] or 'open'}" + _tell_factor(one.get("factor")),
        ),
        "withdrawals": lambda one: (one["at"], _tell_withdrawal(one)),
        "changes": lambda one: (one["at"]["value"], f"change {one['id']}, {tell_state(one)}"),
        "causes": lambda one: (one["at"], f"{one['act']}: {one['changed']}"),
        "alarms": lambda one: (one["raised_at"], f"alarm {one['alarm']} ({one['state']}): {one['sentence']}"),
        "investigations": lambda one: (one["made_at"], f"investigation {one['id'][:12]}: {one['verdict']}"),
    }
    lines = [tell(one) for name, tell in told.items() for one in found.get(name, ())]
    # without the Z, which stands behind the point of a part of a second
    return [(at[:10], words) for at, words in sorted(((at or "").removesuffix("Z"), words) for at, words in lines)]


def tell_state(change: Mapping[str, Any]) -> str:
    """State of a change: ended, or the decision, and whether windows that it cuts wait."""
    state = "ended" if change["ended_at"] else change["decision"].replace("_", " ")
    return state + ("" if change["refitted"] else ", not yet refitted")


def _tell_withdrawal(one: Mapping[str, Any]) -> str:
    """The interval in which a scope lost its version, and why."""
    whose = name_path(one["station"], one["antenna"], one["dipole"])
    until = one["valid_to"] or "open"
    return f"{whose} was withdrawn from {one['valid_from']} to {until} by {one['by']}: {one['reason']}"


def _tell_factor(factor: list[dict[str, Any]] | None) -> str:
    """The range of C that follows ramps and seasons."""
    low, high = (end((100.0 * (one["value"] - 1.0) for one in factor or ()), default=0.0) for end in (min, max))
    return f", and follows {low:+.2f} to {high:+.2f} % about it" if factor else ""
