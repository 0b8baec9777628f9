"""The electric field at an antenna from the voltages of its two dipoles (the paper's appendix B).

V = J E at each frequency, with E = (E_theta, E_phi), the field along increasing zenith angle and along increasing
azimuth (north through east), and one row of J per dipole. Two dipoles give two components; the third, along the line
of sight, is zero in a plane wave.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.antenna.model import AntennaModel, Complexes, zenith_gain
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.linear import pseudo_invert

# Effective height (the paper's appendix on antenna theory), on the scale of the G_ant of an instrument.


def effective_heights(
    antenna: AntennaModel, antenna_gain: Floats, frequency_mhz: Floats, zenith: float, azimuth_from_arm: float
) -> Complexes:
    """Complex heights of one dipole for E_theta and E_phi from a direction, shape (freq, 2), m.

    The Jones terms of the antenna model give direction and phase, the G_ant of the instrument the size: |H|^2 =
    G_ant D, the height with which C was fitted. With another G_ant, C and H do not belong together.

    Parameters
    ----------
    antenna_gain
        G_ant of the instrument, shape (freq,), m^2.
    zenith, azimuth_from_arm
        Direction that the wave comes from, rad; azimuth minus that of the arm, both north through east.
    """
    theta, phi = antenna.jones(frequency_mhz, np.array([zenith]), np.array([azimuth_from_arm]))
    scale = np.sqrt(antenna_gain / zenith_gain(antenna, frequency_mhz))
    return np.asarray(scale[:, None] * np.stack([theta[:, 0], phi[:, 0]], axis=1))


LARGEST_CONDITION = 10.0
"""Beyond, one combination of the components is known ten times worse than another."""
SMALLEST_SINGULAR_VALUE = 1e-12
"""The smallest singular value of J over its largest below which rounding alone tells two dipoles apart."""


@dataclass(frozen=True)
class UnfoldedField:
    """The field of a plane wave, with its errors.

    Attributes
    ----------
    field
        E_theta and E_phi, complex, shape (2, freq), V/m per unit of frequency of the voltages.
    noise_covariance
        Covariance of the noise of (E_theta, E_phi), complex Hermitian, independent between frequencies, shape (freq,
        2, 2).
    factors
        What one standard deviation of each calibration error does to the field, complex, shape (factor, 2, freq). One
        factor is fully correlated along frequency and between components, and factors are independent.
    condition
        Condition number of J, shape (freq,): how much worse the least certain combination of the components is known
        than the most certain one; infinite where the two dipoles see one component only.
    """

    frequency_mhz: Floats
    field: Complexes
    noise_covariance: Complexes
    factors: Complexes
    condition: Floats

    @property
    def is_degenerate(self) -> NDArray[np.bool_]:
        """Where the direction does not determine both components, shape (freq,)."""
        return np.asarray(~(self.condition < LARGEST_CONDITION))

    @property
    def covariance(self) -> Complexes:
        """Covariance of (E_theta, E_phi) at each frequency with noise and calibration, shape (freq, 2, 2)."""
        return np.asarray(self.noise_covariance + np.einsum("kif,kjf->fij", self.factors, self.factors.conj()))

    @property
    def sigma(self) -> Floats:
        """Standard deviation of E_theta and E_phi, shape (2, freq)."""
        return np.asarray(np.sqrt(np.einsum("fii->if", self.covariance).real))


def jones_matrix(
    antenna: AntennaModel,
    antenna_gain: Floats,
    dipole_azimuth_deg: Mapping[str, float],
    frequency_mhz: Floats,
    zenith_deg: float,
    azimuth_deg: float,
) -> Complexes:
    """J of two dipoles for a direction, shape (freq, dipole, component), m; dipoles in the order of their names.

    Parameters
    ----------
    antenna_gain
        G_ant with which C was fitted, shape (freq,), m^2.
    dipole_azimuth_deg
        Arm of each dipole, degrees north through east.
    zenith_deg, azimuth_deg
        Where the wave comes from, degrees; azimuth north through east.
    """
    if not 0 <= zenith_deg < 90:
        raise BadInputError("zenith_deg", "0 to below 90 (above the horizon)", f"{zenith_deg:g}")
    if len(dipole_azimuth_deg) != 2:
        raise BadInputError("dipoles", "two", f"{len(dipole_azimuth_deg)}")
    zenith = np.radians(zenith_deg)
    rows = [
        effective_heights(antenna, antenna_gain, frequency_mhz, zenith, np.radians(azimuth_deg - arm))
        for _, arm in sorted(dipole_azimuth_deg.items())
    ]
    return np.stack(rows, axis=1)


def unfold_field(
    frequency_mhz: Floats,
    voltage: Complexes,
    jones: Complexes,
    noise_variance: Floats | None = None,
    calibration_factors: Floats | None = None,
) -> UnfoldedField:
    """Solve V = J E for the field, and carry the errors of V over.

    Parameters
    ----------
    frequency_mhz
        Shape (freq,), MHz.
    voltage
        Calibrated spectra C(nu) F(nu) of both dipoles, complex, shape (2, freq), V.
    jones
        From `jones_matrix`, shape (freq, 2, 2), m.
    noise_variance
        Variance of the noise of each voltage, E|n|^2, shape (2, freq), V^2; None for no noise.
    calibration_factors
        One standard deviation of ln C for each independent error, shape (factor, 2, freq): zero in the dipole that
        an error does not concern.
    """
    expected = (2, frequency_mhz.size)
    if voltage.shape != expected or jones.shape != (frequency_mhz.size, 2, 2):
        raise BadInputError("voltage, jones", f"shapes {expected} and (freq, 2, 2)", f"{voltage.shape}, {jones.shape}")
    largest, smallest = np.linalg.svd(jones, compute_uv=False).T
    is_solvable = smallest > SMALLEST_SINGULAR_VALUE * np.maximum(largest, 1e-300)
    condition = np.where(is_solvable, largest / np.where(is_solvable, smallest, 1.0), np.inf)
    inverse = np.zeros_like(jones)
    inverse[is_solvable] = pseudo_invert(jones[is_solvable])
    inverse[~is_solvable] = np.nan
    noise = np.zeros(expected) if noise_variance is None else noise_variance
    relative = np.zeros((0, *expected)) if calibration_factors is None else calibration_factors
    return UnfoldedField(
        frequency_mhz,
        np.einsum("fij,jf->if", inverse, voltage),
        np.einsum("fij,jf,fkj->fik", inverse, noise, inverse.conj()),
        np.einsum("fij,kjf->kif", inverse, relative * voltage),
        condition,
    )
