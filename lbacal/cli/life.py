"""`lbacal changes` and `lbacal life`: what changed and when, decisions about that, and all that happened to a path."""

from __future__ import annotations

import math
from functools import partial
from typing import Annotated, Any

import typer

from lbacal.cli.client import Antenna, Dipole, Station
from lbacal.cli.ledger import DryRun, Reason, print_act
from lbacal.cli.outputs import Json, show, show_each
from lbacal.client import Client
from lbacal.lives import ask_life, tell_life, tell_state
from lbacal_core.errors import BadInputError

changes = typer.Typer(invoke_without_command=True)


@changes.callback()
def list_changes(
    context: typer.Context, station: Station = None, antenna: Antenna = None, as_json: Json = False
) -> None:
    """List what changed and when, whoever found it; decide about a change, or enter one.

    Example: lbacal changes --station CS002
    """
    if context.invoked_subcommand is None:
        with Client() as client:
            found = client.get("/v1/changes", station=station, antenna=antenna)["changes"]
        show_each(found, print_change, "no changes", as_json=as_json)


@changes.command()
def decide(
    number: Annotated[int, typer.Argument(help="The change, as it is listed.")],
    reason: Reason,
    in_force: Annotated[bool, typer.Option("--in-force", help="Put it in force: windows are cut there.")] = False,
    dismiss: Annotated[bool, typer.Option("--dismiss", help="Dismiss it: windows stay whole.")] = False,
    dry_run: DryRun = False,
    as_json: Json = False,
) -> None:
    """Put a change in force, or dismiss it, and show what that changes in C.

    Example: lbacal changes decide 3 --dismiss --reason "snow lay on the antenna" --dry-run
    """
    if in_force == dismiss:
        raise BadInputError("decide", "either --in-force or --dismiss", "both" if dismiss else "neither")
    body = {"decision": "in_force" if in_force else "dismissed", "reason": reason}
    with Client() as client:
        done = client.send("POST", f"/v1/changes/{number}/decision", body, dry_run=dry_run or None)
    show(done, partial(print_decided, dry_run=dry_run), as_json=as_json)


def print_decided(done: dict[str, Any], *, dry_run: bool) -> None:
    """Print a change and what a decision about it changes in C."""
    print_change(done)
    print_act(done, dry_run=dry_run)


@changes.command()
def enter(
    at: Annotated[str, typer.Argument(help="When, ISO 8601, UTC.")],
    station: Annotated[str, typer.Option(help="Station such as CS002.")],
    reason: Reason,
    antenna: Antenna = None,
    dipole: Dipole = None,
    sigma_days: Annotated[float, typer.Option(help="Standard deviation of that instant, days.", min=0.0)] = 0.0,
    kind: Annotated[str, typer.Option(help="step, ramp, season or course (noted alone).")] = "step",
    size: Annotated[float | None, typer.Option(help="Change of C (ramp: a year), a fraction.")] = None,
    size_sigma: Annotated[float | None, typer.Option(help="Its error; a ramp or season needs one.", min=0.0)] = None,
    as_json: Json = False,
) -> None:
    """Enter what is known to have changed, of a path, an antenna or a station, or put it right; in force at once.

    Example: lbacal changes enter 2014-05-01T12:00 --station CS002 --antenna 17 --reason "another amplifier"
    """
    for option, value in (("--sigma-days", sigma_days), ("--size", size), ("--size-sigma", size_sigma)):
        if not math.isfinite(value or 0.0):
            raise BadInputError(option, "a finite number", str(value))
    entry: dict[str, Any] = {"at": {"value": at, "sigma_days": sigma_days}, "kind": kind, "reason": reason}
    if size is None and size_sigma is not None:
        raise BadInputError("--size-sigma", "--size beside it", "none")
    if kind != "step" and size is not None and size_sigma is None:
        raise BadInputError("--size-sigma", f"the error of the size, which C that follows the {kind} has, too", "none")
    if antenna is None and dipole is not None:
        raise BadInputError("--dipole", "--antenna beside it", "none")
    entry |= {} if size is None else {"size": {"value": size, "sigma": size_sigma or 0.0}}
    path = {"station": station, "antenna": antenna} | ({} if dipole is None else {"dipole": dipole})
    entry |= {"station": station} if antenna is None else {"paths": [path]}
    with Client() as client:
        show(client.send("POST", "/v1/changes", entry), print_change, as_json=as_json)


def print_change(one: dict[str, Any]) -> None:
    """Print a change in one line, and the decision about it in a second one."""
    antennas = sorted({path["antenna"] for path in one["paths"] or ()})
    named = ", ".join(map(str, antennas[:4])) + (f" and {len(antennas) - 4} more" if len(antennas) > 4 else "")
    dipoles = {path.get("dipole") for path in one["paths"] or ()}
    letter = dipoles.pop() if len(dipoles) == 1 else None
    who = (one["station"] or "array") + (f" antenna {named}" if named else "") + (f" {letter}" if letter else "")
    size = f", C by {one['in_words']}" if one["in_words"] else ""
    by = ", ".join(dict.fromkeys(source["from"] for source in one["evidence"] if source["ended_at"] is None))
    date = f"{one['at']['value'][:10]} ± {one['at']['sigma_days']:.1f} d"
    print(f"{one['id']} {who}, {one['kind']} at {date}{size} ({tell_state(one)}{'; found by ' + by if by else ''})")
    if one["reason"] != f"found by {one['by']}":
        print(f"  {one['by']}: {one['reason']}")
    for doubt in one.get("doubts", ()):
        print(f"  but {doubt}")


def life(
    path: Annotated[str | None, typer.Argument(help="STATION or STATION/ANTENNA/DIPOLE; without it the array.")] = None,
    station: Station = None, antenna: Antenna = None, dipole: Dipole = None, as_json: Json = False,
) -> None:  # fmt: skip
    """Show the life of a path, a station or the array: what was in effect when, and all that happened to it.

    Example: lbacal life CS002/17/X
    """
    if path is not None:
        if (station, antenna, dipole) != (None, None, None):
            raise BadInputError("life", "either a path or --station, --antenna and --dipole", "both")
        station, antenna, dipole = _parse_path(path)
    with Client() as client:
        found = ask_life(client, station, antenna, dipole)
    show(found, print_life, as_json=as_json)


def print_life(found: dict[str, Any]) -> None:
    """Print what `ask_life` found: a line for each thing that happened, and how much there is."""
    for at, words in tell_life(found):
        print(f"{at} {words}")
    print(f"versions: {len(found['versions'])}, epochs: {len(found['epochs'])}")


def _parse_path(text: str) -> tuple[str, int | None, str | None]:
    match text.split("/"):
        case [station] if station:
            return station, None, None
        case [station, antenna, dipole] if station and antenna.isdecimal() and dipole:
            return station, int(antenna), dipole
    raise BadInputError("life", "STATION or STATION/ANTENNA/DIPOLE such as CS002/17/X", repr(text))
