"""`lbacal ingest`, `effective`, `refit`, `jobs`: the client on the command line (`LBACAL_URL`, `LBACAL_API_KEY`)."""

from __future__ import annotations

import json
import sys
import warnings
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from lbacal.cli.outputs import Json, progress, require_outputs, show, show_each
from lbacal.client import CachedAnswerWarning, Client, describe_snapshot
from lbacal.files import written_beside
from lbacal_core.errors import BadInputError, name_path, write_count

Station = Annotated[str | None, typer.Option(help="Station such as CS002.")]
Antenna = Annotated[int | None, typer.Option(help="Antenna number.", min=0)]
Dipole = Annotated[str | None, typer.Option(help="Letter of the dipole, such as X.")]
SHOWN = 20
"""A list of versions, promotions or changes shows this many, and counts the others."""


Format = StrEnum("Format", ["table", "json", "csv", "ecsv", "fits", "hdf5", "nuradio"])
"""How an answer is written."""


def ingest(
    spectra: Annotated[Path, typer.Argument(help="Spectra file (HDF5, lbacal-spectra-1).")], as_json: Json = False
) -> None:
    """Send spectra to the server in bundles of whole events; run again, it sends what is missing.

    Example: lbacal ingest spectra.h5
    """
    with Client() as client, progress() as tell:
        total = client.ingest(spectra, lambda k, n: tell(f"{k} of {n} events", k, n))
    show(total, print_receipt, as_json=as_json)


def effective(
    at: Annotated[str, typer.Option(help="When the data were taken: ISO 8601, UTC.")],
    station: Station = None,
    antenna: Antenna = None,
    dipole: Dipole = None,
    as_of: Annotated[str | None, typer.Option(help="Answer as it was known at this instant.")] = None,
    gap: Annotated[str | None, typer.Option(help="hold: answer with the nearest; asks a server.")] = None,
    scope: Annotated[str | None, typer.Option(help="array: its reference chain, which is nobody's cable.")] = None,
    tag: Annotated[str | None, typer.Option(help="Answer as it was frozen under this name.")] = None,
    why: Annotated[bool, typer.Option("--why", help="Say in a sentence why it is this version.")] = False,
    kind: Annotated[Format, typer.Option("--format", help="How to print.")] = Format.table,
    output: Annotated[Path | None, typer.Option(help="File to write instead of printing.")] = None,
    as_json: Json = False,
) -> None:
    """Print the calibration in effect on a date.

    Example: lbacal effective --station CS002 --antenna 17 --dipole X --at 2014-05-01
    """
    require_outputs({"--output": output}, {})
    kind = Format.json if as_json else kind
    if kind in (Format.fits, Format.hdf5) and output is None and sys.stdout.isatty():
        raise BadInputError("--output", f"a file for {kind.value}", "a terminal")
    if kind is Format.table and output is not None:
        raise BadInputError("--format", "json, csv, ecsv, fits, hdf5 or nuradio with --output", "table")
    with Client() as client:
        wire = "json" if kind is Format.table else kind.value
        about = {"as_of": as_of, "gap": gap, "scope": scope, "tag": tag, "format": wire}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", CachedAnswerWarning)  # said below, in the command's words
            body = client.effective(station, antenna, dipole, at=at, **about)
        if client.snapshot is not None:
            print(f"lbacal: from the cache: {describe_snapshot(client.snapshot)}", file=sys.stderr)
    if output is not None:
        with written_beside(output) as beside:
            beside.write_bytes(body)
        print(f"wrote {output} as {kind.value}")
    elif kind is not Format.table:
        sys.stdout.buffer.write(body)
    else:
        for curve in json.loads(body)["curves"]:
            print_curve(curve, is_explained=why)


def sync(
    tag: Annotated[str, typer.Argument(help="Name of the tag.")],
    station: Annotated[
        list[str] | None, typer.Option(help="Only this station, without the array; may be given several times.")
    ] = None,
    since: Annotated[str | None, typer.Option(help="Only what is in effect from here on, ISO 8601, UTC.")] = None,
    until: Annotated[str | None, typer.Option(help="Only what is in effect before.")] = None,
    as_json: Json = False,
) -> None:
    """Bring the calibrations of a tag into LBACAL_CACHE, where `effective` finds them while no server answers.

    Example: LBACAL_CACHE=~/.cache/lbacal lbacal sync paper-2026

    Run again, it fetches what is missing or damaged. With --station, --since or --until it holds that part alone.
    """
    with Client() as client, progress() as tell:
        snapshot, fetched = client.sync(
            tag, lambda k, n: tell(f"{k} of {n} answers", k, n), stations=station or (), since=since, until=until
        )
    made = vars(snapshot) | {"stations": list(snapshot.stations), "files": len(snapshot.files), "fetched": fetched}
    told = f"{describe_snapshot(snapshot)}: {len(snapshot.files)} files, {fetched} answers fetched"
    show(made, lambda _: print(told), as_json=as_json)


def refit(
    scope: Annotated[str, typer.Option(help="array, station or antenna: what one version belongs to.")],
    since: Annotated[str, typer.Option(help="First instant of the window, ISO 8601, UTC.")],
    until: Annotated[str, typer.Option(help="End of the window, not included.")],
    reason: Annotated[str, typer.Option(help="Why; it is kept.")],
    station: Station = None,
    antenna: Antenna = None,
    dipole: Dipole = None,
    promote: Annotated[bool, typer.Option("--promote", help="Put into effect what passes the gate.")] = False,
    wait: Annotated[bool, typer.Option(help="Wait until the fits have ended.")] = True,
    fit: Annotated[str, typer.Option(help="years: one chain through the years; year: the window by itself.")] = "years",
    as_json: Json = False,
) -> None:
    """Ask for new fits over a window, one fit a version.

    Example: lbacal refit --scope antenna --since 2014-01-01 --until 2015-01-01 --reason "new cables" --promote
    """
    with Client() as client:
        job = client.refit(
            scope, since, until, reason=reason, station=station, antenna=antenna, dipole=dipole, promote=promote,
            wait=False, fit=fit,
        )  # fmt: skip
        job = wait_for(client, job["job"]) if wait else job
    show(job, partial(print_job, most=SHOWN), as_json=as_json)
    if job["state"] == "failed":
        raise typer.Exit(1)


def jobs(
    number: Annotated[int | None, typer.Argument(help="One job; without it the newest 20.")] = None,
    as_json: Json = False,
) -> None:
    """Show a job and its progress, or the newest jobs.

    Example: lbacal jobs 12
    """
    with Client() as client:
        found = [client.job(number)] if number is not None else client.get("/v1/jobs", limit=20)["jobs"]
    show_each(found, partial(print_job, most=0 if number is None else SHOWN), "no jobs", as_json=as_json)


def print_receipt(total: dict[str, Any]) -> None:
    """Print how many spectra were sent and stored."""
    print_warnings(total)
    sent = write_count(total["received"], "spectrum", "spectra")
    known = total.get("covariates", 0)
    more = f", {write_count(known, 'covariate')} of events that were there known now" if known else ""
    print(f"{sent} sent: {total['stored']} stored, {total['duplicates']} there already{more}")


def print_warnings(receipt: dict[str, Any]) -> None:
    """Print what the server warns of when spectra come in."""
    for sentence in receipt.pop("warnings", []):
        print(f"lbacal: warning: {sentence}", file=sys.stderr)


def print_curve(curve: dict[str, Any], *, is_explained: bool = False) -> None:
    """Print a curve in effect: who answers, for how long, and C(nu)."""
    path = name_path(curve["station"], curve["antenna"], curve["dipole"])
    is_path = curve["antenna"] is not None
    owner = path if is_path else f"array {curve['dipole']}, reference chain: nobody's cable"
    print(f"{owner}: version {curve['calibration'][:12]}")
    valid, chain = curve["valid"], curve["reference"]
    mean = f" (mean of {chain['paths']} paths)" if chain else ""
    through = f"{mean} through its own cable {chain['cable']}" if chain and chain["cable"] else mean
    until = valid["to"] or "further notice"
    print(f"  answered by {curve['answered_by']}{through}, promoted for {valid['from']} to {until}")
    if is_explained:
        print(f"  why: {curve.get('why', 'this answer is of a release that does not say')}")
    if curve["flag_reason"]:
        print(f"  uncertain: {curve['flag_reason']}")
    print("  frequency_mhz             c  c_sigma_stat  c_sigma_sys   (V per ADC unit)  flag")
    of_system = curve["c_sigma_sys"] or [None] * len(curve["c"])
    rows = zip(curve["frequency_mhz"], curve["c"], curve["c_sigma_stat"], of_system, curve["flag"], strict=True)
    for frequency, c, sigma, system, flag in rows:
        if c is None:
            print(f"  {frequency:13g} {'unknown':>13} {'':13} {'':12} {'':20} {flag}")
            continue
        of_rest = "unknown" if system is None else f"{system:.3g}"
        print(f"  {frequency:13g} {c:13.6g} {sigma:13.3g} {of_rest:>12} {'':20} {flag}")


def wait_for(client: Client, number: int) -> dict[str, Any]:
    """Wait for a job until it has ended, and show how far it is; the job as `Client.job` gives it."""
    with progress() as tell:
        return client.wait_for(number, lambda job: tell(f"job {number} {job['state']}, {job['progress']:.0%}"))


def print_job(job: dict[str, Any], *, most: int = 0) -> None:
    """Print one line about a job, with what a refit made, and why it failed or what the gate kept back.

    So many of its versions and investigations are named beside, each by the first digits of its id.
    """
    request = job["request"]
    name = " ".join([job["kind"], *(str(request[k]) for k in ("scope", "station") if request.get(k))])
    name += f" {request['since'][:10]} to {request['until'][:10]}" if "since" in request else ""
    counts = {"versions": len(job["calibrations"]), "promoted": len(job["promoted"]), "no news": job["examined"]}
    made = "".join(f", {what}: {count}" for what, count in counts.items()) if job["kind"] == "refit" else ""
    print(f"job {job['job']}: {name}, {job['state']} ({job['progress']:.0%}){made}; {job['reason']}")
    if job["error"]:
        print(f"  {job['error']}")
    for version, why in job["gated"].items():
        print(f"  {version[:12]} not promoted: {why}")
    if job["kind"] == "refit" and job["state"] == "done" and not (job["promoted"] or job["gated"]):
        if not job["calibrations"] and not job["examined"]:
            print("  no version was made: no spectra of this window and scope are stored")
        elif job["calibrations"] and not request.get("promote"):
            print(f"  not promoted: nobody asked for it; lbacal promote --job {job['job']} does it")
        elif job["calibrations"]:
            print("  not promoted: what was made is in effect, or a person withdrew it")
    named = [(one, "promoted") for one in job["promoted"]]
    named += [(one, "made") for one in job["calibrations"] if one not in job["promoted"] and one not in job["gated"]]
    named += [(one, "investigation") for one in job["results"]]
    for one, what in named[:most]:
        print(f"  {one[:12]} {what}")
    if len(named) > most > 0:
        print(f"  and {len(named) - most} more")
