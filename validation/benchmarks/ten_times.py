"""What fifty stations cost beside six: .venv/bin/python -m validation.benchmarks.ten_times [EVENTS [FEW MANY]].

Each has two years of EVENTS of 96 paths of each station, on SQLite. The first look of the scheduler finds all due, a
worker makes all calibrations; then an event of all stations arrives, and both do it again. At last a server answers
about everything. Each component is a process of its own: its processor time is that of its work without its start, and
its memory the most that it ever held. Stations are copies of one simulated station with noise of their own. With 900
events, which is what a year brings, spectra and fits are 900/EVENTS as many; looks, answers and versions stay the same.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import re
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.table import read_sky_power, write_sky_power
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings
from service.cli.opening import configure_logs
from service.config import Settings
from service.factory import Factory
from service.scheduler import look_for_due_work
from service.storage.migration import upgrade
from service.worker import Worker
from validation.running.processes import Process, find_free_port, get, is_ready, wait_until

FEW, MANY = 6, 50
LIKE = "CS002"
YEARS = 1.999
SCATTER = 0.02
NEW = "one more"
TICKS = os.sysconf("SC_CLK_TCK")
ASKED = {
    "effective, all paths": "/v1/calibrations/effective?at=2014-07-01",
    "effective, a station": "/v1/calibrations/effective?at=2014-07-01&station=S00",
    "effective, one path": "/v1/calibrations/effective?at=2014-07-01&station=S00&antenna=7&dipole=X",
    "status": "/v1/status",
    "events": "/v1/events?limit=1000",
    "drift": "/v1/drift",
    "changes": "/v1/changes",
    "bad antennas": "/v1/antennas/bad?at=2014-07-01",
    "life of a path": "/v1/paths/S00/7/X/life",
    "overview": "/",
    "page of a station": "/stations/S00",
    "page of drift": "/drift",
    "page of jobs": "/jobs",
}


def describe(folder: Path, stations: int) -> dict[str, Any]:
    """The settings of a service of an array of some stations, whose instrument and sky are written into a folder."""
    content = json.loads((files("lbacal_core") / "data/instruments/lofar-superterp.json").read_text(encoding="utf-8"))
    content["antennas"] = [
        {**one, "station": f"S{k:02d}"}
        for k in range(stations)
        for one in content["antennas"]
        if one["station"] == LIKE
    ]
    (folder / "array.json").write_text(json.dumps(content))
    instrument = load_instrument(str(folder / "array.json"))
    write_sky_power(compute_sky_power(instrument, lst_hours=np.arange(0.0, 24.0, 0.5)), folder / "sky.json")
    return {
        "database_url": str(folder / "array.sqlite"),
        "instrument": str(folder / "array.json"),
        "sky_power": folder / "sky.json",
        "nightly_investigations": False,
    }


def copies(folder: Path, stations: int, events: int) -> Iterator[Spectra]:
    """Spectra of each station; those of the last event have a name of their own."""
    settings = TwinSettings(stations=(LIKE,), events_per_year=events, years=YEARS)
    sky = read_sky_power(folder / "sky.json")
    one = simulate_campaign(settings, load_instrument("lofar-superterp"), sky, np.random.default_rng(1)).spectra
    last = one.event_id == one.event_id[np.argmax(one.time_unix)]
    named = replace(one, event_id=np.where(last, NEW, one.event_id))
    for k in range(stations):
        power = one.power * np.random.default_rng([2, k]).lognormal(0.0, SCATTER, one.power.shape)
        yield replace(named, power=power, station=np.full(len(one), f"S{k:02d}"))


def store(settings: dict[str, Any], spectra: Spectra) -> None:
    factory = Factory(Settings(**settings))
    with factory.database.write() as stores:
        stores.spectra.add(spectra)
    factory.database.close()


def fill(settings: dict[str, Any], folder: Path, stations: int, events: int) -> list[Spectra]:
    """Store the spectra of all stations without the last event; that, by station."""
    factory = Factory(Settings(**settings))
    upgrade(factory.database)
    factory.database.close()
    last = []
    for spectra in copies(folder, stations, events):
        is_last = spectra.event_id == NEW
        store(settings, spectra.select(~is_last))
        last.append(spectra.select(is_last))
    return last


def look(settings: dict[str, Any]) -> None:
    look_for_due_work(Factory(Settings(**settings)))


def work(settings: dict[str, Any]) -> None:
    Worker(Factory(Settings(**settings))).run(threading.Event(), until_idle=True)


def measure(does: Callable[[dict[str, Any]], None], settings: dict[str, Any]) -> tuple[float, float]:
    """Seconds of processor time of a component in a process of its own, and the most memory of that, GB."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_measure_here, (does, settings))


def _measure_here(does: Callable[[dict[str, Any]], None], settings: dict[str, Any]) -> tuple[float, float]:
    configure_logs("warning")
    begin = time.process_time()
    does(settings)
    return time.process_time() - begin, most_memory("self")


def most_memory(process: int | str) -> float:
    """The most memory that a process ever held, GB."""
    status = Path(f"/proc/{process}/status").read_text(encoding="ascii")
    return int(re.search(r"VmHWM:\s+(\d+)", status)[1]) / 1e6  # type: ignore[index] # Linux says it of every process


def used(process: int) -> float:
    """Processor time of a process, s."""
    fields = Path(f"/proc/{process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def ask_all(settings: dict[str, Any], folder: Path) -> dict[str, tuple[float, float]]:
    """Seconds of the server's processor time of each answer, and the most memory until then, GB."""
    port = find_free_port()
    environment = {f"LBACAL_{name.upper()}": str(value) for name, value in settings.items()} | {
        "LBACAL_LOG_LEVEL": "warning"
    }
    server = Process(environment, folder / "log", "serve", "--port", str(port), "--api-only")
    found = {}
    try:
        wait_until(lambda: is_ready(f"http://127.0.0.1:{port}", "healthz"), "the server")
        for name, address in ASKED.items():
            begin = used(server.number)
            get(f"http://127.0.0.1:{port}{address}", timeout=120).raise_for_status()
            found[f"server: {name}"] = used(server.number) - begin, most_memory(server.number)
    finally:
        server.stop()
    return found


def run(folder: Path, stations: int, events: int) -> dict[str, tuple[float, float]]:
    """Processor time, s, and memory, GB, by component."""
    settings = describe(folder, stations)
    last = fill(settings, folder, stations, events)
    found = {}
    for night in ("all", "one more event"):
        found[f"look, {night}"] = measure(look, settings)
        found[f"worker, {night}"] = measure(work, settings)
        if night == "all":
            for spectra in last:
                store(settings, spectra)
    found["look, nothing due"] = measure(look, settings)
    found |= ask_all(settings, folder)
    size = (folder / "array.sqlite").stat().st_size / 1e9
    print(f"{stations} stations, two years of {events} events: {size:.2f} GB", flush=True)
    for name, (seconds, memory) in found.items():
        print(f"  {name}: {seconds:.2f} s, {1e3 * seconds / stations:.1f} ms a station, {memory:.2f} GB", flush=True)
    return found


def main(events: int = 120, few: int = FEW, many: int = MANY) -> None:
    configure_logs("warning")
    both = []
    for stations in (few, many):
        with tempfile.TemporaryDirectory(prefix="lbacal-ten-times-") as name:
            both.append(run(Path(name), stations, events))
    print(f"{many} stations over {few}, for each station:")
    for name, (seconds, memory) in both[1].items():
        before = both[0][name]
        print(f"  {name}: time {seconds / max(before[0], 0.01) * few / many:.2f}, memory {memory / before[1]:.2f}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
