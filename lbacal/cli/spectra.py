"""`lbacal spectra` and `lbacal import`: raw antenna traces, and data in other formats, to background spectra."""

from __future__ import annotations

import json
import sys
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from lbacal.cli.outputs import Dask, progress, require_ending, require_outputs
from lbacal.engine import Engine, read_address
from lbacal.files import written_beside
from lbacal.selection import SUFFIXES
from lbacal_core.errors import BadInputError, LbacalError, UnreadableFileError
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.spectra.spectra import Spectra, write_spectra

LOFAR_CORE_LONGITUDE_DEG = 6.87
"""Longitude of the Superterp (van Haarlem et al. 2013) to 0.01 deg (2 s of LST): to print LST and for the cut."""


def spectra(
    traces: Annotated[list[Path], typer.Argument(help="Raw traces (TBB frames or HDF5), or folders of them.")],
    output: Annotated[Path | None, typer.Option(help="Spectra file to write (HDF5).")] = None,
    blocks: Annotated[
        int | None, typer.Option(help="Average this many background blocks a trace; without it all.")
    ] = None,
    event_id: Annotated[
        str | None, typer.Option(help="Name of the event; without it the UTC second in which it starts.")
    ] = None,
    events: Annotated[
        Path | None,
        typer.Option(help="CSV of event_id, pulse_unix, temperature_c, rain_mm_h (all but the first optional)."),
    ] = None,
    antenna_set: Annotated[
        str | None,
        typer.Option(
            help="LBA_OUTER, LBA_INNER, LBA_SPARSE_EVEN or _ODD, LBA_X or LBA_Y, where the header has none, or a wrong "
            "one; decides which receiver is X."
        ),
    ] = None,
    instrument: Annotated[
        str | None, typer.Option(help="Instrument (name or JSON file) whose channels and longitude to use.")
    ] = None,
    inspect: Annotated[
        Path | None, typer.Option(help="Draw the first trace (PNG): samples, spectrum before and after, flags.")
    ] = None,
    url: Annotated[
        str | None, typer.Option(help="Send the spectra to this service as well (key: LBACAL_API_KEY).")
    ] = None,
    dask: Dask = None,
) -> None:
    """Clean and average raw antenna traces to background spectra, one spectrum a trace.

    Example: lbacal spectra dumps/2011-07-19 --output S.h5

    A run that was stopped is simply repeated; S.h5.report.json says for every trace what was left out, and why. Exit 1
    if some traces failed (the others are written).
    """
    from lbacal_core.traces.assembly import EventFacts, read_event_facts
    from lbacal_core.traces.background import CleaningSettings
    from lbacal_core.traces.trace import find_files, group_traces, require_antenna_set

    require_antenna_set(antenna_set)
    if output is None and inspect is None:
        raise BadInputError("lbacal spectra", "--output or --inspect", "--url alone" if url else "neither")
    inputs = {"--instrument": instrument, "--events": events, **{str(trace): trace for trace in traces}}
    require_outputs({"--output": output, "--inspect": inspect}, inputs)
    if output is not None:
        require_ending("--output", output, SUFFIXES)
    chain = load_instrument(instrument) if instrument else None
    settings = CleaningSettings(blocks=blocks) if chain is None else CleaningSettings(chain.frequency_mhz, blocks)
    facts = read_event_facts(events) if events else EventFacts()
    files = find_files(traces)
    if not files:
        raise BadInputError(", ".join(str(path) for path in traces), "traces (.h5, .hdf5, .dat)", "none")
    references, failures = _list_all(files, set(traces), antenna_set)
    if not references:
        raise UnreadableFileError(failures[0]["error"])
    work = [(event, facts.pulse_unix.get(event.event_id)) for event in group_traces(references, event_id)]
    if inspect is not None:
        _draw(work[0], settings, inspect)
    if output is not None:
        longitude = chain.longitude_deg if chain else LOFAR_CORE_LONGITUDE_DEG
        with Engine(read_address(dask)) as engine:
            measured = _reduce(work, settings, facts, output, longitude, engine, failures)
        if url is not None:
            from lbacal.cli.client import print_warnings
            from lbacal.client import Client

            with Client(url) as client:
                receipt = client.ingest(measured)
            print_warnings(receipt)
            print(f"{url}: " + ", ".join(f"{count} {word}" for word, count in receipt.items()))
    if failures:
        raise typer.Exit(1)


def _list_all(files: list[Path], named: set[Path], antenna_set: str | None) -> tuple[list[Any], list[dict[str, str]]]:
    """List the traces of all files; what is wrong with a file found in a folder must not stop the others."""
    from lbacal_core.traces.trace import list_traces

    references: list[Any] = []
    failures = []
    for file in files:
        try:
            references += list_traces(file, antenna_set)
        except LbacalError as error:
            if file in named:
                raise
            print(f"left out: {error}")
            failures.append({"file": str(file), "error": str(error)})
    return references, failures


def _reduce(
    work: list[Any],
    settings: Any,
    facts: Any,
    output: Path,
    longitude: float,
    engine: Engine,
    failures: list[dict[str, str]],
) -> Spectra:
    """Measure all station events, cut the anomalous, write spectra and report."""
    from lbacal.cli.trace_batch import TraceBatch
    from lbacal_core.traces.assembly import assemble_spectra, find_anomalous_spectra

    batch = TraceBatch(work, settings, output.with_name(output.name + ".parts"))
    records: list[dict[str, Any]] = []
    with progress(len(work)) as tell:
        say = tell if sys.stdout.isatty() else partial(print, flush=True)
        for event, result, is_old in batch.run(engine):
            if isinstance(result, str):
                failures.append({"event_id": event.event_id, "station": event.station, "error": result})
                say(f"{event.name}: failed: {result}")
                continue
            records += result
            say(_describe(event.name, result, longitude, is_old))
    measured = assemble_spectra(records, settings, facts)
    reasons = find_anomalous_spectra(measured, longitude)
    for record in records:
        key = (record["event_id"], record["station"], record["antenna"], record["dipole"])
        record["excluded"] = record["excluded"] or reasons.get(key, "")
    measured = assemble_spectra(records, settings, facts)
    report = output.with_name(output.name + ".report.json")
    facts_of_paths = [{name: value for name, value in record.items() if name != "power"} for record in records]
    with written_beside(report) as beside:
        beside.write_text(json.dumps({"paths": facts_of_paths, "failures": failures}, indent=1))
    for record in records:
        if record["excluded"]:
            print(f"{record['event_id']} {record['station']} RCU {record['rcu']} excluded: {record['excluded']}")
    if len(measured) == 0:
        raise LbacalError(f"no usable spectrum in {len(records)} traces; {report} says why")
    with written_beside(output) as beside:
        write_spectra(measured, beside)
    print(f"wrote {output}: {len(measured)} spectra of {len(records)} traces; {report} says what was left out")
    return measured


def _describe(name: str, records: list[dict[str, Any]], longitude: float, is_old: bool) -> str:
    """One line on a station event."""
    import numpy as np

    from lbacal_core.instrument.sidereal import local_sidereal_time

    usable = [record for record in records if not record["excluded"]]
    lst = float(local_sidereal_time(np.array(records[0]["time_unix"]), longitude))
    blocks = f"{min(r['blocks'] for r in usable)}-{max(r['blocks'] for r in usable)} blocks" if usable else "no blocks"
    flagged = 100 * float(np.mean([record["flagged_fraction"] for record in usable])) if usable else 0.0
    faults = sorted({fault for record in records for fault in record["faults"]})
    words = (
        f"{name}: {len(usable)} of {len(records)} paths, {blocks}, {flagged:.0f} % of channels flagged, LST {lst:.2f} h"
    )
    return words + (f", {', '.join(faults)}" if faults else "") + (" (done before)" if is_old else "")


def _draw(item: Any, settings: Any, path: Path) -> None:
    """Draw the first trace of a station event."""
    from lbacal_core.traces.background import measure_background
    from lbacal_core.traces.inspection import draw_inspection
    from lbacal_core.traces.trace import read_trace

    event, pulse_unix = item
    background = measure_background(event.references, settings, pulse_unix)[0]
    with written_beside(path) as beside:
        draw_inspection(read_trace(event.references[0]), background, settings).savefig(beside, dpi=110)
    print(f"wrote {path}: {event.event_id} {background.reference.name}")


# `lbacal import`: data in other formats to background spectra.


def import_(
    source: Annotated[
        Path,
        typer.Argument(help="File or folder: .uvh5, .uvfits, .ms, SST of LOFAR, NenuFAR, SKA-Low's .hdf5, .csv, .npz."),
    ],
    output: Annotated[Path, typer.Option(help="Spectra file to write (HDF5).")],
    average: Annotated[
        float | None, typer.Option(help="Seconds that one spectrum averages (900 of what has no event_id).")
    ] = None,
    events: Annotated[
        bool, typer.Option("--events", help="Every integration is an event of its own: one spectrum each.")
    ] = False,
    instrument: Annotated[
        str | None, typer.Option(help="Instrument (name or JSON file) whose channels to average to.")
    ] = None,
    channel_mhz: Annotated[float | None, typer.Option(help="Width of the channels to average to, MHz.")] = None,
    band: Annotated[
        tuple[float, float] | None, typer.Option(help="Lowest and highest channel, MHz.", metavar="LO HI")
    ] = None,
    station: Annotated[str | None, typer.Option(help="Name of the station where the data have none.")] = None,
) -> None:
    """Average autocorrelations or station statistics to background spectra, whatever the length of the data.

    Example: lbacal import zen.autos.uvh5 --output S.h5 --average 60 --channel-mhz 1 --band 50 200

    Flagged samples count nowhere; quality flags of integrations stay with their spectra.
    """
    from lbacal.analysis.data import import_data

    require_outputs({"--output": output}, {"SOURCE": source, "--instrument": instrument})
    require_ending("--output", output, SUFFIXES)
    with progress() as tell:
        spectra = import_data(source, average, instrument, channel_mhz, band, station, events=events, tell=tell)
    spectra.save(output, ".h5")
    print("\n".join([*spectra.notes[:-1], f"wrote {output}: {spectra.notes[-1]}"]))
