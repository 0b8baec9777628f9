"""How long one station-year takes to question, and how that grows.

Run: python -m validation.benchmarks.investigate

Nothing hidden: every cause is scanned for every path, antenna, cable and the station, calibrated for look-elsewhere;
then structure is looked for without a catalogue. With a gain that follows temperature: refits, the held-out test and a
second scan come on top. With the package's own sky the differences between sky models are free as well. Each question
is asked in a process of its own, so that its largest memory is that of one investigation. The reference of the same run
is one refit for each template and target, from the time of one.
"""

from __future__ import annotations

import multiprocessing
import resource
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from threadpoolctl import threadpool_limits

from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.discovery.hypothesis import Hypothesis, list_targets
from lbacal_core.discovery.refit import fit_chain, refit
from lbacal_core.discovery.report import investigate
from lbacal_core.discovery.scan import scan
from lbacal_core.discovery.station import gather_stations
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.hardware import GainTemperature
from lbacal_twin.settings import TwinSettings
from validation.benchmarks.timing import time_once
from validation.superterp import power_of, superterp

SIZES = ((900, 48), (450, 48), (900, 24), (450, 24), (900, 12))
SIZE = 0.01
"""Fraction of a gain that follows temperature, per 10 K."""


def simulate(events: int, antennas: int, size: float) -> Spectra:
    settings = TwinSettings(stations=("CS002",), antennas=antennas, events_per_year=events)
    faults = [GainTemperature(size=size)] if size else []
    return simulate_campaign(settings, superterp(), power_of(), np.random.default_rng(1), faults).spectra


def question(events: int, antennas: int, size: float, *, is_own_sky: bool) -> str:
    """Simulate and investigate, and say how long the investigation took and the largest memory of the process."""
    spectra = simulate(events, antennas, size)
    simulation = Simulation(superterp(), power_of(), is_own_sky=is_own_sky)
    (report, _), wall, processor = time_once(lambda: investigate(spectra, simulation))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return f"{wall:.1f} s ({processor:.1f} s of processor time), {memory:.2f} GiB, {report['verdict']}"


def ask(events: int, antennas: int, size: float = 0.0, *, is_own_sky: bool = False) -> None:
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        told = pool.submit(question, events, antennas, size, is_own_sky=is_own_sky).result()
    hidden = ", a gain that follows temperature" if size else ""
    own = ", the package's own sky" if is_own_sky else ""
    print(f"{events} events, {antennas} antennas{own}{hidden}: {told}", flush=True)


def main() -> None:
    for events, antennas in SIZES:
        ask(events, antennas)
    for antennas in (12, 48):
        ask(900, antennas, SIZE)
    for size in (0.0, SIZE):
        ask(900, 12, size, is_own_sky=True)
    spectra = simulate(900, 48, SIZE)
    with threadpool_limits(1):
        (station,) = gather_stations(spectra, Simulation(superterp(), power_of()))
        plain, targets = fit_chain(station), list_targets(station)
        found, scanned, _ = time_once(lambda: scan(plain.linear, CAUSES, targets))
        best = Hypothesis(found[0].cause, found[0].template, found[0].target, 0.0)
        one_refit = time_once(lambda: refit(plain, best))[1]
    number = sum(
        len(cause.templates(station.conditions)) * sum(target.scope in cause.scopes for target in targets)
        for cause in CAUSES
    )
    print(f"scan of {number} (cause, template, target): {scanned:.1f} s; one refit {one_refit:.1f} s, all by refits")
    print(f"{number * one_refit / 3600:.0f} h: {number * one_refit / scanned:.0f} times as long")


if __name__ == "__main__":
    main()
