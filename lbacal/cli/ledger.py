"""`lbacal promote`, `withdraw`, `rollback`, `tag`: what is in effect, changed and frozen from the command line."""

from __future__ import annotations

import math
from functools import partial
from typing import Annotated, Any

import typer

from lbacal.cache import require_tag
from lbacal.cli.client import SHOWN, Antenna, Dipole, Station, print_job, wait_for
from lbacal.cli.outputs import Json, show, show_each
from lbacal.client import Client
from lbacal_core.errors import BadInputError, name_path, write_count

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
    as_json: Json = False,
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
            path, body = f"/v1/jobs/{job}/promotion", {"reason": reason}
        else:
            version, path = client.get(f"/v1/calibrations/{calibration}"), "/v1/promotions"
            interval = {"valid_from": start or version["since"], "valid_to": end or version["until"]}
            body = {"calibration": version["id"], "reason": reason, **_closed(interval)}
        _act(client, path, body, dry_run=dry_run, as_json=as_json)


def withdraw(
    reason: Reason,
    start: Annotated[str, typer.Option("--from", help="First instant, ISO 8601, UTC.")],
    end: Annotated[str, typer.Option("--to", help="End, not included; `open` for none.")],
    station: Station = None,
    antenna: Antenna = None,
    dipole: Dipole = None,
    scope: Annotated[str | None, typer.Option(help="array: what the array itself has.")] = None,
    dry_run: DryRun = False,
    as_json: Json = False,
) -> None:
    """Withdraw what a path, a station or the array has in effect; a wider scope then answers, if it has something.

    Example: lbacal withdraw --station CS002 --from 2014-01-01 --to 2015-01-01 --reason "wrong cables" --dry-run
    """
    of = {"scope": scope, "station": station, "antenna": antenna, "dipole": dipole}
    body = {"calibration": None, "reason": reason, **of, **_closed({"valid_from": start, "valid_to": end})}
    with Client() as client:
        _act(client, "/v1/promotions", body, dry_run=dry_run, as_json=as_json)


def rollback(
    promotion: Annotated[int, typer.Argument(help="Number of the promotion to undo, with those made with it.")],
    reason: Reason,
    dry_run: DryRun = False,
    as_json: Json = False,
) -> None:
    """Put into effect again what a promotion replaced.

    Example: lbacal rollback 4711 --reason "the cable table was wrong" --dry-run
    """
    with Client() as client:
        _act(client, f"/v1/promotions/{promotion}/rollback", {"reason": reason}, dry_run=dry_run, as_json=as_json)


def tag(
    name: Annotated[str | None, typer.Argument(help="Name to give; without it the tags are listed.")] = None,
    reason: Annotated[str | None, typer.Option(help="Why; it is kept.")] = None,
    as_of: Annotated[str | None, typer.Option(help="Freeze what was known at this instant; without it now.")] = None,
    as_json: Json = False,
) -> None:
    """Freeze what is in effect under a name, for `--tag` and `lbacal sync`; or list the tags.

    Example: lbacal tag paper-2026 --reason "the calibration of the paper"
    """
    with Client() as client:
        if name is None:
            tags = client.list("/v1/tags", "tags")
        elif reason is None:
            raise BadInputError("--reason", "why the tag is made", "nothing")
        else:
            tags = [client.send("PUT", f"/v1/tags/{require_tag(name)}", {"as_of": as_of, "reason": reason})]
    show_each(
            tags, lambda one: print(f"{one['name']}: as of {one['as_of']}, by {one['by']}: {one['reason']}"), "no tags",
            as_json=as_json,
        )  # fmt: skip


def _act(client: Client, path: str, body: dict[str, Any], *, dry_run: bool, as_json: bool) -> None:
    done = client.send("POST", path, body, dry_run=dry_run or None)
    show(done, partial(print_act, dry_run=dry_run), as_json=as_json)


def _closed(interval: dict[str, Any]) -> dict[str, Any]:
    """An interval whose end may be open."""
    return {name: None if value == OPEN else value for name, value in interval.items()}


def _size(change: dict[str, Any]) -> float:
    """How much a change is to be looked at: those that have nothing to be compared with come first."""
    return math.inf if change["max_fraction"] is None else float(change["max_fraction"])


def print_act(done: dict[str, Any], *, dry_run: bool) -> None:
    """Print what promotions changed, or would: the answer of `POST /v1/promotions` and of what else promotes."""
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
    print(f"changes of what paths are served: {len(changes)}{' (dry run: nothing was written)' if dry_run else ''}")
    for one in sorted(changes, key=_size, reverse=True)[:SHOWN]:
        names = [(one[k] or "nothing")[:12] for k in ("before", "after")]
        size = "" if one["max_fraction"] is None else f", C by up to {100 * one['max_fraction']:.2f} %"
        path = name_path(one["station"], one["antenna"], one["dipole"])
        print(f"  {path}, {one['from']} to {one['to'] or OPEN}: {names[0]} -> {names[1]}{size}")
    if len(changes) > SHOWN:
        print(f"  and {len(changes) - SHOWN} more")


# `lbacal adopt`, `models`, `abandon`: what the fits of stations assume beside the signal chain.

Wait = Annotated[bool, typer.Option(help="Wait until the refits have ended.")]


def adopt(
    investigation: Annotated[str, typer.Argument(help="Investigation, or six or more first digits of its id.")],
    reason: Reason,
    finding: Annotated[str, typer.Option(help="Number of the finding in its report, or unexplained.")] = "0",
    promote: Annotated[bool, typer.Option("--promote", help="Put into effect what passes the gate.")] = False,
    dry_run: DryRun = False,
    wait: Wait = True,
    as_json: Json = False,
) -> None:
    """Adopt a finding: from its window on, fits of the station have the cause; the windows it touches are fitted again.

    Example: lbacal adopt 4798c009 --finding 0 --reason "the cables were exchanged" --dry-run
    """
    body = {"finding": int(finding) if finding.isdecimal() else finding, "reason": reason, "promote": promote}
    with Client() as client:
        path = f"/v1/investigations/{investigation}/adoption"
        done = client.send("POST", path, body, dry_run=dry_run or None)
        if dry_run:
            show(done, _print_adoption, as_json=as_json)
            return
        said = f"model {done['model'][:12]} is adopted; withdraw it with `lbacal abandon {done['model'][:12]}`"
        follow(client, done, said, wait=wait, as_json=as_json)


def abandon(
    model: Annotated[str, typer.Argument(help="Model, or six or more first digits of its id.")],
    reason: Reason,
    wait: Wait = True,
    as_json: Json = False,
) -> None:
    """Withdraw the cause that was adopted with a model; what was in effect before answers again at once.

    Example: lbacal abandon bf7c1b786b66 --reason "the cables were right"
    """
    with Client() as client:
        done = client.send("POST", f"/v1/models/{model}/withdrawal", {"reason": reason})
        follow(client, done, f"the station has model {done['model'][:12]} again", wait=wait, as_json=as_json)


def models(as_json: Json = False) -> None:
    """List what was adopted and withdrawn, newest first, and what each adopted cause gained on later events.

    Example: lbacal models
    """
    with Client() as client:
        show_each(client.list("/v1/models", "models"), print_model, "no models", as_json=as_json)


def follow(client: Client, done: dict[str, Any], said: str, *, wait: bool, as_json: bool) -> None:
    """Print the refits, once they have ended if they are waited for; a failed one ends the command with 1."""
    if not as_json:
        print(said)
    found = [wait_for(client, number) if wait else client.job(number) for number in done["jobs"]]
    show(done | {"jobs": found}, _print_jobs, as_json=as_json)
    if any(job["state"] == "failed" for job in found):
        raise typer.Exit(1)


def _print_jobs(done: dict[str, Any]) -> None:
    for job in done["jobs"]:
        print_job(job)


def _print_adoption(done: dict[str, Any]) -> None:
    """Print what an adoption would change, and what the cause is to gain on as many events again.

    The selection of the largest score is taken off the gain.
    """
    print(f"model {done['model'][:12]} would be adopted: {done['cause']}")
    gain, sigma = done["promise"]
    doubt = "" if gain > 0.0 else "; so small a finding is not expected to pay"
    print(f"promised on as many events again: log-likelihood {gain:+.1f} ± {sigma:.1f}{doubt}")
    print_act(done, dry_run=True)


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


# `lbacal alarms`: what is wrong, and saying that it is known.


def alarms(
    acknowledge: Annotated[int | None, typer.Option(help="Say that this alarm is known; with --reason.")] = None,
    reason: Annotated[str | None, typer.Option(help="Why it is no news; it is kept.")] = None,
    until: Annotated[str | None, typer.Option(help="Known until then, ISO 8601, UTC; without it for good.")] = None,
    station: Station = None,
    state: Annotated[str, typer.Option(help="open, acknowledged, ended, lasting (not ended) or all.")] = "lasting",
    as_json: Json = False,
) -> None:
    """List steps, slopes, lost paths, left-out spectra, stale data, misfits, causes, failed jobs; or acknowledge one.

    Example: lbacal alarms --acknowledge 12 --until 2027-03-01 --reason "the cable is ordered"
    """
    if (acknowledge is None) != (reason is None) or (acknowledge is None and until is not None):
        raise BadInputError("alarms", "--acknowledge with --reason (and --until)", "one without the other")
    with Client() as client:
        if acknowledge is not None:
            body = {"reason": reason, **({} if until is None else {"until": until})}
            found = [client.send("POST", f"/v1/alarms/{acknowledge}/acknowledgement", body)]
        else:
            found = client.list("/v1/alarms", "alarms", state=state, station=station)
    show_each(found, print_alarm, f"no alarms ({state})", as_json=as_json)


def print_alarm(one: dict[str, Any]) -> None:
    """Print an alarm in one line, and who knows of it in a second one."""
    print(f"{one['alarm']} {one['kind']} ({one['state']}, raised {one['raised_at'][:10]}): {one['sentence']}")
    known = one["acknowledgement"]
    if known is not None:
        until = f" until {known['until'][:10]}" if known["until"] else ""
        print(f"  known{until}, {known['by']}: {known['reason']}")


# `lbacal status`: whether the service can serve, who lives, what waits and what failed.


def status(as_json: Json = False) -> None:
    """Show whether the service is ready, which processes live, what waits, and what failed and when it is tried again.

    Example: lbacal status

    Exit 1 if it is not ready.
    """
    with Client(tries=1) as client:
        state = client.get("/v1/status")
    show(state, print_state, as_json=as_json)
    if not state["ready"]:
        raise typer.Exit(1)


def print_state(state: dict[str, Any]) -> None:
    """Print the answer of `GET /v1/status`, one line a fact."""
    print("ready" if state["ready"] else f"not ready: {state['problem']}")
    for process in state["processes"]:
        said = "lives" if process["alive"] else "is silent"
        print(f"{process['kind']} {process['name']} {said}, seen {process['silent_s']:.0f} s ago")
    parts = ", ".join(f"{count} {name}" for name, count in state["parts"].items())
    print(f"parts of jobs: {parts}")
    newest = f", the newest of {state['newest_event']}" if state["newest_event"] else ""
    print(f"{write_count(state['events'], 'usable event')}{newest}; versions that wait for a human: {state['gated']}")
    print(f"alarms: {state['alarms']['line']}")
    for one in state["investigations"]:
        print_news(one)
    for name, said in (("not_refitted", ""), ("stopped_paying", "no longer pays: "), ("stuck", "stuck: ")):
        for sentence in state[name]:
            print(f"{said}{sentence}")
    for failure in state["failures"]:
        request = failure["request"]
        what = " ".join(str(request[name]) for name in ("scope", "station") if request.get(name))
        again = f"; again after {failure['again_after']}" if failure["again_after"] else ""
        print(f"failed: job {failure['job']} ({failure['kind']} {what}): {failure['error']}{again}")


def print_news(news: dict[str, Any]) -> None:
    """Print the newest investigation of a station in one line, and below it what the one before did not say."""
    causes = f" ({', '.join(news['findings'])})" if news["findings"] else ""
    window = f"{news['since'][:10]} to {news['until'][:10]}"
    has_news = news["before"] is not None and (news["new"] or news["stronger"] or news["gone"])
    told = "" if news["before"] is None or has_news else ", as before"
    print(f"{news['station']}, {window}: {news['verdict']}{causes}{told}; investigation {news['id'][:12]}")
    for name, kind in (("new", "new"), ("stronger", "stronger"), ("gone", "no longer")):
        for sentence in news[name]:
            print(f"  {kind}: {sentence}")
