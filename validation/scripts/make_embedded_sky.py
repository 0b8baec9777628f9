"""Make lbacal_core/data/skies/gsm.json, the embedded sky, from the wheel of pyradiosky 1.1.2.

    pip download --no-deps pyradiosky==1.1.2
    unzip pyradiosky-1.1.2-py3-none-any.whl 'pyradiosky/data/gsm_galactic.skyh5'
    .venv/bin/python validation/scripts/make_embedded_sky.py pyradiosky/data/gsm_galactic.skyh5

The file holds the Global Sky Model (de Oliveira-Costa et al. 2008, MNRAS 388, 247, without the CMB) at 10
frequencies, 50-150 MHz, averaged onto HEALPix nside 8 in Galactic coordinates. Its neighbour gsm_icrs.skyh5 is the
same map interpolated onto pixels in ICRS, which costs a quarter of the amplitude at l = 16; so the Galactic map is
taken, its pixel window divided out, and its multipoles are rotated to ICRS, which is exact.
"""

from __future__ import annotations

import sys

import h5py
import healpy as hp
import numpy as np
from scipy.interpolate import CubicSpline
from sky_tables import LMAX, NODES_MHZ, write_sky


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
    origin = (
        "Global Sky Model (de Oliveira-Costa et al. 2008, MNRAS 388, 247), as in data/gsm_galactic.skyh5 of the "
        "PyPI package pyradiosky 1.1.2 (BSD-2-Clause), rotated to ICRS; below 50 MHz extrapolated with the slope "
        "at 50-61 MHz; l <= 16; made by validation/scripts/make_embedded_sky.py"
    )
    write_sky("gsm", origin, dense, has_cmb=False, has_isotropic=True)


if __name__ == "__main__":
    main(sys.argv[1])
