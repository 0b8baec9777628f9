from __future__ import annotations

import numpy as np
import pytest
from scipy.constants import speed_of_light

from lbacal_core.antenna.ideal import ShortDipole
from lbacal_core.antenna.inverted_v import InvertedV
from lbacal_core.antenna.model import directional_response, power_pattern
from lbacal_core.antenna.names import load_antenna
from lbacal_core.errors import BadInputError

FREQUENCY = np.array([30.0, 55.0, 80.0])
ZENITH, AZIMUTH = np.meshgrid(np.linspace(0.0, 1.5, 7), np.linspace(0.0, 2 * np.pi, 9), indexing="ij")


def test_short_level_arms_over_a_conductor_are_the_short_dipole() -> None:
    short = InvertedV(arm_m=1e-3, feed_m=1.5, droop_deg=0.0, conductivity=np.inf)
    expected = directional_response(ShortDipole(1.5), FREQUENCY, ZENITH, AZIMUTH)
    # Arms of a millimetre differ from points by (k l)^2 ~ 1e-6.
    np.testing.assert_allclose(directional_response(short, FREQUENCY, ZENITH, AZIMUTH), expected, atol=1e-5)


def test_level_arms_in_free_space_have_the_pattern_of_the_textbook() -> None:
    """Balanis, eq. 4-62: [cos(k l cos psi) - cos(k l)] / sin(psi), psi the angle from the arms."""
    free = InvertedV(droop_deg=0.0, permittivity=1.0, conductivity=0.0)
    electrical = 2e6 * np.pi * FREQUENCY[:, None, None] / speed_of_light * free.arm_m
    along = np.sin(ZENITH) * np.cos(AZIMUTH)
    pattern = (np.cos(electrical * along) - np.cos(electrical)) ** 2 / np.maximum(1 - along**2, 1e-12)
    expected = pattern / (1 - np.cos(electrical)) ** 2
    np.testing.assert_allclose(directional_response(free, FREQUENCY, ZENITH, AZIMUTH), expected, rtol=1e-6)


def test_an_upright_v_sees_vertical_waves_at_the_horizon_of_a_conductor() -> None:
    """Level arms see nothing there; the arms that slope down have a vertical moment, which the ground doubles."""
    low = np.full(1, np.pi / 2 - 1e-6)
    level = InvertedV(droop_deg=0.0, conductivity=np.inf)
    sloping = InvertedV(droop_deg=45.0, conductivity=np.inf)
    along = np.zeros(1)
    assert np.all(power_pattern(level, FREQUENCY, low, along) < 1e-8)
    assert np.all(
        power_pattern(sloping, FREQUENCY, low, along) > 1e-3 * power_pattern(sloping, FREQUENCY, along, along)
    )


@pytest.mark.parametrize("name", ["inverted-v", "inverted-v-wet"])
def test_shipped_antennas_resemble_the_element_beam_and_are_not_it(name: str) -> None:
    own = directional_response(load_antenna(name), FREQUENCY, ZENITH, AZIMUTH)
    beam = directional_response(load_antenna("hamaker"), FREQUENCY, ZENITH, AZIMUTH)
    difference = np.abs(own - beam)[:, :5]  # to a zenith angle of 57 degrees
    assert 0.02 < difference.max() < 0.4
    assert np.all(own >= 0)
    assert np.all(directional_response(load_antenna(name), FREQUENCY, np.full(2, 1.6), np.zeros(2)) == 0)
    assert load_antenna(name).digest() != load_antenna("hamaker").digest()


def test_arms_in_the_ground_are_refused() -> None:
    with pytest.raises(BadInputError, match="above the ground"):
        InvertedV(feed_m=0.5)
    with pytest.raises(BadInputError, match="permittivity"):
        InvertedV(permittivity=0.5)
