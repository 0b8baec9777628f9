"""The element beam of the LOFAR low-band antenna after Hamaker: a shape in 100 complex numbers, without resonance."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files

import numpy as np
from numpy.polynomial.polynomial import polyval

from lbacal_core.antenna.model import AntennaModel, Complexes
from lbacal_core.data.constants import SPEED_OF_LIGHT
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.provenance import hash_arrays, hash_content

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


# The resonance of the active antenna as a circuit: dipole impedance into the LNA's input.


@dataclass(frozen=True)
class ResonanceCircuit:
    """Voltage at an LNA of `lna_ohm` parallel to `lna_farad`, per field at the dipole.

    The dipole is an open line with losses, Z = R (nu / 60 MHz)^2 - i Z_line cot(2 pi nu l / c), the textbook picture
    of a dipole up to half a wavelength long (Balanis, Antenna Theory, chapter 8), and its open-circuit response in
    power grows as nu^height_exponent. The LNA values are those quoted for LOFAR's (about 700 ohm, 15-17 pF). The
    others are fitted to G_ant of `lofar-superterp`, which spans a factor of 200 in power, and follow it within 5 %
    rms: an interpolation with knobs, not a simulation of the antenna.
    """

    resistance_ohm: float = 24.3
    line_ohm: float = 547.0
    arm_m: float = 1.517
    height_exponent: float = 2.58
    lna_ohm: float = 700.0
    lna_farad: float = 16e-12

    def __post_init__(self) -> None:
        for name, value in self.__dict__.items():
            if not (np.isfinite(value) and value > 0):
                raise BadInputError(f"resonance circuit: {name}", "a number > 0", f"{value!r}")

    def transfer(self, frequency_mhz: Floats) -> Complexes:
        """Load voltage per field up to a constant, shape (freq,)."""
        omega = 2 * np.pi * 1e6 * frequency_mhz
        load = 1.0 / (1.0 / self.lna_ohm + 1j * omega * self.lna_farad)
        electrical_length = omega * self.arm_m / SPEED_OF_LIGHT
        dipole = self.resistance_ohm * (frequency_mhz / 60.0) ** 2 - 1j * self.line_ohm / np.tan(electrical_length)
        return np.asarray((frequency_mhz / 60.0) ** (self.height_exponent / 2) * load / (dipole + load))

    def gain(self, frequency_mhz: Floats) -> Floats:
        """|transfer|^2: the resonance in G_ant, shape (freq,)."""
        return np.asarray(np.abs(self.transfer(frequency_mhz)) ** 2)


@dataclass(frozen=True)
class ResonantAntenna:
    """An antenna model behind a resonance circuit: another G_ant, the same D."""

    base: AntennaModel
    circuit: ResonanceCircuit

    @property
    def name(self) -> str:
        """Name in provenance."""
        return f"{self.base.name}-resonant"

    def jones(self, frequency_mhz: Floats, zenith: Floats, azimuth_from_arm: Floats) -> tuple[Complexes, Complexes]:
        """The base's Jones terms times the circuit's transfer, shape (freq, ...) each."""
        transfer = self.circuit.transfer(frequency_mhz).reshape((-1,) + (1,) * np.ndim(zenith))
        theta, phi = self.base.jones(frequency_mhz, zenith, azimuth_from_arm)
        return theta * transfer, phi * transfer

    def digest(self) -> str:
        """Hash of the base and the circuit."""
        return hash_content([self.base.digest(), self.circuit.__dict__])
