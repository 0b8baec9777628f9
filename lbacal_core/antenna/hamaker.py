"""The element beam of the LOFAR low-band antenna after Hamaker: a shape in 100 complex numbers, without resonance."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files

import numpy as np
from numpy.polynomial.polynomial import polyval

from lbacal_core.antenna.model import Complexes
from lbacal_core.grids import Floats
from lbacal_core.provenance import hash_arrays

CENTRE_MHZ = 55.0
RANGE_MHZ = 45.0


@dataclass(frozen=True)
class HamakerAntenna:
    """Sum over harmonics k of a rotation by kappa phi of two polynomials in zenith angle and frequency.

    J_theta = sum_k P_k0(theta, nu) cos(kappa phi), J_phi = -sum_k P_k1(theta, nu) sin(kappa phi) with
    kappa = (-1)^k (2k + 1), for the dipole whose arm lies at phi = 0 (Hamaker 2011; the same convention as the
    package EveryBeam, whose X dipole lies at phi = 225 deg from east through north, that is along NE-SW). The other
    dipole is the same function turned by 90 deg, because sin and cos of an odd multiple exchange.

    Attributes
    ----------
    coefficients
        Shape (harmonic, theta power, frequency power, component), component 0 theta and 1 phi.
    """

    coefficients: Complexes
    name: str = "hamaker"

    def jones(self, frequency_mhz: Floats, zenith: Floats, azimuth_from_arm: Floats) -> tuple[Complexes, Complexes]:
        """J_theta and J_phi of the dipole, shape (freq, ...), dimensionless: 1 at zenith along the arm."""
        x = (frequency_mhz - CENTRE_MHZ) / RANGE_MHZ
        visible = np.asarray(zenith) < np.pi / 2
        powers = np.stack([np.asarray(zenith, dtype=float) ** power for power in range(self.coefficients.shape[1])])
        theta: Complexes | float = 0.0
        phi: Complexes | float = 0.0
        for harmonic, table in enumerate(self.coefficients):
            kappa = (-1) ** harmonic * (2 * harmonic + 1)
            in_frequency = polyval(x, np.moveaxis(table, 1, 0))  # (theta power, component, freq)
            by_angle = [np.tensordot(in_frequency[:, part].T, powers, 1) * visible for part in (0, 1)]
            theta = theta + by_angle[0] * np.cos(kappa * np.asarray(azimuth_from_arm))
            phi = phi - by_angle[1] * np.sin(kappa * np.asarray(azimuth_from_arm))
        return np.asarray(theta), np.asarray(phi)

    def digest(self) -> str:
        """Hash of the coefficients."""
        return hash_arrays(self.coefficients)


def load_hamaker() -> HamakerAntenna:
    """The low-band coefficients that ship with the package."""
    text = (files("lbacal_core") / "data/antennas/hamaker_lba.csv").read_text()
    rows = [line.split(",") for line in text.splitlines() if line and line[0].isdigit()]
    indices = np.array([[int(value) for value in row[:4]] for row in rows])
    coefficients = np.zeros(indices.max(axis=0) + 1, dtype=complex)
    coefficients[tuple(indices.T)] = [complex(float(row[4]), float(row[5])) for row in rows]
    return HamakerAntenna(coefficients)
