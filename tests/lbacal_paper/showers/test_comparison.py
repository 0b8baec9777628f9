from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.antenna.lofar import load_hamaker
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import Instrument
from lbacal_paper.showers.comparison import compare_calibrations, mean_of_unequal
from lbacal_paper.showers.recording import record
from lbacal_paper.showers.signals import band_bins, draw_signals, fit_slopes, robust_covariance

FREQUENCY = np.arange(30.0, 81.0)
C = np.array([1e-5 * (1 + np.arange(51) / 30.0)] * 2)
BACKGROUND = np.full((2, 51), 3.0)


def test_the_right_calibration_stays_on_the_diagonal_and_a_kinked_one_leaves_it(low_band: Instrument) -> None:
    rng = np.random.default_rng(3)
    made = record(draw_signals(rng), low_band, load_hamaker(), C, BACKGROUND, rng)
    # 1e-3 of log10 power per MHz above 60 MHz only, and over the whole band
    kink = C * 10 ** (0.5e-3 * np.maximum(FREQUENCY - 60.0, 0.0))
    tilt = C * 10 ** (0.5e-3 * (FREQUENCY - 60.0))
    found = compare_calibrations(made, FREQUENCY, {"right": C, "kink": kink, "tilt": tilt})
    assert abs(found["right"].significance) < 3
    assert found["kink"].difference - found["right"].difference == pytest.approx(1.0, abs=0.1)
    assert abs(found["kink"].significance) > 5
    assert found["tilt"].low_shift - found["right"].low_shift == pytest.approx(1.0, abs=0.05)
    assert found["tilt"].difference - found["right"].difference == pytest.approx(0.0, abs=0.05)


def test_the_error_of_the_mean_covers_the_diagonal(low_band: Instrument) -> None:
    pulls = []
    for seed in range(40):
        rng = np.random.default_rng(100 + seed)
        made = record(draw_signals(rng, 10, 200), low_band, load_hamaker(), C, BACKGROUND, rng)
        pulls.append(compare_calibrations(made, FREQUENCY, {"right": C})["right"].significance)
    # 40 trials know the scatter to 11 %; Student's t of 9 degrees of freedom scatters by 1.13, less the 6 % of its 68 %
    assert 0.7 < np.std(pulls) < 1.5
    assert abs(np.mean(pulls)) < 0.6


@pytest.mark.parametrize("scatter", [0.0, 1.0])
def test_a_few_strong_events_no_longer_make_the_error_of_the_mean_too_small(scatter: float) -> None:
    # errors that span a factor of ten, as signals over background of 30 to 3000 make them; a jackknife of these
    # covers 2 sigma in 92 % without scatter and in 90 % with
    rng = np.random.default_rng(7)
    trials, size = 4000, 20
    pulls, means = np.empty(trials), np.empty(trials)
    for k in range(trials):
        sigma = np.exp(rng.uniform(np.log(0.1), 0.0, size))
        means[k], error = mean_of_unequal(rng.normal(0.0, np.hypot(sigma, scatter)), sigma)
        pulls[k] = means[k] / error
    # 4000 trials know 68 % to 0.7 and 95 % to 0.35
    assert np.mean(np.abs(pulls) < 1) == pytest.approx(0.685, abs=0.02)
    assert np.mean(np.abs(pulls) < 2) == pytest.approx(0.945, abs=0.01)


def test_the_mean_of_equal_values_is_theirs_with_students_error() -> None:
    mean, error = mean_of_unequal(np.array([1.0, 2.0, 3.0]), np.full(3, 1e-9))
    # standard error 1/sqrt(3), and 1.321 for two degrees of freedom
    assert (mean, error) == pytest.approx((2.0, 1.321 / np.sqrt(3.0)), rel=1e-3)


def test_signals_below_the_background_are_refused(low_band: Instrument) -> None:
    rng = np.random.default_rng(3)
    made = record(draw_signals(rng, 5, 20), low_band, load_hamaker(), C, BACKGROUND, rng, (0.001, 0.002))
    with pytest.raises(BadInputError, match="above the background"):
        compare_calibrations(made, FREQUENCY, {"right": C})


BINS = band_bins()


def spectra(slope: float, signal_over_background: float, trials: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Power of two components of a field in equal backgrounds, background subtracted."""
    rng = np.random.default_rng(seed)
    truth = 10 ** (slope * (BINS - 55.0))
    noise = 1.0 / signal_over_background
    parts = rng.normal(scale=np.sqrt(noise / 4), size=(2, 2, trials, BINS.size))
    field = (np.sqrt(truth) + parts[0, 0] + 1j * parts[0, 1], parts[1, 0] + 1j * parts[1, 1])
    power = np.abs(field[0]) ** 2 + np.abs(field[1]) ** 2 - noise
    return power, np.full_like(power, noise)


def test_the_slope_of_an_exponential_is_found_in_both_bands() -> None:
    power, background = spectra(-0.02, 1e12, 3)
    slopes = fit_slopes(BINS, power, background)
    assert slopes.low == pytest.approx(np.full(3, -0.02), rel=1e-4)
    assert slopes.high == pytest.approx(np.full(3, -0.02), rel=1e-4)


def test_a_kink_between_the_bands_is_their_difference() -> None:
    power = np.where(BINS < 60, 10 ** (-0.01 * (BINS - 60)), 10 ** (-0.03 * (BINS - 60)))[None]
    assert fit_slopes(BINS, power, 1e-9 * power).difference == pytest.approx([-0.02], rel=1e-4)


@pytest.mark.parametrize("signal_over_background", [300.0, 30.0])
def test_errors_of_slopes_cover_the_truth_without_bias(signal_over_background: float) -> None:
    power, background = spectra(-0.015, signal_over_background, 2000)
    slopes = fit_slopes(BINS, power, background)
    for found, sigma in ((slopes.low, slopes.low_sigma), (slopes.high, slopes.high_sigma)):
        pull = (found + 0.015) / sigma
        known = np.isfinite(pull)
        assert known.mean() > 0.95
        assert np.std(pull[known]) == pytest.approx(1.0, abs=0.12)
        assert np.mean(pull[known]) == pytest.approx(0.0, abs=0.12)


def test_errors_hold_where_the_background_is_nearly_as_strong_as_the_signal() -> None:
    """Without the background's own scatter they are 12 % too small."""
    slopes = fit_slopes(BINS, *spectra(-0.015, 1.5, 2000))
    assert np.std((slopes.low + 0.015) / slopes.low_sigma) == pytest.approx(1.0, abs=0.05)


def test_a_spectrum_that_is_background_has_no_slope() -> None:
    power, background = spectra(-0.015, 0.05, 50)
    slopes = fit_slopes(BINS, power, background)
    assert np.mean(np.isfinite(slopes.high)) < 0.1


def test_the_contour_holds_68_per_cent() -> None:
    rng = np.random.default_rng(4)
    common = rng.normal(-0.02, 0.006, 5000)
    power = 10 ** (
        (common + rng.normal(0, 0.001, 5000))[:, None] * np.minimum(BINS - 60, 0)
        + (common + rng.normal(0, 0.001, 5000))[:, None] * np.maximum(BINS - 60, 0)
    )
    slopes = fit_slopes(BINS, power, 1e-9 * power)
    low, high = slopes.contour(361)
    # turned into the ellipse's axes, a point is inside where its distance is below that of the contour
    centre = np.array([low[:-1].mean(), high[:-1].mean()])
    covariance = np.cov(np.stack([low[:-1], high[:-1]]))

    def distance(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        offset = np.stack([x - centre[0], y - centre[1]])
        return np.einsum("in,ij,jn->n", offset, np.linalg.inv(covariance), offset)

    inside = distance(slopes.low, slopes.high) < distance(low, high).mean()
    assert np.mean(inside) == pytest.approx(0.68, abs=0.02)


def test_a_few_weak_signals_do_not_decide_the_covariance() -> None:
    rng = np.random.default_rng(5)
    sample = rng.normal(size=(2, 1000))
    sample[:, :20] *= 100
    assert robust_covariance(sample)[0, 0] < 3
