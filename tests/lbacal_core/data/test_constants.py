from __future__ import annotations

from scipy import constants as codata

from lbacal_core.data import constants


def test_constants_are_those_of_scipy() -> None:
    own = (constants.BOLTZMANN, constants.SPEED_OF_LIGHT, constants.VACUUM_PERMEABILITY, constants.VACUUM_PERMITTIVITY)
    assert own == (codata.Boltzmann, codata.speed_of_light, codata.mu_0, codata.epsilon_0)
