"""Nothing hidden: how often the finder says that something is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lbacal_core.instrument import DIPOLES, load_instrument
from lbacal_core.lstcurve.compare import AS_RECORDED, band_weights
from lbacal_core.lstcurve.curve import LstCurve
from proofs.hidden.data_sets import FEW_EVENTS, SMALLEST, comparable, plain, realistic, sky_power
from proofs.hidden.finder import Answer, ask_of_curve
from proofs.machinery.trials import Rate, run_trials

FALSE_ALARM_LIMIT = 0.01
BAND_MHZ = (30.0, 80.0)
POINTS, POINT_NOISE_DB, SHARED = 46, 0.05, 0.9
"""Points of a curve, their noise, and the part of its variance that X and Y share: those of the measured curve."""


@dataclass(frozen=True)
class Kind:
    """Data with nothing hidden: what they are, and what the finder answers to those of a number."""

    name: str
    ask: Callable[[int], Answer]


def ask_plain(number: int) -> Answer:
    """A station-year."""
    return plain(number).ask()


def ask_realistic(number: int) -> Answer:
    """A station-year with every nuisance."""
    return realistic(number).ask()


def ask_comparable(number: int) -> Answer:
    """A station-year with enough antennas to compare them with each other."""
    return comparable(number).ask()


def ask_own_sky(number: int) -> Answer:
    """A station-year with every nuisance, the sky power being one of several that could be right."""
    return realistic(number).ask(is_own_sky=True)


def ask_curve(number: int) -> Answer:
    """A band-averaged LST curve."""
    chain, rng = load_instrument("lofar-superterp"), np.random.default_rng([20261122, number])
    lst_hours = 24.0 * (np.arange(POINTS) + 0.5) / POINTS
    weights = band_weights(chain, AS_RECORDED, BAND_MHZ)
    shared = SHARED**0.5 * rng.standard_normal(POINTS)
    variation = {}
    for dipole in DIPOLES:
        band = sky_power().at(dipole, lst_hours) @ weights
        noise = shared + (1 - SHARED) ** 0.5 * rng.standard_normal(POINTS)
        variation[dipole] = 10 * np.log10(band / band.mean()) + POINT_NOISE_DB * noise
    curve = LstCurve(lst_hours, variation, np.full(POINTS, 0.11), 0.5, is_centre_stated=True, origin="simulated")
    return ask_of_curve(curve, sky_power(), chain, BAND_MHZ)


PLAIN = (Kind("without nuisances", ask_plain),)
NUISANCES = (Kind("with nuisances", ask_realistic),)
OTHERS = (
    Kind("ten antennas, compared for static causes", ask_comparable),
    Kind("with nuisances, differences between sky models projected out", ask_own_sky),
    Kind(f"LST curves of {POINTS} points", ask_curve),
)


def listen(task: tuple[Kind, int]) -> str:
    """What is said of data with nothing hidden; empty if nothing."""
    kind, number = task
    answer = kind.ask(number)
    if answer.verdict == "consistent":
        return ""
    return f"{number}: {answer.verdict} {'+'.join(answer.named) or answer.axis}"


def prove_clean(count: int) -> tuple[bool, list[str]]:
    """`count` data sets without nuisances."""
    return _count_alarms(PLAIN, count)


def prove_nuisances(count: int) -> tuple[bool, list[str]]:
    """`count` data sets with every nuisance."""
    return _count_alarms(NUISANCES, count)


def prove_clean_other(count: int) -> tuple[bool, list[str]]:
    """`count` data of each of the other kinds."""
    return _count_alarms(OTHERS, count)


def _count_alarms(kinds: Sequence[Kind], count: int) -> tuple[bool, list[str]]:
    holds, lines = True, ["", f"Stations of {len(SMALLEST)} antennas unless said otherwise, {FEW_EVENTS} events."]
    for kind in kinds:
        alarms = [said for said in run_trials(listen, [(kind, n) for n in range(count)], f"clean, {kind.name}") if said]
        rate = Rate(len(alarms), count)
        holds &= rate.is_at_most(FALSE_ALARM_LIMIT)
        what = "; ".join(alarms)
        lines.append(f"**Nothing hidden**, {kind.name}: not consistent in {rate}{f': {what}' if what else ''}.")
    return holds, lines
