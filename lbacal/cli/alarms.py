"""`lbacal alarms`: what is wrong, and saying that it is known."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from lbacal.cli.client import Station
from lbacal.client import Client
from lbacal_core.errors import BadInputError


def alarms(
    acknowledge: Annotated[int | None, typer.Option(help="Say that this alarm is known; with --reason.")] = None,
    reason: Annotated[str | None, typer.Option(help="Why it is no news; it is kept.")] = None,
    until: Annotated[str | None, typer.Option(help="Known until then, ISO 8601, UTC; without it for good.")] = None,
    station: Station = None,
    state: Annotated[str, typer.Option(help="open, acknowledged, ended, lasting (not ended) or all.")] = "lasting",
) -> None:
    """List steps and slopes of C, lost paths, stale data, misfits, named causes, failed jobs; or acknowledge one.

    Example: lbacal alarms --acknowledge 12 --until 2027-03-01 --reason "the cable is ordered"
    """
    if (acknowledge is None) != (reason is None) or (acknowledge is None and until is not None):
        raise BadInputError("alarms", "--acknowledge with --reason (and --until)", "one without the other")
    with Client() as client:
        if acknowledge is not None:
            body = {"reason": reason, **({} if until is None else {"until": until})}
            found = [client.send("POST", f"/v1/alarms/{acknowledge}/acknowledgement", body)]
        else:
            found, cursor = [], ""
            while cursor is not None:
                page = client.get("/v1/alarms", state=state, station=station, cursor=cursor or None)
                found, cursor = found + page["alarms"], page["next"]
    for one in found:
        print_alarm(one)
    if not found:
        print(f"no alarms ({state})")


def print_alarm(one: dict[str, Any]) -> None:
    """Print an alarm in one line, and who knows of it in a second one."""
    print(f"{one['alarm']} {one['kind']} ({one['state']}, raised {one['raised_at'][:10]}): {one['sentence']}")
    known = one["acknowledgement"]
    if known is not None:
        until = f" until {known['until'][:10]}" if known["until"] else ""
        print(f"  known{until}, {known['by']}: {known['reason']}")
