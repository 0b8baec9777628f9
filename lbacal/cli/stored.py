"""`lbacal investigate --stored`: the service investigates what it keeps."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import typer

from lbacal.cli.client import wait_for
from lbacal.cli.outputs import show_each
from lbacal.client import Client
from lbacal.files import written_beside
from lbacal.instants import format_optional
from lbacal.selection import Selection
from lbacal_core.errors import BadInputError


def investigate_stored(selection: Selection, reason: str | None, report: Path | None, *, as_json: bool) -> None:
    """Ask the server for investigations, one a station and calendar year, wait for them and print what they found."""
    if len(selection.stations) > 1:
        raise BadInputError("--station", "one beside --stored, or none for all", ", ".join(selection.stations))
    since, until = format_optional(selection.since), format_optional(selection.until)
    body = {"since": since, "until": until, "reason": reason}
    for name, value in body.items():
        if value is None:
            raise BadInputError(f"--{name}", "a value beside --stored", "nothing")
    with Client() as client:
        asked = {**body, "station": next(iter(selection.stations), None)}
        job = wait_for(client, client.send("POST", "/v1/investigations", asked)["job"])
        found = [client.get(f"/v1/investigations/{name}") for name in job["results"]]
    if report is not None and len(found) != 1:
        raise BadInputError("--report", "one station and one calendar year, which make one report", str(len(found)))
    show_each(found, print_investigation, "no investigations", as_json=as_json)
    if report is not None:
        with written_beside(report) as beside:
            beside.write_text(json.dumps(found[0]["report"], indent=1, allow_nan=False) + "\n")
    if job["state"] != "done":
        print(f"job {job['job']} is {job['state']}: {job['error']}", file=sys.stderr)
        raise typer.Exit(1)


def print_investigation(one: dict[str, Any]) -> None:
    """Print the verdict of a stored investigation, and its findings with the numbers by which they are adopted."""
    window = f"{one['since'][:10]} to {one['until'][:10]}"
    print(f"{one['station']}, {window}: {one['report']['verdict']}; investigation {one['id'][:12]}")
    for number, finding in enumerate(one["report"]["findings"]):
        print(f"  #{number} {finding['significance_sigma']:.1f} sigma: {finding['sentence']}")
    if one["report"]["unexplained"]:
        left = one["report"]["unexplained"]
        print(f"  {left['description']}")
        if left.get("in_words"):
            print(f"  in words: {left['in_words']}")
