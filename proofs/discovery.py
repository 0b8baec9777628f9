"""What `lbacal investigate` finds in simulated stations: nothing where nothing is hidden, and each planted cause.

Options: --clean N (data sets with nothing hidden), --realistic N (with the twin's nuisances), --causes (one data set
for each cause of the twin's catalogue, at a size made for 10 sigma), --others (one for each effect in no catalogue).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest

from lbacal_core.discovery.report import investigate
from lbacal_core.instrument import load_instrument
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.twin.campaign import simulate_campaign
from lbacal_core.twin.faults.catalogue import catalogue_faults, draw_fault
from lbacal_core.twin.faults.fault import Fault
from lbacal_core.twin.faults.uncatalogued import uncatalogued_faults
from lbacal_core.twin.nuisances import NONE, REALISTIC, Nuisances
from lbacal_core.twin.settings import TwinSettings

SETTINGS = TwinSettings(stations=("CS002",), antennas=6, events_per_year=250)
SIZES = 5.4
"""The twin's typical sizes are some 10 sigma for 48 antennas and 900 events; this makes up for fewer of both."""
FALSE_ALARM_LIMIT = 0.01
"""Asked for; a run does not hold when even the lower end of its interval is above."""


@dataclass(frozen=True)
class Answer:
    """The verdict on one data set and the causes named, most significant first."""

    verdict: str
    named: list[str]
    set_of_first: list[str]
    axis: str


def ask(seed: int, faults: Sequence[Fault] = (), nuisances: Nuisances = NONE) -> Answer:
    """Simulate one station-year and investigate it."""
    chain = load_instrument("lofar-superterp")
    sky = compute_sky_power(chain)
    rng = np.random.default_rng([20261121, seed])
    spectra = simulate_campaign(SETTINGS, chain, sky, rng, faults, nuisances).spectra
    report, _ = investigate(spectra, chain, sky, seed=seed)
    findings = report["findings"]
    return Answer(
        report["verdict"],
        [finding["cause"] for finding in findings],
        [findings[0]["cause"], *findings[0]["indistinguishable"]] if findings else [],
        report["unexplained"]["where"]["axis"] if report["unexplained"] else "",
    )


def prove(arguments: list[str]) -> tuple[bool, list[str]]:
    """Run the parts asked for; without options 40 clean data sets."""
    parser = argparse.ArgumentParser(prog="./dev prove discovery", description=__doc__)
    parser.add_argument("--clean", type=int, default=0)
    parser.add_argument("--realistic", type=int, default=0)
    parser.add_argument("--causes", action="store_true")
    parser.add_argument("--others", action="store_true")
    chosen = parser.parse_args(arguments or ["--clean", "40"])
    holds, lines = True, [f"{SETTINGS.antennas} antennas of CS002, {SETTINGS.events_per_year} events."]
    for name, count, nuisances in (("clean", chosen.clean, NONE), ("realistic", chosen.realistic, REALISTIC)):
        if count:
            is_good, line = _false_alarms(name, count, nuisances)
            holds, lines = holds and is_good, [*lines, line]
    if chosen.causes:
        lines += _causes()
    if chosen.others:
        lines += _others()
    return holds, lines


def _false_alarms(name: str, count: int, nuisances: Nuisances) -> tuple[bool, str]:
    answers = [ask(seed, nuisances=nuisances) for seed in range(count)]
    wrong = [answer for answer in answers if answer.verdict != "consistent"]
    interval = binomtest(len(wrong), count).proportion_ci(method="wilson")
    what = "; ".join(f"{answer.verdict} {'+'.join(answer.named) or answer.axis}" for answer in wrong)
    between = f"95 % interval {interval.low:.4f}-{interval.high:.4f}"
    text = f"Nothing hidden, {name}: {len(wrong)} of {count} not consistent, {between}"
    return interval.low <= FALSE_ALARM_LIMIT, f"{text}{f' ({what})' if what else ''}."


def _causes() -> list[str]:
    head = "| planted | verdict | named | cannot be told from |"
    rows = ["", head, "|---|---|---|---|"]
    hits = 0
    names = sorted(catalogue_faults())
    for seed, name in enumerate(names):
        size = SIZES * catalogue_faults()[name].typical
        fault = draw_fault(name, np.random.default_rng(seed), SETTINGS, 1.0 if name == "dipole_swap" else size)
        answer = ask(1000 + seed, [fault])
        hits += name in answer.named[:1] or name in answer.set_of_first
        rows.append(f"| {name} | {answer.verdict} | {', '.join(answer.named)} | {', '.join(answer.set_of_first[1:])} |")
    return [*rows, "", f"Named first or in the set of the first: {hits} of {len(names)}."]


def _others() -> list[str]:
    rows = ["", "| planted, in no catalogue | verdict | axis | named |", "|---|---|---|---|"]
    for seed, (name, kind) in enumerate(uncatalogued_faults().items()):
        answer = ask(2000 + seed, [kind(size=0.2)])
        rows.append(f"| {kind.__name__} ({name}) | {answer.verdict} | {answer.axis} | {', '.join(answer.named)} |")
    return rows
