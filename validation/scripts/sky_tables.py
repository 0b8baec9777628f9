"""Write the multipoles of a sky as a table that ships, `lbacal_core/data/skies/NAME.json`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

LMAX = 16
COMPONENTS = 3
NODES_MHZ = np.array([10, 15, 20, 25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 75, 80, 90, 100, 110, 120], dtype=float)
FOLDER = Path(__file__).parents[2] / "lbacal_core" / "data" / "skies"


def write_sky(
    name: str,
    origin: str,
    multipoles: np.ndarray,
    *,
    has_cmb: bool,
    has_isotropic: bool,
    nodes_mhz: np.ndarray = NODES_MHZ,
    folder: Path = FOLDER,
) -> None:
    """Write multipoles in ICRS at nodes, shape (node, l, m), as a level and its principal components."""
    level = multipoles[:, 0, 0].real / np.sqrt(4 * np.pi)
    relative = multipoles / level[:, None, None]
    nodes = nodes_mhz.size
    flat = np.concatenate([relative.real.reshape(nodes, -1), relative.imag.reshape(nodes, -1)], 1)
    left, size, right = np.linalg.svd(flat, full_matrices=False)
    kept = min(COMPONENTS, int(np.sum(size > 1e-7 * size[0])))
    print(name, "singular values", size[:6])
    half = right.shape[1] // 2
    components = (right[:kept, :half] + 1j * right[:kept, half:]).reshape(kept, LMAX + 1, LMAX + 1)
    weight = left[:, :kept] * size[:kept]
    rows = [
        [
            order,
            m,
            *(
                round(float(v), 7)
                for k in range(kept)
                for v in (components[k, order, m].real, components[k, order, m].imag)
            ),
        ]
        for order in range(LMAX + 1)
        for m in range(order + 1)
    ]
    content = {
        "name": name,
        "origin": origin,
        "frame": "ICRS",
        "has_cmb": has_cmb,
        "has_isotropic": has_isotropic,
        "frequency_mhz": nodes_mhz.tolist(),
        "level_k": [float(f"{value:.8g}") for value in level],
        "weight": [[float(f"{value:.8g}") for value in row] for row in weight],
        "multipoles": {"columns": "l, m, then real and imaginary part of each component", "rows": rows},
    }
    lines = json.dumps(content, indent=None).replace("], [", "],\n[").replace(', "', ',\n"')
    (folder / f"{name}.json").write_text(lines + "\n")
