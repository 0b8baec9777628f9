"""From recorded power and voltages to fields: the reference source of appendix A, and the unfolding of appendix B.

The truth is written out here: a source at a distance, a plane wave that two dipoles see. What is stated of it is off by
the stated errors, and the errors of C and of the field are counted. A geometry is one draw: errors are almost fully
correlated along frequency, so coverage is the mean over trials of the share of each.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from lbacal_core.antenna.ideal import ShortDipole
from lbacal_core.antenna.model import AntennaModel, Complexes, zenith_gain
from lbacal_core.antenna.names import load_antenna
from lbacal_core.antenna.unfolding import jones_matrix, unfold_field
from lbacal_core.data.lofar import DIPOLES
from lbacal_core.data.tables import read_table
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.instrument.matching import RESISTANCE_OHM
from lbacal_paper.reference_source import (
    HEIGHT_M,
    LABORATORY_M,
    LEFT_OF_FLOOR,
    STATED,
    Geometry,
    SourceTable,
    add_disagreement,
    calibrate_with_source,
    compare_with_source,
    floor_factor,
    near_field_factor,
    true_field,
)
from validation.machinery.claims import Found, count_within, coverage, mean_of, rate_of
from validation.machinery.parts import Part, Row
from validation.superterp import superterp

POWER_SIGMA, DISTANCE_SIGMA_M, PATTERN_SIGMA = 0.01, 0.1, 0.05
OF_DIPOLE, OF_BOTH = 0.02, 0.12
"""Errors of ln C in the proof of the field: statistical, of each dipole, and systematic, shared."""
FARTHEST_DEG = 85.0


@cache
def _published_c() -> Floats:
    table = read_table("published_calibration")
    return np.interp(superterp().frequency_mhz, table["mhz"], table["c"])


def calibrate_by_source(seed: int) -> Row:
    """C from a source whose field, place and direction are off by their stated errors, and by two laboratories."""
    rng = np.random.default_rng([1, seed])
    instrument = superterp()
    frequency, gain = instrument.frequency_mhz, instrument.antenna_gain
    c = _published_c() * np.exp(0.05 * rng.standard_normal() * np.cos(frequency / 10.0 + rng.uniform(0, 6)))
    field_3m = true_field(frequency) * 10.0 / LABORATORY_M
    response, direction = rng.uniform(0.5, 1.0, 2)
    stated = Geometry(10.0, DISTANCE_SIGMA_M, direction, response, PATTERN_SIGMA)
    distance = 10.0 + DISTANCE_SIGMA_M * rng.standard_normal()
    voltage = field_3m * LABORATORY_M / distance * direction
    voltage *= np.sqrt(gain * response * np.exp(PATTERN_SIGMA * rng.standard_normal()))
    recorded = voltage**2 / RESISTANCE_OHM / c**2 * np.exp(POWER_SIGMA * rng.standard_normal(c.size))
    noise = np.full_like(c, POWER_SIGMA)

    is_one_factor = bool(rng.integers(2))
    sigma = np.full_like(c, STATED if is_one_factor else 0.05)
    off = sigma * rng.standard_normal(1 if is_one_factor else c.size)
    table = SourceTable("one", frequency, field_3m * np.exp(off), sigma, LABORATORY_M, is_one_factor)
    found = calibrate_with_source(table, stated, gain, recorded, noise)
    residual = np.log(found.c / c)
    row = count_within("c", residual / found.sigma)
    row["chi2"] = float(residual @ np.linalg.solve(found.covariance(), residual) / c.size)

    galactic_error = 0.11 * np.ones_like(c), 0.03 * (frequency - 55.0) / 25.0
    galactic = c * np.exp(sum(rng.standard_normal() * one for one in galactic_error))
    covariance = sum(np.outer(one, one) for one in galactic_error) + 1e-6 * np.eye(c.size)
    ratio = compare_with_source(galactic * np.exp(1e-3 * rng.standard_normal(c.size)), covariance, found)
    row |= count_within("trend", np.array(ratio.trend / ratio.trend_sigma))

    # what a floor and the near field leave is in no stated error: two laboratories, each with a scale error of its own
    floor = LEFT_OF_FLOOR * rng.standard_normal()
    surroundings = floor_factor(frequency, LABORATORY_M, HEIGHT_M, HEIGHT_M, floor), np.ones_like(c)
    two = [
        calibrate_with_source(
            SourceTable(
                name,
                frequency,
                field_3m * near_field_factor(frequency, LABORATORY_M) * factor * np.exp(STATED * rng.standard_normal()),
                np.full_like(c, STATED),
                LABORATORY_M,
            ),
            stated,
            gain,
            recorded,
            noise,
        )
        for name, factor in zip(("chamber", "cell"), surroundings, strict=True)
    ]
    both = add_disagreement(*two)
    return row | count_within("both", np.log(both.c / c) / both.sigma)


def judge_source(rows: Sequence[Row]) -> list[Found]:
    chi2 = mean_of("chi2", np.array([row["chi2"] for row in rows]))
    return [*coverage(rows, "c"), chi2, *coverage(rows, "trend"), *coverage(rows, "both")]


def unfold_one(seed: int) -> Row:
    """A field seen by two dipoles, with noise and errors of C, unfolded again."""
    rng = np.random.default_rng([2, seed])
    instrument = superterp()
    frequency, arms = instrument.frequency_mhz, instrument.dipole_azimuth_deg
    antenna: AntennaModel = ShortDipole(1.7) if seed % 2 else load_antenna("hamaker")
    zenith, azimuth = (
        float(np.degrees(np.arccos(rng.uniform(np.cos(np.radians(FARTHEST_DEG)), 1)))),
        rng.uniform(0, 360),
    )
    slope, angle, phase = rng.normal(-0.02, 0.01), rng.uniform(0, np.pi), rng.uniform(0, 2 * np.pi, 2)
    size = 1e-6 * np.exp(slope * (frequency - 55.0))
    field = np.stack([np.cos(angle) * size * np.exp(1j * phase[0]), np.sin(angle) * size * np.exp(1j * phase[1])])
    voltage = _voltages(antenna, instrument, field, np.radians(zenith), np.radians(azimuth))
    noise = np.mean(np.abs(voltage) ** 2) / np.exp(rng.uniform(np.log(10.0), np.log(1000.0)))
    drawn = rng.normal(scale=np.sqrt(noise / 2), size=(2, *voltage.shape))
    noisy = voltage + drawn[0] + 1j * drawn[1]
    factors = np.zeros((3, 2, frequency.size))
    factors[0, 0], factors[1, 1] = OF_DIPOLE * (1 + (frequency - 55.0) / 50.0), OF_DIPOLE
    factors[2] = OF_BOTH
    seen = noisy * np.exp(np.einsum("k,kif->if", rng.standard_normal(3), factors))
    variance = np.full(voltage.shape, noise)

    jones = jones_matrix(antenna, instrument.antenna_gain, arms, frequency, zenith, azimuth)
    found = unfold_field(frequency, seen, jones, variance, factors)
    along = found.field / np.abs(found.field)
    of_noise = np.einsum("fii->if", found.noise_covariance).real / 2
    of_calibration = np.sum((along.conj() * found.factors).real ** 2, axis=0)
    is_strong = np.abs(found.field) > 3 * np.sqrt(of_noise)
    pull = (along.conj() * (found.field - field)).real / np.sqrt(of_noise + of_calibration)
    pull = pull[:, ~found.is_degenerate][is_strong[:, ~found.is_degenerate]]
    left = unfold_field(frequency, noisy, jones, variance)
    residual = (left.field - field).T
    chi2 = np.einsum("fi,fij,fj->f", residual.conj(), np.linalg.inv(left.noise_covariance), residual).real / 2

    single = dict.fromkeys(arms, arms["X"])
    same = jones_matrix(antenna, instrument.antenna_gain, single, frequency, zenith, azimuth)
    return {
        "zenith": round(zenith, 1),
        "is_used": bool(pull.size),
        **(count_within("field", pull) if pull.size else {}),
        "chi2": float(chi2.mean()),
        "degenerate": float(found.is_degenerate.mean()),
        "same_arm_unflagged": int(np.sum(~unfold_field(frequency, seen, same, variance).is_degenerate)),
    }


def _voltages(
    antenna: AntennaModel, instrument: Instrument, field: Complexes, zenith: float, azimuth: float
) -> Complexes:
    """Voltages of both dipoles; of a short dipole by the scalar product of arm and field in north, east and up."""
    scale = np.sqrt(instrument.antenna_gain / zenith_gain(antenna, instrument.frequency_mhz))
    rows = []
    for dipole in DIPOLES:
        arm = np.radians(instrument.dipole_azimuth_deg[dipole])
        if isinstance(antenna, ShortDipole):
            theta = np.array([np.cos(zenith) * np.cos(azimuth), np.cos(zenith) * np.sin(azimuth), -np.sin(zenith)])
            phi = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
            vector = np.outer(theta, field[0]) + np.outer(phi, field[1])
            wavenumber = 2 * np.pi * 1e6 * instrument.frequency_mhz / 299_792_458.0
            height = 2j * np.sin(wavenumber * antenna.height_m * np.cos(zenith))
            rows.append(scale * height * (np.array([np.cos(arm), np.sin(arm), 0.0]) @ vector))
        else:
            theta, phi = antenna.jones(instrument.frequency_mhz, np.array([zenith]), np.array([azimuth - arm]))
            rows.append(scale * (theta[:, 0] * field[0] + phi[:, 0] * field[1]))
    return np.stack(rows)


def judge_field(rows: Sequence[Row]) -> list[Found]:
    unflagged = sum(row["same_arm_unflagged"] > 0 for row in rows)
    return [
        *coverage([row for row in rows if row["is_used"]], "field"),
        mean_of("chi2", np.array([row["chi2"] for row in rows])),
        rate_of("same_arm", unflagged, len(rows)),
    ]


PARTS = (
    Part("source", calibrate_by_source, judge_source, 2000),
    Part("field", unfold_one, judge_field, 2000, headlines=("field_2",)),
)
