from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.data.constants import IMPEDANCE_OF_FREE_SPACE
from lbacal_core.errors import BadInputError
from lbacal_paper.reference_source import (
    SCALED_M,
    Geometry,
    SourceTable,
    add_disagreement,
    calibrate_with_source,
    compare_with_source,
    effective_area,
    expected_power,
    field_at,
    floor_factor,
    near_field_factor,
    stand_in_tables,
    true_field,
)

FREQUENCY = np.arange(30.0, 81.0)
GAIN = 0.1 + 3.0 / (1.0 + ((FREQUENCY - 58.0) / 4.0) ** 2)
C = 1e-5 * (1 + (FREQUENCY - 30) / 25)
FIELD = 1e-3 * (FREQUENCY / 55.0) ** -0.7


def table(field: np.ndarray = FIELD, sigma: float = 0.1, name: str = "chamber", **more: bool) -> SourceTable:
    return SourceTable(name, FREQUENCY, field, np.full(51, sigma), 10.0, **more)


def measured(distance_m: float = 10.0) -> np.ndarray:
    """The power that antennas with C record of the source, ADC^2/Ohm/MHz."""
    return expected_power(FIELD * 10.0 / distance_m, GAIN) / C**2


def test_the_field_falls_with_the_distance_and_follows_the_pattern() -> None:
    assert field_at(table(), Geometry(20.0, 0.1, source_response=0.9)) == pytest.approx(0.45 * FIELD)


def test_the_expected_power_is_poynting_flux_times_effective_area() -> None:
    # V = H E, P = V^2 / R_r (eq. P_hE)
    assert expected_power(FIELD, GAIN) == pytest.approx(GAIN * FIELD**2 / 50.0)
    assert pytest.approx(376.73, abs=0.01) == IMPEDANCE_OF_FREE_SPACE


def test_c_is_recovered_at_any_distance() -> None:
    for distance in (7.0, 10.0, 25.0):
        found = calibrate_with_source(table(), Geometry(distance, 0.1), GAIN, measured(distance), np.full(51, 0.01))
        assert found.c == pytest.approx(C)


def test_each_error_has_its_size_in_c() -> None:
    geometry = Geometry(10.0, 0.2, antenna_sigma=0.08)
    found = calibrate_with_source(table(sigma=0.1), geometry, GAIN, measured(), np.full(51, 0.03))
    assert found.factors["distance"] == pytest.approx(0.02)
    assert found.factors["antenna pattern"] == pytest.approx(0.04)
    assert found.factors["field of the source"] == pytest.approx(0.1)
    assert found.sigma == pytest.approx(np.sqrt(0.02**2 + 0.04**2 + 0.1**2 + 0.015**2))


def test_errors_cover_the_truth_in_level_and_in_shape() -> None:
    rng = np.random.default_rng(7)
    geometry = Geometry(10.0, 0.3, antenna_sigma=0.06)
    pulls, distances = [], []
    for _ in range(600):
        wrong = FIELD * np.exp(0.1 * rng.normal())
        distance = 10.0 + 0.3 * rng.normal()
        pattern = np.exp(0.06 * rng.normal())
        power = measured(distance) * pattern * np.exp(0.05 * rng.normal(size=51))
        found = calibrate_with_source(table(wrong), geometry, GAIN, power, np.full(51, 0.05))
        error = np.log(found.c / C)
        pulls.append(error[25] / found.sigma[25])
        distances.append(error @ np.linalg.solve(found.covariance(), error))
    # 600 trials know a standard deviation to 2.9 %, a mean of chi2 with 51 degrees to 0.4
    assert np.std(pulls) == pytest.approx(1.0, abs=0.1)
    assert np.mean(distances) == pytest.approx(51.0, abs=1.6)


def test_an_uncorrelated_table_leaves_no_factor() -> None:
    found = calibrate_with_source(table(is_correlated=False), Geometry(10.0, 0.1), GAIN, measured(), np.full(51, 0.02))
    assert "field of the source" not in found.factors
    assert found.statistical == pytest.approx(np.hypot(0.01, 0.1))


def test_two_characterisations_disagree_by_what_the_laboratories_differ() -> None:
    near = near_field_factor(FREQUENCY, 3.0)
    one, other = (
        calibrate_with_source(table(field, name=name), Geometry(10.0, 0.1), GAIN, measured(), np.full(51, 0.02))
        for name, field in (("chamber", FIELD), ("cell", FIELD * near))
    )
    both = add_disagreement(one, other)
    assert both.factors["difference to cell"] == pytest.approx(np.log(near))
    assert np.all(both.sigma > one.sigma)


def test_a_ratio_with_a_trend_is_told_from_one_without() -> None:
    reference = calibrate_with_source(table(), Geometry(10.0, 0.1), GAIN, measured(), np.full(51, 0.02))
    covariance = 0.05**2 * np.ones((51, 51)) + 0.005**2 * np.eye(51)
    same = compare_with_source(C * 1.1, covariance, reference)
    assert same.trend == pytest.approx(0.0, abs=1e-9)
    assert same.chi2 < 3
    tilted = compare_with_source(C * np.exp(0.004 * (FREQUENCY - 55)), covariance, reference)
    assert tilted.trend == pytest.approx(0.004, rel=1e-6)
    assert tilted.trend > 5 * tilted.trend_sigma
    assert tilted.chi2 > 80
    assert tilted.ratio == pytest.approx(np.exp(0.004 * (FREQUENCY - 55)))


def test_the_near_field_matters_at_3_m_and_low_frequencies() -> None:
    # k r = 1.886 at 30 MHz and 3 m
    assert near_field_factor(np.array([30.0]), 3.0) == pytest.approx(0.893, abs=0.001)
    assert near_field_factor(np.array([80.0]), 3.0) == pytest.approx(0.981, abs=0.001)
    assert near_field_factor(np.array([50.0]), 1000.0) == pytest.approx(1.0, abs=1e-4)


def test_a_floor_doubles_or_cancels_the_field_of_a_distant_low_source() -> None:
    # equal heights h at distance d >> h: the paths differ by 2 h^2 / d
    nu, d = np.array([50.0]), 100.0
    half_wave = 299.792458 / 50.0 / 2
    height = np.sqrt(half_wave * d / 2)
    assert floor_factor(nu, d, height, height) == pytest.approx(2.0, abs=0.03)
    assert floor_factor(nu, d, 0.01, 0.01) == pytest.approx(0.0, abs=1e-3)
    assert floor_factor(nu, 3.0, 1.5, 1.5, reflection=0.0) == pytest.approx(1.0)


def test_broken_tables_are_refused() -> None:
    with pytest.raises(BadInputError, match="field"):
        table(FIELD[:10])
    with pytest.raises(BadInputError, match="distance"):
        SourceTable("x", FREQUENCY, FIELD, np.zeros(51), 0.0)
    with pytest.raises(BadInputError, match="measured_power"):
        calibrate_with_source(table(), Geometry(10.0, 0.1), GAIN, -measured(), np.full(51, 0.02))


def test_both_laboratories_miss_the_true_field_and_each_other() -> None:
    chamber, cell = stand_in_tables(FREQUENCY)
    truth = true_field(FREQUENCY)
    assert chamber.distance_m == cell.distance_m == SCALED_M
    assert "stand-in" in chamber.name
    assert "stand-in" in cell.name
    # within the stated error, but not alike in shape
    for one in (chamber, cell):
        assert np.all(np.abs(np.log(one.field / truth)) < 2 * one.sigma)
    assert np.ptp(np.log(chamber.field / cell.field)) > 0.1


def test_a_matched_short_dipole_in_free_space_has_three_eighths_of_lambda_squared_over_pi():
    wavelength, length = 5.0, 0.1
    # Radiation resistance of a short dipole; the matched load sees half of the open-circuit height.
    resistance = 2 * np.pi / 3 * IMPEDANCE_OF_FREE_SPACE * (length / wavelength) ** 2
    area = effective_area(np.array((length / 2) ** 2), resistance)
    assert area == pytest.approx(3 / (8 * np.pi) * wavelength**2, rel=1e-12)
