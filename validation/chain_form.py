"""A second world, written from the paper alone: sizes, C and silence hold wherever the noise of the LNA enters.

`outside/world.py` beside the project makes a station-year without a line of this one: its own sum over pixels of a
sky, a resonance circuit for G_ant, an A(nu) of its own, and the LNA's noise in front of the resonance, as published, or
behind it. To be found: a daytime ionosphere of tau = 0.03 at 30 MHz under the LFSM, 10 % brighter than the table. With
nothing to be found C has to bear what is drawn, and an investigation has to give no name: sky, level, tilt, beam,
ground, memory of the gains. What is believed is the default: the GSM of the package, free as models differ, and the
form of the chain that data prefer.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from lbacal_core.calibration.chain_form import compare_forms
from lbacal_core.discovery.report import CONSISTENT, investigate
from lbacal_core.instrument.chain import BEHIND, PUBLISHED
from lbacal_core.pipeline import calibrate
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.spectra import Spectra, read_spectra
from validation.machinery.claims import Found, mean_of, rate_of, root_mean_of
from validation.machinery.parts import SHARED, Part, Row
from validation.machinery.tables import by
from validation.own_cable import total_error

WORLD = SHARED / "outside" / "world.py"
FIRST_SEED = 1000
"""Seeds of the second world below have been looked at."""
CAUSE, TAU, LEVEL = "ionospheric_absorption", 0.03, 1.1
COVERED_SEED, QUIET_SEED, LASTING_SEED = 10_000, 100_000, 1_000_000
"""The years and days with nothing to be found have seeds of their own."""
FAR = 2.0
"""Standard deviations."""
FREQUENCIES_MHZ = (35.0, 55.0, 75.0)
FORMS = {"front": PUBLISHED, "behind": BEHIND}


def make(seed: int, **conditions: object) -> tuple[Spectra, Simulation, dict[str, Any]]:
    """A station-year of the second world, what is believed of it, and the truth."""
    options = [f"--{name.replace('_', '-')}={value}" for name, value in conditions.items()]
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, str(WORLD), folder, "--seed", str(FIRST_SEED + seed), *options]
        subprocess.run(command, check=True)
        truth = json.loads((Path(folder) / "truth.json").read_text())
        return read_spectra(Path(folder) / "spectra.h5"), Simulation.load(f"{folder}/inst.json"), truth


def pull_of_c(spectra: Spectra, simulation: Simulation, truth: Mapping[str, Any]) -> list[list[float]]:
    """C of each path less the true one over its total error, at each of `FREQUENCIES_MHZ`; NaN where C has no value."""
    at = [truth["frequency_mhz"].index(one) for one in FREQUENCIES_MHZ]
    pulls = []
    for curve in calibrate(spectra, simulation).curves:
        own = np.array(truth["c"])[curve.antenna, "XY".index(str(curve.dipole))]
        c = np.full(own.size, np.nan) if curve.c is None else curve.c
        pulls.append(((c - own) / total_error(curve))[at] if curve.c is not None else c[at])
    found: list[list[float]] = np.round(pulls, 3).tolist()
    return found


def look(seed: int, enters: str) -> Row:
    """One station-year: its form of the chain, the size of the ionosphere, and the pulls of C of all paths."""
    spectra, simulation, truth = make(seed, level=LEVEL, noise_enters=enters, effect="ionosphere", size=TAU)
    form = compare_forms(spectra, simulation)
    report, _ = investigate(spectra, simulation)
    sizes = [one["size"] for one in report["findings"] if one["cause"] == CAUSE]
    return {
        "form": form.name,
        "is_open": form.is_open(FORMS[enters]),
        "odds_by_data": round(form.odds_by_data(FORMS[enters]), 4),
        "size": sizes[0]["value"] if sizes else None,
        "pull": (sizes[0]["value"] - TAU) / sizes[0]["sigma"] if sizes else None,
        "others": [one["cause"] for one in report["findings"] if one["cause"] != CAUSE],
        "pulls_of_c": pull_of_c(spectra, simulation, truth),
    }


def draw_conditions(seed: int) -> dict[str, Any]:
    """Conditions of a station-year with nothing to be found."""
    rng = np.random.default_rng([33, seed])
    return {
        "sky": str(rng.choice(["lfsm-5.1deg", "gsm-408locked"])),
        "narrow": float(rng.choice([0.0, 0.05, 0.1])),
        "level": round(rng.uniform(0.9, 1.1), 4),
        "tilt": round(rng.uniform(-0.1, 0.1), 4),
        "ground_k": float(rng.choice([0.0, 60.0])),
        "noise_enters": str(rng.choice(list(FORMS))),
        "memory_h": round(rng.uniform(0.0, 24.0), 2),
    }


def cover(seed: int) -> Row:
    """A station-year under conditions that are drawn, with nothing to be found: the pulls of C of all paths."""
    drawn = draw_conditions(seed)
    return {**drawn, "pulls_of_c": pull_of_c(*make(COVERED_SEED + seed, **drawn))}


def listen(seed: int, **size: int) -> Row:
    """Investigate a station-year under conditions that are drawn, with nothing to be found."""
    drawn = draw_conditions(QUIET_SEED + seed)
    report, _ = investigate(*make(QUIET_SEED + seed, **drawn, **size)[:2])
    left = report["unexplained"]
    named = [one["cause"] for one in report["findings"]]
    return {**drawn, "verdict": report["verdict"], "named": named, "axis": left and left["where"]["axis"]}


def last(seed: int, **size: int) -> Row:
    """Days whose gains last for hours: mean square of what C of a path departs from its station's over its own error.

    The wrong sky and antenna, which all paths of a polarisation share, are in the mean that is taken off; gains that
    they share would be too, and there are none.
    """
    rng = np.random.default_rng([34, seed])
    drawn: dict[str, Any] = {
        "days": round(rng.uniform(2.0, 20.0), 2),
        "memory_h": round(rng.uniform(1.0, 12.0), 2),
        "gain_path": round(rng.uniform(0.005, 0.03), 4),
        "gain_common": 0.0,
        "events": 432,
    }
    spectra, simulation, truth = make(LASTING_SEED + seed, **drawn, **size)
    at = [truth["frequency_mhz"].index(one) for one in FREQUENCIES_MHZ]
    squares = []
    for letter, of_antennas in zip("XY", np.array(truth["c"]).swapaxes(0, 1), strict=True):
        own = [one for one in calibrate(spectra, simulation).curves if one.dipole == letter]
        c, sigma = (np.array([getattr(one, name) for one in own], dtype=float)[:, at] for name in ("c", "c_sigma_stat"))
        off = np.log(c / of_antennas[[one.antenna for one in own]][:, at])
        squares.append(np.mean(((off - off.mean(axis=0)) * c / sigma) ** 2) * len(own) / (len(own) - 1))
    return {**drawn, "square": round(float(np.mean(squares)), 4)}


def judge_last(rows: Sequence[Row]) -> list[Found]:
    return [root_mean_of("lasting", np.array([row["square"] for row in rows]))]


def judge_quiet(rows: Sequence[Row]) -> list[Found]:
    said = [row for row in rows if row["verdict"] != CONSISTENT]
    return [rate_of("named", sum(bool(row["named"]) for row in rows), len(rows)), rate_of("said", len(said), len(rows))]


def judge_cover(rows: Sequence[Row]) -> list[Found]:
    pulls = np.abs(np.array([row["pulls_of_c"] for row in rows], dtype=float))
    within = np.mean(pulls < FAR, axis=1)
    found = [mean_of(f"c_{mhz:.0f}", one, "%") for mhz, one in zip(FREQUENCIES_MHZ, within.T, strict=True)]
    return [*found, rate_of("without", int(np.sum(np.isnan(pulls[:, :, 1]))), pulls[:, :, 1].size)]


def judge(rows: Sequence[Row], enters: str) -> list[Found]:
    pulls = np.array([row["pull"] for row in rows if row["pull"] is not None])
    within = np.mean(np.abs(np.array([row["pulls_of_c"] for row in rows], dtype=float)) < FAR, axis=1)
    return [
        rate_of("named", pulls.size, len(rows)),
        rate_of("size", int(np.sum(np.abs(pulls) < FAR)), pulls.size),
        mean_of("pull", pulls),
        rate_of("preferred", sum(row["form"] == FORMS[enters] for row in rows), len(rows)),
        rate_of("open", sum(row["is_open"] for row in rows), len(rows)),
        rate_of("beside", sum(bool(row["others"]) for row in rows), len(rows)),
        *(mean_of(f"c_{mhz:.0f}", one) for mhz, one in zip(FREQUENCIES_MHZ, within.T, strict=True)),
    ]


PARTS = (
    *(
        Part(name, partial(look, enters=name), partial(judge, enters=name), 40, headlines=shown, needs_shared=True)
        for name, shown in (("front", ()), ("behind", ("size",)))
    ),
    Part("cover", cover, judge_cover, 400, needs_shared=True),
    Part("days", last, judge_last, 100, needs_shared=True),
    Part("quiet", listen, judge_quiet, 800, by("sky", "noise_enters"), needs_shared=True),
)
