"""Make tests/lbacal_core/antenna/everybeam_values.json: 20 Jones matrices of the LBA from the package EveryBeam.

    python3 -m venv everybeam-venv && . everybeam-venv/bin/activate && pip install everybeam==0.9.1
    python validation/scripts/make_everybeam_values.py

The virtual environment must be active, because EveryBeam looks for its data there. EveryBeam (GPL-3, ASTRON) is an
independent evaluation of the same coefficients. It is no dependency: the values stay.
"""

from __future__ import annotations

import json
from pathlib import Path

import everybeam
import numpy as np

TARGET = Path(__file__).parents[2] / "tests" / "lbacal_core" / "antenna" / "everybeam_values.json"


def main() -> None:
    rng = np.random.default_rng(20)
    response = everybeam.ElementResponse.create("hamaker_lba")
    rows = []
    for _ in range(20):
        frequency_mhz = round(float(rng.uniform(30, 80)), 1)
        theta, phi = (round(float(value), 4) for value in (rng.uniform(0, 1.55), rng.uniform(0, 6.28)))
        jones = np.asarray(response.response(np.array(frequency_mhz * 1e6), np.array(theta), np.array(phi)))
        flat = [float(part) for value in jones.reshape(4) for part in (value.real, value.imag)]
        rows.append([frequency_mhz, theta, phi, *flat])
    columns = "MHz, theta rad, phi rad from the X arm, then X theta, X phi, Y theta, Y phi, each real and imaginary"
    content = {"origin": "everybeam 0.9.1, hamaker_lba", "columns": columns, "rows": rows}
    TARGET.write_text(json.dumps(content).replace("], [", "],\n[") + "\n")


if __name__ == "__main__":
    main()
