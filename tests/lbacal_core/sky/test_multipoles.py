from __future__ import annotations

import healpy
import numpy as np
import pytest
from scipy.special import sph_harm_y
from threadpoolctl import threadpool_limits

from lbacal_core.sky.model import Complexes, precess, precess_multipoles, precession_angles, wigner_d


def field(multipoles: Complexes, longitude: np.ndarray, latitude: np.ndarray) -> np.ndarray:
    lmax = multipoles.shape[-1] - 1
    total = np.zeros(longitude.shape)
    for order in range(lmax + 1):
        for m in range(order + 1):
            value = multipoles[order, m] * sph_harm_y(order, m, np.pi / 2 - latitude, longitude)
            total += (1 if m == 0 else 2) * value.real
    return total


def random_multipoles(lmax: int) -> Complexes:
    rng = np.random.default_rng(3)
    values = np.tril(rng.normal(size=(lmax + 1, lmax + 1)) + 1j * rng.normal(size=(lmax + 1, lmax + 1)))
    values[:, 0] = values[:, 0].real
    return values


def test_wigner_d_of_one_is_the_textbook_matrix() -> None:
    angle = 0.7
    c, s = np.cos(angle), np.sin(angle)
    # Edmonds 1957, table 2, rows m' and columns m from -1 to 1.
    expected = [
        [(1 + c) / 2, s / np.sqrt(2), (1 - c) / 2],
        [-s / np.sqrt(2), c, s / np.sqrt(2)],
        [(1 - c) / 2, -s / np.sqrt(2), (1 + c) / 2],
    ]
    assert wigner_d(1, angle)[1] == pytest.approx(np.array(expected), abs=1e-14)


def test_wigner_d_is_orthogonal_at_high_order() -> None:
    matrix = wigner_d(64, 1.1)[64]
    assert matrix @ matrix.T == pytest.approx(np.eye(129), abs=1e-12)


def test_a_precessed_field_has_at_the_precessed_place_the_value_it_had() -> None:
    multipoles = random_multipoles(8)
    rng = np.random.default_rng(4)
    ra, dec = rng.uniform(0, 2 * np.pi, 30), np.arcsin(rng.uniform(-1, 1, 30))
    later = precess_multipoles(multipoles, 2150.0)  # far, so that a wrong sign shows
    assert field(later, *precess(ra, dec, 2150.0)) == pytest.approx(field(multipoles, ra, dec), abs=1e-12)


def test_precession_of_multipoles_is_the_rotation_of_healpy() -> None:
    multipoles = random_multipoles(24)
    upper = np.triu_indices(25)  # healpy packs by m, then l: the transposed upper triangle
    packed = np.ascontiguousarray(multipoles.T[upper])
    zeta, z, theta = precession_angles(2150.0)
    with threadpool_limits(1):  # its threads wait for each other where the processor is busy
        healpy.rotate_alm(packed, zeta, -theta, z)
    assert precess_multipoles(multipoles, 2150.0).T[upper] == pytest.approx(packed, abs=1e-12)
