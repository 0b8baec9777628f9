"""What `lbacal investigate` finds in simulated stations, against an ideal detector that knows everything.

Parts: nothing hidden (clean; nuisances, as real campaigns have; ten-antennas; own-sky; lst-curves); one effect of a
drawn cause (one); cause by cause (efficiency); cables of one antenna (static); two and three effects (several); effects
in no catalogue (unknown); what was found, removed from unseen events (held-out).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from lbacal_core.data.lofar import DIPOLES
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.lstcurve.curve import AS_RECORDED, LstCurve, band_weights
from validation.hidden import held_out, no_catalogue, one_effect, several_effects
from validation.hidden.data_sets import DataSet, comparable, plain, realistic
from validation.hidden.finder import Answer, ask_of_curve
from validation.hidden.one_effect import draw_detection
from validation.hidden.worlds import OWN
from validation.machinery.claims import Found, rate_of
from validation.machinery.parts import Part, Row

BAND_MHZ = (30.0, 80.0)
POINTS, POINT_NOISE_DB, SHARED_VARIANCE = 46, 0.05, 0.9
"""Points of a curve, their noise, and the part of its variance that X and Y share: those of the measured curve."""
LEAST_NOISE, MOST_NOISE = 0.2, 0.8
"""Electronic noise over the mean sky power of a band: published as a third to a half of the total, or 0.5 to 1 of a sky
that is a third too dark (docs/explanation/what-the-simulation-gets-wrong.md)."""


def ask_curve(number: int) -> Answer:
    chain, rng = load_instrument("lofar-superterp"), np.random.default_rng([20261122, number])
    lst_hours = 24.0 * (np.arange(POINTS) + 0.5) / POINTS
    weights = band_weights(chain, AS_RECORDED, BAND_MHZ)
    electronic = rng.uniform(LEAST_NOISE, MOST_NOISE)
    shared = SHARED_VARIANCE**0.5 * rng.standard_normal(POINTS)
    variation = {}
    for dipole in DIPOLES:
        band = OWN.power().at(dipole, lst_hours) @ weights
        noise = shared + (1 - SHARED_VARIANCE) ** 0.5 * rng.standard_normal(POINTS)
        variation[dipole] = 10 * np.log10(band / band.mean() + electronic) + POINT_NOISE_DB * noise
    curve = LstCurve(lst_hours, variation, np.full(POINTS, 0.11), 0.5, is_centre_stated=True, origin="simulated")
    return ask_of_curve(curve, OWN.power(), chain, BAND_MHZ)


def ask_data(draw: Callable[[int], DataSet], seed: int, *, is_own_sky: bool = False) -> Answer:
    """Ask about a station-year; with `is_own_sky` its sky power is one of several that could be right."""
    return draw(seed).ask(is_own_sky=is_own_sky)


def listen(ask: Callable[[int], Answer], seed: int) -> Row:
    answer = ask(seed)
    return {"verdict": answer.verdict, "named": answer.named, "axis": answer.axis}


def judge_nothing(rows: Sequence[Row]) -> list[Found]:
    return [rate_of("alarms", sum(row["verdict"] != "consistent" for row in rows), len(rows))]


KINDS: dict[str, tuple[Callable[[int], Answer], int]] = {
    "clean": (partial(ask_data, plain), 500),
    "nuisances": (partial(ask_data, realistic), 500),
    "ten-antennas": (partial(ask_data, comparable), 200),
    "own-sky": (partial(ask_data, realistic, is_own_sky=True), 200),
    "lst-curves": (ask_curve, 200),
}
ROWS = ("nuisances",)
"""The kinds that are rows of the page: those most like real campaigns."""
CLEAN = tuple(
    Part(name, partial(listen, ask), judge_nothing, count, headlines=("alarms",) if name in ROWS else ())
    for name, (ask, count) in KINDS.items()
)
PARTS = (*CLEAN, *one_effect.PARTS, *several_effects.PARTS, *no_catalogue.PARTS, *held_out.PARTS)


def draw(rows: Mapping[str, Sequence[Row]]) -> dict[str, Figure]:
    if not {"one", "efficiency"} <= set(rows):
        return {}
    return {"discovery.png": draw_detection(rows["one"], rows["efficiency"])}
