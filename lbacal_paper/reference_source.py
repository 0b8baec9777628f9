"""Calibration with a reference source of known field: C^2 = P_e / P_m (the paper's appendix A), with its error budget.

A source is characterised by the field at a distance in free space. Two characterisations of one source may disagree,
because neither the distance was far nor the surroundings free; each gives its own C, and their difference is a
systematic error of both. The paper's source is a VSQ 1000, whose tables its manufacturer gave to the authors; they
are not public.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.constants import speed_of_light

from lbacal_core.data.constants import IMPEDANCE_OF_FREE_SPACE as Z_0
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats, require_same_grid
from lbacal_core.instrument.matching import RESISTANCE_OHM


@dataclass(frozen=True)
class SourceTable:
    """One characterisation of a source: its field in its main direction, in free space.

    Attributes
    ----------
    frequency_mhz
        Shape (freq,), MHz.
    field
        Amplitude of the field of the lines in 1 MHz, shape (freq,), V/m/MHz^1/2.
    sigma
        Standard deviation of ln field, shape (freq,): what the laboratory states.
    distance_m
        Distance to which the field belongs.
    is_correlated
        Whether the stated error is one factor for all frequencies; otherwise it is independent in each channel.
    """

    name: str
    frequency_mhz: Floats
    field: Floats
    sigma: Floats
    distance_m: float
    is_correlated: bool = True

    def __post_init__(self) -> None:
        for label, values in (("field", self.field), ("sigma", self.sigma)):
            if values.shape != self.frequency_mhz.shape:
                raise BadInputError(f"source {self.name}: {label}", "one number a channel", f"shape {values.shape}")
        if not (np.all(self.field > 0) and np.all(self.sigma >= 0) and self.distance_m > 0):
            raise BadInputError(f"source {self.name}", "field and distance > 0, errors >= 0", "others")


@dataclass(frozen=True)
class Geometry:
    """Where the source stood, with errors.

    Attributes
    ----------
    distance_m, distance_sigma_m
        From source to antenna.
    source_response
        Field in the direction of the antenna over that in the main direction (1 on axis).
    antenna_response
        D of the antenna in the direction of the source: 1 at the zenith.
    antenna_sigma
        Standard deviation of ln D for that direction, from the antenna model.
    """

    distance_m: float
    distance_sigma_m: float
    source_response: float = 1.0
    antenna_response: float = 1.0
    antenna_sigma: float = 0.0


@dataclass(frozen=True)
class SourceCalibration:
    """C(nu) from a reference source.

    Attributes
    ----------
    c
        Shape (freq,), V per ADC unit.
    statistical
        Standard deviation of ln C of each channel, independent, shape (freq,).
    factors
        One standard deviation of ln C for each systematic error by name, shape (freq,); each fully correlated along
        frequency.
    """

    name: str
    frequency_mhz: Floats
    c: Floats
    statistical: Floats
    factors: Mapping[str, Floats]

    def covariance(self) -> Floats:
        """Covariance of ln C, shape (freq, freq)."""
        total = np.diag(self.statistical**2)
        for factor in self.factors.values():
            total = total + np.outer(factor, factor)
        return np.asarray(total)

    @property
    def sigma(self) -> Floats:
        """Standard deviation of ln C, shape (freq,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance())))


def field_at(table: SourceTable, geometry: Geometry) -> Floats:
    """The field at the antenna, shape (freq,), V/m/MHz^1/2: E r is constant in free space."""
    return np.asarray(table.field * table.distance_m / geometry.distance_m * geometry.source_response)


def effective_area(height_squared: Floats, resistance_ohm: float) -> Floats:
    """A_e = |H|^2 Z_0 / R_r (eq. AtoH), m^2, with H the height that gives the voltage at the load.

    An open-circuit height is twice that at a matched load, and then the same area reads |H|^2 Z_0 / (4 R_r).
    """
    return np.asarray(height_squared * Z_0 / resistance_ohm)


def expected_power(field: Floats, antenna_gain: Floats, antenna_response: float = 1.0) -> Floats:
    """P_e = S A_e delivered to the load, shape (freq,), W/MHz, for a wave polarised along the antenna's height.

    S = E^2 / Z_0 and A_e = |H|^2 Z_0 / R_r with |H|^2 = G_ant D (eqs. PSA and AtoH): there is no 1/2 of unpolarised
    waves.
    """
    area = effective_area(antenna_gain * antenna_response, RESISTANCE_OHM)
    return np.asarray(field**2 / Z_0 * area)


def calibrate_with_source(
    table: SourceTable, geometry: Geometry, antenna_gain: Floats, measured_power: Floats, power_sigma: Floats
) -> SourceCalibration:
    """C from the measured power of a source.

    Parameters
    ----------
    antenna_gain
        G_ant, shape (freq,), m^2.
    measured_power
        Recorded power of the source's lines, the background subtracted, shape (freq,), ADC^2/Ohm/MHz.
    power_sigma
        Standard deviation of ln of the measured power, shape (freq,).
    """
    if measured_power.shape != table.frequency_mhz.shape or not np.all(measured_power > 0):
        raise BadInputError("measured_power", "one power > 0 a channel", f"shape {measured_power.shape}")
    field = field_at(table, geometry)
    c = np.sqrt(expected_power(field, antenna_gain, geometry.antenna_response) / measured_power)
    one = np.ones_like(c)
    factors = {
        "distance": one * geometry.distance_sigma_m / geometry.distance_m,
        "antenna pattern": one * geometry.antenna_sigma / 2.0,
    }
    statistical = power_sigma / 2.0
    if table.is_correlated:
        factors["field of the source"] = table.sigma
    else:
        statistical = np.hypot(statistical, table.sigma)
    return SourceCalibration(table.name, table.frequency_mhz, c, statistical, factors)


def add_disagreement(one: SourceCalibration, other: SourceCalibration) -> SourceCalibration:
    """A calibration whose budget holds the difference to that by the other characterisation, in full."""
    require_same_grid(one.name, one.frequency_mhz, other.frequency_mhz, other.name)
    difference = np.log(other.c / one.c)
    factors = dict(one.factors) | {f"difference to {other.name}": difference}
    return SourceCalibration(one.name, one.frequency_mhz, one.c, one.statistical, factors)


@dataclass(frozen=True)
class CurveRatio:
    """One calibration over another.

    Attributes
    ----------
    ratio, sigma
        C over C of the reference source, and the standard deviation of its logarithm, shape (freq,).
    chi2
        chi2 of ln ratio = 0, with the whole covariance.
    trend, trend_sigma
        Slope of ln ratio against frequency, per MHz, by generalised least squares.
    """

    ratio: Floats
    sigma: Floats
    chi2: float
    trend: float
    trend_sigma: float


def compare_with_source(c: Floats, covariance: Floats, reference: SourceCalibration) -> CurveRatio:
    """The ratio of a calibration to that of a reference source (section 5.2), with its trend.

    Parameters
    ----------
    c, covariance
        C, shape (freq,), and the covariance of ln C, shape (freq, freq).
    """
    log_ratio = np.log(c / reference.c)
    total = covariance + reference.covariance()
    inverse = np.linalg.inv(total)
    x = reference.frequency_mhz - reference.frequency_mhz.mean()
    design = np.stack([np.ones_like(x), x], axis=1)
    normal = np.linalg.inv(design.T @ inverse @ design)
    solution = normal @ design.T @ inverse @ log_ratio
    return CurveRatio(
        np.exp(log_ratio),
        np.sqrt(np.diag(total)),
        float(log_ratio @ inverse @ log_ratio),
        float(solution[1]),
        float(np.sqrt(normal[1, 1])),
    )


def near_field_factor(frequency_mhz: Floats, distance_m: float) -> Floats:
    """|E_theta| of a short dipole over its far field alone, shape (freq,).

    |1 + 1/(i k r) - 1/(k r)^2| (Balanis, Antenna Theory, 3rd ed., eq. 4-10a). What a table gets wrong that is scaled
    with 1/r from this distance.
    """
    kr = 2 * np.pi * 1e6 * frequency_mhz / speed_of_light * distance_m
    return np.asarray(np.abs(1.0 + 1.0 / (1j * kr) - 1.0 / kr**2))


def floor_factor(
    frequency_mhz: Floats, distance_m: float, height_m: float, receiver_m: float, reflection: float = -1.0
) -> Floats:
    """Field over a reflecting floor over that in free space, shape (freq,), horizontal polarisation.

    Two rays: the direct one, and one from the image, with the reflection coefficient of a conducting floor.
    """
    direct = np.hypot(distance_m, height_m - receiver_m)
    reflected = np.hypot(distance_m, height_m + receiver_m)
    k = 2 * np.pi * 1e6 * frequency_mhz / speed_of_light
    return np.asarray(np.abs(1.0 + reflection * direct / reflected * np.exp(-1j * k * (reflected - direct))))


# A stand-in for the reference source of the paper: two characterisations that disagree.

LABORATORY_M, HEIGHT_M = 3.0, 1.5
"""Distance and height of the characterisation in the chamber (appendix A)."""
SCALED_M = 10.0
"""The distance to which both tables are scaled (appendix A)."""
FIELD_MV_M = 1.0
"""Field of the stand-in at 10 m, mV/m/MHz^1/2: an arbitrary level."""
STATED = 0.18
"""Stated error of the field: the scale uncertainty quoted for Tunka-Rex with the VSQ 1000 (arXiv 1508.06210)."""
LEFT_OF_FLOOR = 0.15
"""Amplitude of the floor's reflection that the chamber's procedure does not take out, of a perfect reflection."""
CHAMBER, CELL = "stand-in, chamber", "stand-in, GTEM cell"


def true_field(frequency_mhz: Floats) -> Floats:
    """Field of the stand-in at 10 m in free space, shape (freq,), V/m/MHz^1/2: a comb whose level falls slowly."""
    return np.asarray(1e-3 * FIELD_MV_M * (frequency_mhz / 55.0) ** -0.5)


def stand_in_tables(frequency_mhz: Floats) -> tuple[SourceTable, SourceTable]:
    """Field tables as the two laboratories would state them: chamber with a floor, and GTEM cell."""
    field, sigma = true_field(frequency_mhz), np.full_like(frequency_mhz, STATED)
    near = near_field_factor(frequency_mhz, LABORATORY_M)
    floor = floor_factor(frequency_mhz, LABORATORY_M, HEIGHT_M, HEIGHT_M, -LEFT_OF_FLOOR)
    return (
        SourceTable(CHAMBER, frequency_mhz, field * near * floor, sigma, SCALED_M),
        SourceTable(CELL, frequency_mhz, field * near, sigma, SCALED_M),
    )
