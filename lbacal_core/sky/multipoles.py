"""Spherical-harmonic multipoles of a real field, their order in memory, and how they turn."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lbacal_core.sky.frames import precession_angles

Complexes = NDArray[np.complex128]

# Multipoles are kept as a dense array (..., l, m) with 0 <= m <= l <= lmax and zeros elsewhere: at lmax 64 that is
# twice the memory of a packed triangle and spares every index formula. A real field has a_{l,-m} = (-1)^m conj a_lm.


@lru_cache(maxsize=8)
def wigner_d(lmax: int, angle: float) -> tuple[NDArray[np.float64], ...]:
    """Wigner small-d matrices d^l_{m'm}(angle) = <l m'| exp(-i angle J_y) |l m> for l = 0 ... lmax.

    Each has shape (2l+1, 2l+1) with m', m rising from -l, from the eigenvectors of J_y (Edmonds 1957, section 4.1):
    slower than a recursion, exact to rounding at any l.
    """
    matrices = []
    for order in range(lmax + 1):
        m = np.arange(-order, order)
        raising = np.sqrt(order * (order + 1.0) - m * (m + 1.0))
        j_y = np.diag(raising, -1) / 2j - np.diag(raising, 1) / 2j
        values, vectors = np.linalg.eigh(j_y)
        matrices.append(((vectors * np.exp(-1j * angle * np.round(values))) @ vectors.conj().T).real)
    return tuple(matrices)


def with_negative_orders(multipoles: Complexes, order: int) -> Complexes:
    """The multipoles of one l with m from -l to l: shape (..., lmax+1, lmax+1) -> (..., 2l+1)."""
    positive = multipoles[..., order, : order + 1]
    sign = (-1.0) ** np.arange(order, 0, -1)
    return np.concatenate([sign * positive[..., :0:-1].conj(), positive], axis=-1)


def precess_multipoles(multipoles: Complexes, epoch: float) -> Complexes:
    """Multipoles on the mean equator of `epoch` from those on the equator of J2000.0 (ICRS).

    The field is carried by R_z(z_A) R_y(-theta_A) R_z(zeta_A) in the sense of `sky.frames.precess`. `healpy.rotate_alm`
    does the same and is the oracle of the test; for the 51 channels of the embedded sky it takes three times as long,
    seconds where other work keeps the processor from its threads, and its import longer than the whole of P_sky.

    Parameters
    ----------
    multipoles
        Shape (..., l, m).
    """
    zeta, z, theta = precession_angles(epoch)
    lmax = multipoles.shape[-1] - 1
    turned = np.zeros_like(multipoles)
    for order, matrix in enumerate(wigner_d(lmax, -theta)):
        m = np.arange(-order, order + 1)
        moved = (with_negative_orders(multipoles, order) * np.exp(-1j * m * zeta)) @ matrix.T
        turned[..., order, : order + 1] = (moved * np.exp(-1j * m * z))[..., order:]
    return turned
