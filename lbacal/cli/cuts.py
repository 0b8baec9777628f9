"""`lbacal cuts`: where the windows of antennas are cut, and decisions about that."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from lbacal.cli.client import Station
from lbacal.client import Client
from lbacal_core.errors import BadInputError, name_path


def cuts(
    lift: Annotated[int | None, typer.Option(help="Leave the windows whole at this cut; with --reason.")] = None,
    restore: Annotated[int | None, typer.Option(help="Cut the windows again at this cut; with --reason.")] = None,
    reason: Annotated[str | None, typer.Option(help="Why; it is kept.")] = None,
    station: Station = None,
) -> None:
    """List where the windows of antennas are cut because drift found a change there; lift a cut, or restore it.

    Example: lbacal cuts --lift 3 --reason "snow lay on the antenna"
    """
    asked = [(number, act) for number, act in ((lift, "lift"), (restore, "restoration")) if number is not None]
    if len(asked) > 1 or (reason is None) == bool(asked):
        raise BadInputError("cuts", "--lift or --restore, with --reason", "another combination of options")
    with Client() as client:
        if asked:
            number, act = asked[0]
            found = [client.send("POST", f"/v1/cuts/{number}/{act}", {"reason": reason})]
        else:
            found = client.get("/v1/cuts", station=station)["cuts"]
    for one in found:
        _print_cut(one)
    if not found:
        print("no cuts")


def _print_cut(one: dict[str, Any]) -> None:
    """Print a cut in one line, and the last decision about it in a second one."""
    stands = "stands" if one["refitted"] else "found, not yet refitted"
    state = stands if one["stands"] else ("lifted" if one["ended_at"] is None else "ended")
    where = f"{name_path(one['station'], one['antenna'])} at {one['date'][:10]} ± {one['date_sigma_days']:.1f} d"
    print(f"{one['cut']} {where} ({state}, made {one['made_at'][:10]})")
    said = one["decision"]
    if said is not None:
        print(f"  {said['act']} {said['at'][:10]}, {said['by']}: {said['reason']}")
