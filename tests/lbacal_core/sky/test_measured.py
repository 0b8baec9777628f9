from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.sky.names import PIVOT_MHZ, SkyLevel, load_sky, read_sky_level, tie_to_measurements

NU = np.array([30.0, 50.0, 65.0, 80.0, 100.0])


def test_the_measured_sky_is_the_map_times_the_measured_level() -> None:
    base, measured = load_sky("gsm"), load_sky("measured")
    cmb = np.sqrt(4 * np.pi) * base.isotropic_k(NU)
    expected = np.exp(read_sky_level().ln_ratio(NU))
    ratio = (measured.temperature(NU)[:, 0, 0].real - cmb) / (base.temperature(NU)[:, 0, 0].real - cmb)
    np.testing.assert_allclose(ratio, expected, rtol=1e-9)
    anisotropy = measured.temperature(NU)[:, 3, 2] / base.temperature(NU)[:, 3, 2]
    np.testing.assert_allclose(anisotropy, expected, rtol=1e-9)
    assert measured.name == "measured"
    assert measured.digest() != base.digest()


def test_the_measured_sky_is_hotter_by_what_was_measured_absolutely() -> None:
    # EDGES over gsm, LST means, is 1.15 at 50 and 1.09 at 80 MHz; other experiments agree within their errors
    level = read_sky_level()
    np.testing.assert_allclose(np.exp(level.ln_ratio(NU))[[1, 3]], [1.13, 1.09], atol=0.03)
    assert np.all((level.sigma(NU) > 0.02) & (level.sigma(NU) < 0.06))


def test_the_error_of_the_level_is_smallest_near_the_pivot() -> None:
    level = SkyLevel(0.1, -0.07, np.diag([0.03**2, 0.02**2]), 0.0)
    assert level.sigma(np.array([PIVOT_MHZ]))[0] == pytest.approx(0.03)
    assert level.sigma(np.array([PIVOT_MHZ * np.e]))[0] == pytest.approx(np.hypot(0.03, 0.02))


def test_the_digest_does_not_hang_on_the_last_bits_of_an_exponential() -> None:
    level = read_sky_level()
    nudged = SkyLevel(np.nextafter(level.level, 1.0), level.slope, level.covariance, level.scatter)
    base = load_sky("gsm")
    assert tie_to_measurements(base, nudged).digest() == tie_to_measurements(base, level).digest()
