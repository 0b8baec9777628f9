from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.data.lofar import DIPOLES
from lbacal_core.lstcurve.compare import (
    AS_RECORDED,
    BAND_MHZ,
    band_weights,
    in_db,
    simulate_band_power,
)
from lbacal_paper.noise_results import crossings, find_noise_share, smooth_swing
from lbacal_paper.study import Study

FREQUENCY = np.arange(30.0, 81.0)


def test_crossings_of_a_ratio_are_interpolated() -> None:
    ratio = np.exp(1.0 - ((FREQUENCY - 55.0) / 12.0) ** 2)
    low, high = crossings(FREQUENCY, ratio)
    assert (low, high) == pytest.approx((43.0, 67.0), abs=0.05)


def test_a_noise_share_that_was_put_in_is_found_within_its_error(study: Study) -> None:
    weights = band_weights(study.instrument, AS_RECORDED, BAND_MHZ)
    rng = np.random.default_rng(5)
    planted = {
        dipole: in_db(simulate_band_power(study.sky_power, dipole, study.curve.lst_hours, weights), 0.4)
        + rng.normal(0, 0.05, study.curve.lst_hours.size)
        for dipole in DIPOLES
    }
    error_db = np.full(study.curve.lst_hours.size, 0.05)
    curve = replace(study.curve, variation_db=planted, error_db=error_db)
    share, sigma = find_noise_share(study, curve, is_exchanged=False)
    assert share == pytest.approx(0.4, abs=0.03)
    assert 0.01 < sigma < 0.3


def test_one_question_has_one_noise_share(study: Study) -> None:
    """0.17 +- 0.12 stood here, and n = 0.42 +- 0.09 (a share of 0.30) on the page of the measured curve."""
    free, sigma = find_noise_share(study, study.curve, is_exchanged=True)
    informed, _ = find_noise_share(study, study.curve, is_exchanged=True, is_published_known=True)
    assert informed / (1 - informed) == pytest.approx(0.42, abs=0.005)
    assert abs(free - informed) < sigma


def test_the_swing_of_a_sine_is_twice_its_amplitude(study: Study) -> None:
    wave = 0.7 * np.sin(2 * np.pi * study.curve.lst_hours / 24.0)
    curve = replace(study.curve, variation_db={"X": wave, "Y": wave})
    assert smooth_swing(curve, "X") == pytest.approx(1.4, abs=0.002)
