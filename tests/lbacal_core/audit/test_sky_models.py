from __future__ import annotations

import numpy as np

from lbacal_core.audit.sky_match import load_models
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.skypower.differences import DifferenceModels
from lbacal_core.skypower.model import compute_sky_power

FREQUENCY, LST = np.array([40.0, 60.0]), np.arange(24.0)


def test_what_is_seen_is_the_sky_power_over_its_mean(low_band: Instrument) -> None:
    seen = load_models(low_band, FREQUENCY, "gsm", "hamaker").seen(LST, low_band.latitude_deg)
    power = compute_sky_power(low_band, antenna="hamaker")
    at = np.searchsorted(low_band.frequency_mhz, FREQUENCY)
    for d, dipole in enumerate(low_band.dipoles):
        expected = power.at(dipole, LST)[:, at].T
        np.testing.assert_allclose(seen.change[d], expected / expected.mean(axis=1, keepdims=True) - 1.0, atol=1e-6)


def test_a_difference_is_the_exchange_of_one_model(low_band: Instrument) -> None:
    others = DifferenceModels(skies=("gsm", "lfsm"), antennas=("inverted-v",))
    known = load_models(low_band, FREQUENCY, "gsm", "hamaker", others)
    seen = known.seen(LST, low_band.latitude_deg)
    assert seen.differences.shape == (2, 2, 2, 24)
    of_lfsm = load_models(low_band, FREQUENCY, "lfsm", "hamaker", others).seen(LST, low_band.latitude_deg)
    np.testing.assert_allclose(seen.differences[0], of_lfsm.change - seen.change, atol=1e-9)


def test_arms_turned_by_a_right_angle_see_what_the_other_arm_saw(low_band: Instrument) -> None:
    models = load_models(low_band, FREQUENCY, "gsm", "hamaker")
    plain, turned = (models.seen(LST, low_band.latitude_deg, angle).change for angle in (0.0, 90.0))
    np.testing.assert_allclose(turned, plain[::-1], atol=1e-9)
