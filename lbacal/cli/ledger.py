"""`lbacal promote`, `withdraw`, `rollback`, `tag`: what is in effect, changed and frozen from the command line."""

from __future__ import annotations

import math
from typing import Annotated, Any

import typer

from lbacal.cli.client import SHOWN, Antenna, Dipole, Station
from lbacal.client import Client
from lbacal_core.errors import BadInputError, name_path

Reason = Annotated[str, typer.Option(help="Why; it is kept.")]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Show what would change, and change nothing.")]
From = Annotated[str | None, typer.Option("--from", help="First instant; without it that of the version's window.")]
To = Annotated[str | None, typer.Option("--to", help="End, not included; `open` for none; without it the window's.")]
OPEN = "open"


def promote(
    reason: Reason,
    calibration: Annotated[
        str | None, typer.Argument(help="Version to put into effect, or six or more first digits of its id.")
    ] = None,
    job: Annotated[int | None, typer.Option(help="All converged versions of a job, each for its window.")] = None,
    start: From = None,
    end: To = None,
    dry_run: DryRun = False,
) -> None:
    """Put a version, or all versions of a job, into effect.

    Example: lbacal promote --job 12 --reason "looked at the curves" --dry-run
    """
    if (calibration is None) == (job is None):
        raise BadInputError("promote", "either a version or --job", "neither" if job is None else "both")
    if job is not None and (start is not None or end is not None):
        raise BadInputError("--job", "no --from or --to beside it", "one of them")
    with Client() as client:
        if job is not None:
            done = client.send("POST", f"/v1/jobs/{job}/promotion", {"reason": reason}, dry_run=dry_run or None)
        else:
            version = client.get(f"/v1/calibrations/{calibration}")
            interval = {"valid_from": start or version["since"], "valid_to": end or version["until"]}
            body = {"calibration": version["id"], "reason": reason, **_closed(interval)}
            done = client.send("POST", "/v1/promotions", body, dry_run=dry_run or None)
    print_act(done, dry_run=dry_run)


def withdraw(
    reason: Reason,
    start: Annotated[str, typer.Option("--from", help="First instant, ISO 8601, UTC.")],
    end: Annotated[str, typer.Option("--to", help="End, not included; `open` for none.")],
    station: Station = None,
    antenna: Antenna = None,
    dipole: Dipole = None,
    scope: Annotated[str | None, typer.Option(help="array: what the array itself has.")] = None,
    dry_run: DryRun = False,
) -> None:
    """Withdraw what a path, a station or the array has in effect; a wider scope then answers, if it has something.

    Example: lbacal withdraw --station CS002 --from 2014-01-01 --to 2015-01-01 --reason "wrong cables" --dry-run
    """
    of = {"scope": scope, "station": station, "antenna": antenna, "dipole": dipole}
    body = {"calibration": None, "reason": reason, **of, **_closed({"valid_from": start, "valid_to": end})}
    with Client() as client:
        done = client.send("POST", "/v1/promotions", body, dry_run=dry_run or None)
    print_act(done, dry_run=dry_run)


def rollback(
    promotion: Annotated[int, typer.Argument(help="Number of the promotion to undo, with those made with it.")],
    reason: Reason,
    dry_run: DryRun = False,
) -> None:
    """Put into effect again what a promotion replaced.

    Example: lbacal rollback 4711 --reason "the cable table was wrong" --dry-run
    """
    with Client() as client:
        path = f"/v1/promotions/{promotion}/rollback"
        done = client.send("POST", path, {"reason": reason}, dry_run=dry_run or None)
    print_act(done, dry_run=dry_run)


def tag(
    name: Annotated[str | None, typer.Argument(help="Name to give; without it the tags are listed.")] = None,
    reason: Annotated[str | None, typer.Option(help="Why; it is kept.")] = None,
    as_of: Annotated[str | None, typer.Option(help="Freeze what was known at this instant; without it now.")] = None,
) -> None:
    """Freeze what is in effect under a name, for `--tag` and `lbacal sync`; or list the tags.

    Example: lbacal tag paper-2026 --reason "the calibration of the paper"
    """
    with Client() as client:
        if name is None:
            tags: list[dict[str, Any]] = []
            cursor: str | None = ""
            while cursor is not None:
                page = client.get("/v1/tags", cursor=cursor)
                tags, cursor = tags + page["tags"], page["next"]
        elif reason is None:
            raise BadInputError("--reason", "why the tag is made", "nothing")
        else:
            tags = [client.send("PUT", f"/v1/tags/{name}", {"as_of": as_of, "reason": reason})]
    for one in tags:
        print(f"{one['name']}: as of {one['as_of']}, by {one['by']}: {one['reason']}")


def _closed(interval: dict[str, Any]) -> dict[str, Any]:
    """An interval whose end may be open."""
    return {name: None if value == OPEN else value for name, value in interval.items()}


def _size(change: dict[str, Any]) -> float:
    """How much a change is to be looked at: those that have nothing to be compared with come first."""
    return math.inf if change["max_fraction"] is None else float(change["max_fraction"])


def print_act(done: dict[str, Any], *, dry_run: bool) -> None:
    """Print what promotions changed, or would."""
    made = done.get("promotions", [done] if "promotion" in done else [])
    for one in made[:SHOWN]:
        what = f"version {one['calibration'][:12]}" if one["calibration"] else "nothing"
        owner = name_path(one["station"], one["antenna"], one["dipole"])
        print(f"promotion {one['promotion']}: {owner} has {what} from {one['valid_from']} to {one['valid_to'] or OPEN}")
    if len(made) > SHOWN:
        print(f"and {len(made) - SHOWN} more promotions")
    for version, status in done.get("left_out", {}).items():
        print(f"{version[:12]} is left out: {status}")
    changes = done["changes"]
    print(f"changes of what paths are told: {len(changes)}{' (dry run: nothing was written)' if dry_run else ''}")
    for one in sorted(changes, key=_size, reverse=True)[:SHOWN]:
        names = [(one[k] or "nothing")[:12] for k in ("before", "after")]
        size = "" if one["max_fraction"] is None else f", C by up to {100 * one['max_fraction']:.2f} %"
        path = name_path(one["station"], one["antenna"], one["dipole"])
        print(f"  {path}, {one['from']} to {one['to'] or OPEN}: {names[0]} -> {names[1]}{size}")
    if len(changes) > SHOWN:
        print(f"  and {len(changes) - SHOWN} more")
