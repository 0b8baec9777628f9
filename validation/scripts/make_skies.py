"""Make the skies of lbacal_core/data/skies from the maps of the PyPI packages pyradiosky and lsl.

    pip download --no-deps pyradiosky==1.1.2
    unzip pyradiosky-1.1.2-py3-none-any.whl 'pyradiosky/data/gsm_galactic.skyh5'
    .venv/bin/python validation/scripts/make_skies.py pyradiosky/data/gsm_galactic.skyh5 ../shared/data/sky

``gsm``, the default: the file of pyradiosky holds the Global Sky Model (de Oliveira-Costa et al. 2008, MNRAS 388, 247,
without the CMB) at 10 frequencies, 50-150 MHz, averaged onto HEALPix nside 8 in Galactic coordinates. Its neighbour
gsm_icrs.skyh5 is the same map interpolated onto pixels in ICRS, which costs a quarter of the amplitude at l = 16; so
the Galactic map is taken, its pixel window divided out, and its multipoles are rotated to ICRS, which is exact.

lsl 4.0.1 (GPL) has two sets of principal components on HEALPix nside 64: `gsm-408locked.npz`, the Global Sky Model
locked to the map at 408 MHz, with maps at 10, 22, 45 and 408 MHz, and `lfsm-5.1deg.npz`, the Low Frequency Sky Model
(Dowell et al. 2017, MNRAS 469, 4537), which rests on maps of the LWA1 at 40-80 MHz beside those at 10, 22 and 408 MHz:

- ``gsm408``, ``lfsm``: the models;
- ``haslam``: the map at 408 MHz (Haslam et al. 1982) alone, as the components give it, carried down with the index
  2.55, as codes do that have one map;
- ``maeda``: the map at 45 MHz (Alvarez et al. 1997; Maeda et al. 1999) alone, as the components of `gsm408` give it,
  carried with the index 2.5;
- ``wide/*``: the first three from 10 to 408 MHz, for instruments beyond 120 MHz, where the default sky ends. Between 45
  (80) and 408 MHz there is no map in them: the spectra are interpolated.

Only multipoles up to l = 16 ship, not the maps.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import h5py
import healpy as hp
import numpy as np
from scipy.interpolate import CubicSpline

from lbacal_core.sky.names import load_sky

LMAX = 16
COMPONENTS = 3
NODES_MHZ = np.array([10, 15, 20, 25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 75, 80, 90, 100, 110, 120], dtype=float)
FOLDER = Path(__file__).parents[2] / "lbacal_core" / "data" / "skies"
WIDE_MHZ = np.array([10, 12.5, 16, 20, 25, 32, 40, 50, 63, 80, 100, 125, 160, 200, 250, 320, 408], dtype=float)
MADE = "l <= 16; made by validation/scripts/make_skies.py"


def write_sky(
    name: str, origin: str, multipoles: np.ndarray, nodes_mhz: np.ndarray = NODES_MHZ, *, has_cmb: bool = False
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
    parts = np.stack([components.real, components.imag], axis=-1).round(7)
    rows = [[order, m, *parts[:, order, m].ravel().tolist()] for order in range(LMAX + 1) for m in range(order + 1)]
    content = {
        "name": Path(name).name,
        "origin": origin,
        "frame": "ICRS",
        "has_cmb": has_cmb,
        "has_isotropic": True,
        "frequency_mhz": nodes_mhz.tolist(),
        "level_k": [float(f"{value:.8g}") for value in level],
        "weight": [[float(f"{value:.8g}") for value in row] for row in weight],
        "multipoles": {"columns": "l, m, then real and imaginary part of each component", "rows": rows},
    }
    lines = json.dumps(content, indent=None).replace("], [", "],\n[").replace(', "', ',\n"')
    (FOLDER / f"{name}.json").write_text(lines + "\n")


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


def make_default(source: str) -> None:
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
    origin = (
        "Global Sky Model (de Oliveira-Costa et al. 2008, MNRAS 388, 247), as in data/gsm_galactic.skyh5 of the "
        "PyPI package pyradiosky 1.1.2 (BSD-2-Clause), rotated to ICRS; below 50 MHz extrapolated with the slope "
        f"at 50-61 MHz; {MADE}"
    )
    write_sky("gsm", origin, dense)


def make_others(folder: str) -> None:
    names = ("gsm-408locked.npz", "lfsm-5.1deg.npz")
    from_gsm, from_lfsm = (f"; {MADE} from {name} of the PyPI package lsl 4.0.1 (GPL-2.0-or-later)" for name in names)
    gsm, lfsm = (load_sky(str(Path(folder) / name)).truncated(LMAX) for name in names)

    def at(sky: object, frequency_mhz: np.ndarray) -> np.ndarray:
        return np.tensordot(sky.spectra(frequency_mhz), sky.multipoles, axes=1)

    def carried(from_mhz: float, index: float, nodes: np.ndarray) -> np.ndarray:
        return at(gsm, np.array([from_mhz])) * ((nodes / from_mhz) ** -index)[:, None, None]

    locked = f"Global Sky Model (de Oliveira-Costa et al. 2008, MNRAS 388, 247) locked to 408 MHz{from_gsm}"
    low = f"Low Frequency Sky Model (Dowell et al. 2017, MNRAS 469, 4537){from_lfsm}"
    haslam = f"Map at 408 MHz (Haslam et al. 1982, A&AS 47, 1), index 2.55{from_gsm}"
    maeda = f"Map at 45 MHz (Alvarez et al. 1997, A&AS 124, 315; Maeda et al. 1999, A&AS 140, 145), index 2.5{from_gsm}"
    write_sky("maeda", maeda, carried(45.0, 2.5, NODES_MHZ))
    for name, nodes in (("gsm408", NODES_MHZ), ("wide/gsm-wide", WIDE_MHZ)):
        write_sky(name, locked, at(gsm, nodes), nodes)
    for name, nodes in (("lfsm", NODES_MHZ), ("wide/lfsm-wide", WIDE_MHZ)):
        write_sky(name, low, at(lfsm, nodes), nodes, has_cmb=True)
    for name, nodes in (("haslam", NODES_MHZ), ("wide/haslam-wide", WIDE_MHZ)):
        write_sky(name, haslam, carried(408.0, 2.55, nodes), nodes)


if __name__ == "__main__":
    make_default(sys.argv[1])
    make_others(sys.argv[2])
