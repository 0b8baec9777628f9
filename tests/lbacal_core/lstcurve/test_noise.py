from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.errors import BadInputError
from lbacal_core.lstcurve.curve import LstCurve, estimate_noise, estimate_point_noise, measured_curve, read_lst_curve

LST = np.arange(0, 24, 0.1)
SMOOTH = np.cos((LST - 19) * np.pi / 12) + 0.3 * np.sin(LST * np.pi / 4)


def curve_with(noise):
    """A smooth curve of 240 points with noise of shape (dipole, point)."""
    values = {d: SMOOTH + one for d, one in zip("XY", noise, strict=True)}
    return LstCurve(LST, values, np.full(240, 0.11), 0.1, is_centre_stated=True)


def test_the_point_noise_is_found_about_a_smooth_curve() -> None:
    curve = curve_with(np.random.default_rng(2).normal(scale=0.05, size=(2, 240)))
    assert estimate_point_noise(curve, "X") == pytest.approx(0.05, rel=0.15)  # 227 degrees of freedom: 5 %


def test_what_the_dipoles_share_is_found_as_their_correlation() -> None:
    rng = np.random.default_rng(3)
    shared, own = 0.045 * rng.standard_normal(240), 0.015 * rng.standard_normal((2, 240))
    noise = estimate_noise(curve_with(shared + own))
    assert noise.correlation == pytest.approx(0.9, abs=0.04)  # 0.013 one sigma
    assert noise.sigma_db["Y"] == pytest.approx(np.hypot(0.045, 0.015), rel=0.15)
    assert noise.free == 2 * (240 - 13)


def test_independent_dipoles_are_not_correlated() -> None:
    noise = estimate_noise(curve_with(0.05 * np.random.default_rng(4).standard_normal((2, 240))))
    assert abs(noise.correlation) < 0.2  # 0.066 one sigma


def test_the_covariance_links_only_the_two_points_of_one_lst() -> None:
    curve = read_lst_curve(measured_curve())
    noise = estimate_noise(curve)
    covariance = noise.covariance(curve)
    points = int(curve.has_point("X").sum())
    assert covariance.shape == (91, 91)
    np.linalg.cholesky(covariance)
    assert np.count_nonzero(covariance[:points, points:]) == int((curve.has_point("X") & curve.has_point("Y")).sum())


def test_the_measured_dipoles_share_most_of_their_noise() -> None:
    noise = estimate_noise(read_lst_curve(measured_curve()))
    assert noise.correlation > 0.85
    assert all(0.04 < sigma < 0.06 for sigma in noise.sigma_db.values())  # less than half of the drawn 0.11 dB


def test_too_few_points_are_refused_with_the_number_needed() -> None:
    few = np.arange(0, 24, 2.0)
    values = {d: np.cos(few) for d in "XY"}
    with pytest.raises(BadInputError, match="18 points or more"):
        estimate_noise(LstCurve(few, values, np.full(12, 0.1), 2.0, is_centre_stated=True))
