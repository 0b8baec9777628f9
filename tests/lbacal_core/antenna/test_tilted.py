import numpy as np
import pytest
from scipy.constants import speed_of_light

from lbacal_core.antenna.ideal import ShortDipole
from lbacal_core.antenna.lofar import load_hamaker
from lbacal_core.antenna.model import directional_response, power_pattern
from lbacal_core.antenna.varied import VariedAntenna, raise_arm
from lbacal_core.errors import BadInputError

NU = np.array([50.0, 120.0])
ZENITH, AZIMUTH = np.radians([[20.0, 50.0, 80.0]]), np.radians([[10.0, 130.0, 250.0]])


@pytest.mark.parametrize("tilt", [-30.0, 25.0, 90.0])
def test_a_raised_dipole_is_two_currents_above_a_mirror(tilt):
    """The sum of the fields of the dipole and its image, written with vectors."""
    up = np.radians(tilt)
    arm, image = np.array([np.cos(up), 0, np.sin(up)]), np.array([-np.cos(up), 0, np.sin(up)])
    theta, phi = raise_arm(ShortDipole(1.5), tilt).jones(NU, ZENITH, AZIMUTH)
    for z, a, found_theta, found_phi in zip(ZENITH[0], AZIMUTH[0], theta[:, 0].T, phi[:, 0].T, strict=True):
        e_theta = np.array([np.cos(z) * np.cos(a), np.cos(z) * np.sin(a), -np.sin(z)])
        e_phi = np.array([-np.sin(a), np.cos(a), 0.0])
        phase = 2j * np.pi * 1e6 * NU / speed_of_light * 1.5 * np.cos(z)
        for unit, found in ((e_theta, found_theta), (e_phi, found_phi)):
            np.testing.assert_allclose(found, unit @ arm * np.exp(phase) + unit @ image * np.exp(-phase), atol=1e-12)


def test_an_arm_upright_sees_nothing_at_zenith_and_all_azimuths_alike():
    upright = raise_arm(ShortDipole(1.5), 90.0)
    assert np.all(power_pattern(upright, NU, np.zeros(3), np.arange(3.0)) < 1e-25)
    around = directional_response(upright, NU, np.full(8, 1.2), np.arange(8.0), ShortDipole(1.5))
    np.testing.assert_allclose(around, around[:, :1] * np.ones(8))


def test_another_pattern_leans_away_from_the_raised_end_and_no_further_than_20_degrees():
    antenna = load_hamaker()
    zenith = np.zeros(1), np.full(1, np.pi)
    for one in (antenna, VariedAntenna(antenna, zenith_gain=0.1)):
        leaning = power_pattern(raise_arm(one, 10.0), NU, np.radians([10.0]), np.radians([180.0]))
        np.testing.assert_allclose(leaning, power_pattern(one, NU, *zenith))
    with pytest.raises(BadInputError, match="tilt_deg: expected -20 to 20"):
        raise_arm(antenna, 45.0)


def test_a_varied_dipole_is_raised_before_it_is_varied():
    varied = VariedAntenna(ShortDipole(1.5), zenith_exponent=0.5)
    found = power_pattern(raise_arm(varied, 60.0), NU, ZENITH, AZIMUTH)
    raised = power_pattern(raise_arm(ShortDipole(1.5), 60.0), NU, ZENITH, AZIMUTH)
    np.testing.assert_allclose(found, raised * np.cos(ZENITH) ** 0.5)
