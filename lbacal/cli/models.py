"""`lbacal adopt`, `models`, `abandon`: what the fits of stations assume beside the signal chain."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from lbacal.cli.client import print_job
from lbacal.cli.ledger import DryRun, Reason, print_act
from lbacal.client import Client

Wait = Annotated[bool, typer.Option(help="Wait until the refits have ended.")]


def adopt(
    investigation: Annotated[str, typer.Argument(help="Investigation, or six or more first digits of its id.")],
    reason: Reason,
    finding: Annotated[str, typer.Option(help="Number of the finding in its report, or unexplained.")] = "0",
    promote: Annotated[bool, typer.Option("--promote", help="Put into effect what passes the gate.")] = False,
    dry_run: DryRun = False,
    wait: Wait = True,
) -> None:
    """Adopt a finding: from its window on, fits of the station have the cause; the windows it touches are fitted again.

    Example: lbacal adopt 4798c009 --finding 0 --reason "the cables were exchanged" --dry-run
    """
    body = {"finding": int(finding) if finding.isdecimal() else finding, "reason": reason, "promote": promote}
    with Client() as client:
        path = f"/v1/investigations/{investigation}/adoption"
        done = client.send("POST", path, body, dry_run=dry_run or None)
        if dry_run:
            print(f"model {done['model'][:12]} would be adopted: {done['cause']}")
            _print_promise(*done["promise"])
            print_act(done, dry_run=True)
            return
        print(f"model {done['model'][:12]} is adopted; withdraw it with `lbacal abandon {done['model'][:12]}`")
        follow(client, done["jobs"], wait=wait)


def abandon(
    model: Annotated[str, typer.Argument(help="Model, or six or more first digits of its id.")],
    reason: Reason,
    wait: Wait = True,
) -> None:
    """Withdraw the cause that was adopted with a model; what was in effect before answers again at once.

    Example: lbacal abandon bf7c1b786b66 --reason "the cables were right"
    """
    with Client() as client:
        done = client.send("POST", f"/v1/models/{model}/withdrawal", {"reason": reason})
        print(f"the station has model {done['model'][:12]} again")
        follow(client, done["jobs"], wait=wait)


def models() -> None:
    """List what was adopted and withdrawn, newest first, and what each adopted cause gained on later events.

    Example: lbacal models
    """
    with Client() as client:
        for one in client.get("/v1/models")["models"]:
            print_model(one)


def follow(client: Client, jobs: list[int], *, wait: bool) -> None:
    """Print the refits, once they have ended if they are waited for; a failed one ends the command with 1."""
    found = [client.wait_for(number) if wait else client.job(number) for number in jobs]
    for job in found:
        print_job(job)
    if any(job["state"] == "failed" for job in found):
        raise typer.Exit(1)


def _print_promise(gain: float, sigma: float) -> None:
    """Print what a cause is to gain on as many events again, once the selection of the largest score is taken off."""
    doubt = "" if gain > 0.0 else "; so small a finding is not expected to pay"
    print(f"promised on as many events again: log-likelihood {gain:+.1f} ± {sigma:.1f}{doubt}")


def print_model(one: dict[str, Any]) -> None:
    """Print an adoption or a withdrawal, and the gains of the causes that the station has from then on."""
    now = ", in effect" if one["in_effect"] else ""
    print(f"model {one['id'][:12]} of {one['station']}{now}, {one['at']} by {one['by']}: {one['reason']}")
    print(f"  {one['act']}: {one['changed']}")
    for cause in one["causes"]:
        for gain in cause["gains"]:
            window = f"{gain['since'][:10]} to {gain['until'][:10]}"
            print(
                f"  {cause['cause']} in {cause['target']}, {gain['events']} new events of {window}: log-likelihood "
                f"{gain['log_likelihood_gain']:+.1f}, expected {gain['expected']:.1f} ± {gain['expected_sigma']:.1f}"
            )
