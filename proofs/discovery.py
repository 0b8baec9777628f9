"""What `lbacal investigate` finds in simulated stations, against an ideal detector that knows everything.

Parts (`--part NAME`, several times; all of them without): clean (nothing hidden, with and without nuisances),
clean-other (nothing hidden, ten antennas, and a sky that is the package's own), one (one effect of a drawn cause),
efficiency (cause by cause), several (two and three effects), unknown (effects in no catalogue), held-out (what was
found, removed from unseen events). `--count N`: data sets of a part, or of each kind in it; the defaults are small.
`--figure` draws docs/images/discovery.png from one and efficiency.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from proofs._discovery_figure import draw_detection
from proofs._held_out import prove_held_out
from proofs._hidden import (
    ALIKE,
    EVENTS,
    FEW_EVENTS,
    SMALL,
    SMALLEST,
    STATION,
    DataSet,
    comparable,
    plain,
    realistic,
)
from proofs._no_catalogue import prove_unknown
from proofs._one_effect import prove_detection, prove_efficiency
from proofs._several_effects import prove_several
from proofs._trials import Rate, run_trials

FALSE_ALARM_LIMIT = 0.01
IMAGE = Path(__file__).parents[1] / "docs" / "images" / "discovery.png"
PARTS = {"clean": 40, "clean-other": 20, "one": 8, "efficiency": 4, "several": 8, "unknown": 2, "held-out": 12}
"""Parts, and how many data sets they have unless said otherwise."""


def prove(arguments: list[str]) -> tuple[bool, list[str]]:
    """Run the parts asked for."""
    parser = argparse.ArgumentParser(prog="./dev prove discovery", description=__doc__)
    parser.add_argument("--part", action="append", choices=list(PARTS))
    parser.add_argument("--count", type=int)
    parser.add_argument("--figure", action="store_true")
    chosen = parser.parse_args(arguments)
    counts = {name: chosen.count or usual for name, usual in PARTS.items() if name in (chosen.part or PARTS)}
    outcomes, ratios = None, {}
    antennas = f"{len(SMALL)} antennas of {STATION} with three cable lengths ({len(ALIKE)} with two for static causes)"
    holds, lines = (
        [],
        [f"{antennas}, {EVENTS} events in a year; the sky power is given. Rates: 95 % intervals (Wilson)."],
    )
    simple: dict[str, Callable[[int], tuple[bool, list[str]]]] = {
        "clean": prove_clean, "clean-other": prove_clean_other, "several": prove_several, "unknown": prove_unknown,
        "held-out": prove_held_out,
    }  # fmt: skip
    for name, count in counts.items():
        if name == "one":
            is_good, text, outcomes = prove_detection(count)
        elif name == "efficiency":
            is_good, text, ratios = prove_efficiency(count)
        else:
            is_good, text = simple[name](count)
        holds.append(is_good)
        lines += text if is_good else [*text, "", f"The part `{name}` does not hold."]
    if chosen.figure and outcomes and ratios:
        draw_detection(outcomes, ratios, IMAGE)
    return all(holds), lines


@dataclass(frozen=True)
class Alarm:
    """What was said of data with nothing hidden."""

    what: str

    @property
    def is_false(self) -> bool:
        """Whether anything was said."""
        return bool(self.what)


@dataclass(frozen=True)
class Clean:
    """A kind of data set with nothing hidden."""

    name: str
    make: Callable[[int], DataSet]
    is_own_sky: bool = False


CLEAN = (Clean("without nuisances", plain), Clean("with nuisances", realistic))
CLEAN_OTHER = (
    Clean("ten antennas, compared for static causes", comparable),
    Clean("with nuisances, differences between sky models projected out", realistic, is_own_sky=True),
)


def look_at_clean(task: tuple[int, Clean]) -> Alarm:
    """Ask the finder about data with nothing hidden."""
    seed, kind = task
    answer = kind.make(seed).ask(is_own_sky=kind.is_own_sky)
    if answer.verdict == "consistent":
        return Alarm("")
    return Alarm(f"{seed}: {answer.verdict} {'+'.join(answer.named) or answer.axis}")


def prove_clean(count: int) -> tuple[bool, list[str]]:
    """`count` data sets without nuisances, and as many with."""
    return _count_alarms(CLEAN, count)


def prove_clean_other(count: int) -> tuple[bool, list[str]]:
    """`count` data sets of each of the other kinds."""
    return _count_alarms(CLEAN_OTHER, count)


def _count_alarms(kinds: Sequence[Clean], count: int) -> tuple[bool, list[str]]:
    holds, lines = True, ["", f"{len(SMALLEST)} antennas unless said otherwise, {FEW_EVENTS} events."]
    for kind in kinds:
        alarms = run_trials(look_at_clean, [(seed, kind) for seed in range(count)], f"clean, {kind.name}")
        rate = Rate(sum(alarm.is_false for alarm in alarms), count)
        holds &= rate.is_at_most(FALSE_ALARM_LIMIT)
        what = "; ".join(alarm.what for alarm in alarms if alarm.is_false)
        lines.append(f"**Nothing hidden**, {kind.name}: not consistent in {rate}{f': {what}' if what else ''}.")
    return holds, lines
