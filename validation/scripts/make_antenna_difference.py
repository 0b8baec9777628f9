"""Make lbacal_core/data/antenna_difference.json: in what the simulated LBA differs from the default antenna.

    .venv/bin/python validation/scripts/make_antenna_difference.py ../shared/data

The simulated response of the LBA (WIPL-D) less the Hamaker element beam, as the multipoles of D about the zenith, in
their four strongest components along frequency. Only these numbers ship, not the simulated antenna.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from lbacal_core.antenna.names import DEFAULT_ANTENNA, load_antenna
from lbacal_core.sky.modes import beam_multipoles

TARGET = Path(__file__).parents[2] / "lbacal_core" / "data" / "antenna_difference.json"
LMAX = 16
NODES_MHZ = np.arange(30.0, 81.0, 5.0)
COMPONENTS = 4
SMALLEST = 1e-4
"""Multipoles of the components below this are left out."""
ANTENNA = "antenna/lba_vout.npz"


def numbers(values: np.ndarray) -> list[float]:
    return [float(f"{value:.6g}") for value in values]


def main(folder: str) -> None:
    names = (DEFAULT_ANTENNA, str(Path(folder) / ANTENNA))
    default, other = (beam_multipoles(load_antenna(name), NODES_MHZ, LMAX).real for name in names)
    left, size, right = np.linalg.svd((other - default).reshape(NODES_MHZ.size, -1), full_matrices=False)
    print("singular values", size[: COMPONENTS + 2].round(4))
    shape = right[:COMPONENTS].reshape(COMPONENTS, LMAX + 1, LMAX + 1)
    content = {
        "name": "wipl-d",
        "origin": "simulated LBA (WIPL-D) less the Hamaker element beam; made by scripts/make_antenna_difference.py",
        "frequency_mhz": NODES_MHZ.tolist(),
        "weight": [numbers(row) for row in left[:, :COMPONENTS] * size[:COMPONENTS]],
        "multipoles": {
            "columns": "l, m about the zenith, then each component",
            "rows": [
                [order, m, *numbers(values)]
                for order in range(LMAX + 1)
                for m, values in enumerate(shape[:, order, : order + 1].T)
                if np.abs(values).max() > SMALLEST
            ],
        },
    }
    TARGET.write_text(json.dumps(content).replace("], [", "],\n[") + "\n")


if __name__ == "__main__":
    main(sys.argv[1])
