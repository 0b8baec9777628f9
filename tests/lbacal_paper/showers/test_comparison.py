from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.antenna.hamaker import load_hamaker
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import Instrument
from lbacal_paper.showers.comparison import compare_calibrations, mean_of_unequal
from lbacal_paper.showers.recording import record
from lbacal_paper.showers.signals import draw_signals

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
