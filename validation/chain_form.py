"""A second world, written from the paper alone: sizes and C hold wherever the noise of the LNA enters.

`outside/world.py` beside the project makes a station-year without a line of this one: its own sum over pixels of the
LFSM, 10 % brighter than the table, a resonance circuit for G_ant and an A(nu) of its own, and a daytime ionosphere of
tau = 0.03 at 30 MHz. The LNA's noise enters in front of the resonance, as published, or behind it. What is believed is
the default: the GSM of the package, free as models differ, and the form of the chain that the data prefer.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from lbacal_core.calibration.chain_form import compare_forms
from lbacal_core.chain.model import BEHIND, PUBLISHED
from lbacal_core.discovery.report import investigate
from lbacal_core.pipeline import calibrate
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.spectra import read_spectra
from validation.machinery.claims import Found, mean_of, rate_of
from validation.machinery.parts import SHARED, Part, Row
from validation.own_cable import total_error

WORLD = SHARED / "outside" / "world.py"
FIRST_SEED = 1000
"""Seeds of the second world below have been looked at."""
CAUSE, TAU, LEVEL = "ionospheric_absorption", 0.03, 1.1
FREQUENCIES_MHZ = (35.0, 55.0, 75.0)
FORMS = {"front": PUBLISHED, "behind": BEHIND}


def look(seed: int, enters: str) -> Row:
    """One station-year: its form of the chain, the size of the ionosphere, and the pulls of C of all paths."""
    with tempfile.TemporaryDirectory() as folder:
        made = [sys.executable, str(WORLD), folder, "--seed", str(FIRST_SEED + seed), "--noise-enters", enters]
        planted = ["--level", str(LEVEL), "--effect", "ionosphere", "--size", str(TAU)]
        subprocess.run([*made, *planted], check=True)
        simulation = Simulation.load(f"{folder}/inst.json")
        spectra = read_spectra(Path(folder) / "spectra.h5")
        truth = json.loads((Path(folder) / "truth.json").read_text())
    form = compare_forms(spectra, simulation)
    report, _ = investigate(spectra, simulation)
    sizes = [one["size"] for one in report["findings"] if one["cause"] == CAUSE]
    at = [truth["frequency_mhz"].index(one) for one in FREQUENCIES_MHZ]
    pulls = []
    for curve in calibrate(spectra, simulation).curves:
        own = np.array(truth["c"])[curve.antenna, "XY".index(str(curve.dipole))]
        pulls.append(((np.asarray(curve.c) - own) / total_error(curve))[at])
    return {
        "form": form.name,
        "is_open": form.is_open(FORMS[enters]),
        "probability": round(form.probability[FORMS[enters]], 4),
        "size": sizes[0]["value"] if sizes else None,
        "pull": (sizes[0]["value"] - TAU) / sizes[0]["sigma"] if sizes else None,
        "others": [one["cause"] for one in report["findings"] if one["cause"] != CAUSE],
        "pulls_of_c": np.round(pulls, 3).tolist(),
    }


def judge(rows: Sequence[Row], enters: str) -> list[Found]:
    pulls = np.array([row["pull"] for row in rows if row["pull"] is not None])
    within = np.mean(np.abs([row["pulls_of_c"] for row in rows]) < 2.0, axis=1)
    return [
        rate_of("named", pulls.size, len(rows)),
        rate_of("size", int(np.sum(np.abs(pulls) < 2.0)), pulls.size),
        mean_of("pull", pulls),
        rate_of("preferred", sum(row["form"] == FORMS[enters] for row in rows), len(rows)),
        rate_of("open", sum(row["is_open"] for row in rows), len(rows)),
        rate_of("beside", sum(bool(row["others"]) for row in rows), len(rows)),
        *(mean_of(f"c_{mhz:.0f}", one) for mhz, one in zip(FREQUENCIES_MHZ, within.T, strict=True)),
    ]


PARTS = tuple(
    Part(
        enters,
        partial(look, enters=enters),
        partial(judge, enters=enters),
        40,
        headlines=("size",),
        needs_shared=True,
    )
    for enters in FORMS
)
