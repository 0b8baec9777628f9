"""What `lbacal investigate` finds in simulated stations, against an ideal detector that knows everything.

Parts (`--part NAME`, several times; all of them without): clean (nothing hidden), nuisances (nothing hidden but what
real campaigns have), clean-other (nothing hidden: ten antennas, the package's own sky, LST curves), one (one effect of
a drawn cause), efficiency (cause by cause, or of one, `--cause NAME`), static (cables of one antenna), several (two and
three effects), unknown (effects in no catalogue), held-out (what was found, removed from unseen events). `--count N`:
data sets of a part, or of each kind in it; the defaults are small. `--figure` draws docs/images/discovery.png from one
and efficiency.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from proofs.hidden.clean import prove_clean, prove_clean_other, prove_nuisances
from proofs.hidden.data_sets import ALIKE, EVENTS, SMALL, STATION, moving_causes
from proofs.hidden.figure import draw_detection
from proofs.hidden.held_out import prove_held_out
from proofs.hidden.no_catalogue import prove_unknown
from proofs.hidden.one_effect import prove_detection, prove_efficiency, prove_static
from proofs.hidden.several_effects import prove_several

IMAGE = Path(__file__).parents[1] / "docs" / "images" / "discovery.png"
PARTS = {
    "clean": 40,
    "nuisances": 40,
    "clean-other": 20,
    "one": 8,
    "efficiency": 4,
    "static": 4,
    "several": 8,
    "unknown": 2,
    "held-out": 12,
}
"""Parts, and how many data sets they have unless said otherwise."""


def prove(arguments: list[str]) -> tuple[bool, list[str]]:
    """Run the parts asked for."""
    parser = argparse.ArgumentParser(prog="./dev prove discovery", description=__doc__)
    parser.add_argument("--part", action="append", choices=list(PARTS))
    parser.add_argument("--count", type=int)
    parser.add_argument("--cause", choices=moving_causes())
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
        "clean": prove_clean, "nuisances": prove_nuisances, "clean-other": prove_clean_other,
        "static": prove_static, "several": prove_several, "unknown": prove_unknown, "held-out": prove_held_out,
    }  # fmt: skip
    for name, count in counts.items():
        if name == "one":
            is_good, text, outcomes = prove_detection(count)
        elif name == "efficiency":
            is_good, text, ratios = prove_efficiency(count, chosen.cause)
        else:
            is_good, text = simple[name](count)
        holds.append(is_good)
        lines += text if is_good else [*text, "", f"The part `{name}` does not hold."]
    if chosen.figure and outcomes and ratios:
        draw_detection(outcomes, ratios, IMAGE)
    return all(holds), lines
