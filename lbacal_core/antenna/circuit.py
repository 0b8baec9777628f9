"""The resonance of the active antenna as a circuit: dipole impedance into the LNA's input."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.constants import speed_of_light

from lbacal_core.antenna.model import AntennaModel, Complexes
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.provenance import hash_content


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
        electrical_length = omega * self.arm_m / speed_of_light
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
        """The base's Jones terms times the circuit's transfer."""
        transfer = self.circuit.transfer(frequency_mhz).reshape((-1,) + (1,) * np.ndim(zenith))
        theta, phi = self.base.jones(frequency_mhz, zenith, azimuth_from_arm)
        return theta * transfer, phi * transfer

    def digest(self) -> str:
        """Hash of the base and the circuit."""
        return hash_content([self.base.digest(), self.circuit.__dict__])
