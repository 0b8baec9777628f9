"""Make lbacal_core/data/skies/gsm.json, the embedded sky, from the wheel of pyradiosky 1.1.2.

    pip download --no-deps pyradiosky==1.1.2
    unzip pyradiosky-1.1.2-py3-none-any.whl 'pyradiosky/data/gsm_galactic.skyh5'
    .venv/bin/python scripts/make_embedded_sky.py pyradiosky/data/gsm_galactic.skyh5

The file holds the Global Sky Model (de Oliveira-Costa et al. 2008, MNRAS 388, 247, without the CMB) at 10
frequencies, 50-150 MHz, averaged onto HEALPix nside 8 in Galactic coordinates. Its neighbour gsm_icrs.skyh5 is the
same map interpolated onto pixels in ICRS, which costs a quarter of the amplitude at l = 16; so the Galactic map is
taken, its pixel window divided out, and its multipoles are rotated to ICRS, which is exact.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import h5py
import healpy as hp
import numpy as np
from scipy.interpolate import CubicSpline

LMAX = 16
COMPONENTS = 3
NODES_MHZ = np.array([10, 15, 20, 25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 75, 80, 90, 100, 110, 120], dtype=float)
TARGET = Path(__file__).parent.parent / "lbacal_core" / "data" / "skies" / "gsm.json"


def pixel_window(nside: int) -> np.ndarray:
    """Amplitude that averaging over pixels leaves at each l, from 64 random fields on a grid 8 x finer."""
    rng = np.random.default_rng(0)
    kept, given = np.zeros(LMAX + 1), np.zeros(LMAX + 1)
    size = hp.Alm.getsize(LMAX)
    for _ in range(64):
        field = rng.normal(size=size) + 1j * rng.normal(size=size)
        fine = hp.alm2map(field, 8 * nside, lmax=LMAX)
        coarse = hp.map2alm(hp.ud_grade(fine, nside), lmax=LMAX, iter=20)
        field[: LMAX + 1] = field[: LMAX + 1].real
        kept += hp.alm2cl(field, coarse)
        given += hp.alm2cl(field)
    return kept / given


def at_nodes(given_mhz: np.ndarray, maps: np.ndarray) -> np.ndarray:
    """Maps at NODES_MHZ: log-log cubic spline per pixel, below 50 MHz a power law with the slope at 50-61 MHz."""
    x = np.log(given_mhz)
    inside = np.exp(CubicSpline(x, np.log(maps))(np.log(np.maximum(NODES_MHZ, given_mhz[0]))))
    slope = np.log(maps[1] / maps[0]) / (x[1] - x[0])
    below = np.minimum(np.log(NODES_MHZ / given_mhz[0]), 0.0)
    return inside * np.exp(below[:, None] * slope)


def main(source: str) -> None:
    with h5py.File(source) as file:
        maps = file["Data/stokes"][0]
        given_mhz = file["Header/freq_array"][()] / 1e6
        nside = int(file["Header/nside"][()])
    window = pixel_window(nside)
    to_icrs = hp.Rotator(coord=["G", "C"])
    dense = np.zeros((NODES_MHZ.size, LMAX + 1, LMAX + 1), dtype=complex)
    for node, values in enumerate(at_nodes(given_mhz, maps)):
        packed = to_icrs.rotate_alm(hp.almxfl(hp.map2alm(values, lmax=LMAX, iter=20), 1 / window))
        for order in range(LMAX + 1):
            for m in range(order + 1):
                dense[node, order, m] = packed[hp.Alm.getidx(LMAX, order, m)]
    level = dense[:, 0, 0].real / np.sqrt(4 * np.pi)
    relative = dense / level[:, None, None]
    flat = np.concatenate([relative.real.reshape(NODES_MHZ.size, -1), relative.imag.reshape(NODES_MHZ.size, -1)], 1)
    left, size, right = np.linalg.svd(flat, full_matrices=False)
    print("singular values", size[:6])
    half = right.shape[1] // 2
    components = (right[:COMPONENTS, :half] + 1j * right[:COMPONENTS, half:]).reshape(COMPONENTS, LMAX + 1, LMAX + 1)
    weight = left[:, :COMPONENTS] * size[:COMPONENTS]
    rows = [
        [
            order,
            m,
            *(
                round(float(v), 7)
                for k in range(COMPONENTS)
                for v in (components[k, order, m].real, components[k, order, m].imag)
            ),
        ]
        for order in range(LMAX + 1)
        for m in range(order + 1)
    ]
    content = {
        "name": "gsm",
        "origin": (
            "Global Sky Model (de Oliveira-Costa et al. 2008, MNRAS 388, 247), as in data/gsm_galactic.skyh5 of the "
            "PyPI package pyradiosky 1.1.2 (BSD-2-Clause), rotated to ICRS; below 50 MHz extrapolated with the slope "
            "at 50-61 MHz; l <= 16; made by scripts/make_embedded_sky.py"
        ),
        "frame": "ICRS",
        "has_cmb": False,
        "has_isotropic": True,
        "frequency_mhz": NODES_MHZ.tolist(),
        "level_k": [float(f"{value:.8g}") for value in level],
        "weight": [[float(f"{value:.8g}") for value in row] for row in weight],
        "multipoles": {"columns": "l, m, then real and imaginary part of each component", "rows": rows},
    }
    lines = json.dumps(content, indent=None).replace("], [", "],\n[").replace(', "', ',\n"')
    TARGET.write_text(lines + "\n")


if __name__ == "__main__":
    main(sys.argv[1])
