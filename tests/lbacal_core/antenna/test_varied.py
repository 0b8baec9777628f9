from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.antenna.hamaker import load_hamaker
from lbacal_core.antenna.ideal import IsotropicAntenna
from lbacal_core.antenna.model import directional_response, power_pattern, zenith_gain
from lbacal_core.antenna.varied import VariedAntenna, beam_solid_angle, mean_cosine
from lbacal_core.errors import BadInputError

FREQUENCY_MHZ = np.array([30.0, 55.0, 80.0])
DIRECTIONS = np.array([0.2, 0.9, 1.3]), np.array([0.1, 2.0, 4.0])


def test_zenith_gain_changes_the_zenith_and_not_the_total_power() -> None:
    base = load_hamaker()
    varied = VariedAntenna(base, zenith_gain=0.1)
    gain = zenith_gain(varied, FREQUENCY_MHZ) / zenith_gain(base, FREQUENCY_MHZ)
    assert gain == pytest.approx(1.1, rel=1e-12)
    assert gain * beam_solid_angle(varied, FREQUENCY_MHZ) == pytest.approx(beam_solid_angle(base, FREQUENCY_MHZ))


def test_a_turned_arm_sees_what_the_arm_saw_further_on() -> None:
    base = load_hamaker()
    zenith, azimuth = DIRECTIONS
    turned = directional_response(VariedAntenna(base, azimuth_deg=7.0), FREQUENCY_MHZ, zenith, azimuth)
    assert turned == pytest.approx(directional_response(base, FREQUENCY_MHZ, zenith, azimuth - np.radians(7.0)))


def test_zenith_weighting_multiplies_by_a_power_of_the_cosine() -> None:
    base = load_hamaker()
    zenith, azimuth = DIRECTIONS
    ratio = directional_response(
        VariedAntenna(base, zenith_exponent=0.3), FREQUENCY_MHZ, zenith, azimuth
    ) / directional_response(base, FREQUENCY_MHZ, zenith, azimuth)
    assert ratio == pytest.approx(np.broadcast_to(np.cos(zenith) ** 0.3, (3, 3)))


def test_a_tilted_antenna_looks_where_it_leans() -> None:
    base = load_hamaker()
    tilted = VariedAntenna(base, tilt_deg=5.0, tilt_towards_deg=90.0)
    leaning = power_pattern(tilted, FREQUENCY_MHZ, np.radians([5.0]), np.radians([90.0]))
    assert leaning == pytest.approx(power_pattern(base, FREQUENCY_MHZ, np.zeros(1), np.radians([90.0])))
    away = power_pattern(tilted, FREQUENCY_MHZ, np.radians([50.0]), np.radians([270.0]))
    assert away == pytest.approx(power_pattern(base, FREQUENCY_MHZ, np.radians([55.0]), np.radians([270.0])))


def test_the_mean_cosine_of_an_isotropic_antenna_is_one_half() -> None:
    assert mean_cosine(IsotropicAntenna(), FREQUENCY_MHZ) == pytest.approx(0.5)


def test_a_pattern_that_would_turn_negative_is_refused() -> None:
    with pytest.raises(BadInputError, match=r"zenith_gain: expected -0\.4 to 0\.4"):
        VariedAntenna(load_hamaker(), zenith_gain=0.6)
