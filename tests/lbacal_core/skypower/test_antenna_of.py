from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import Instrument, load_instrument
from lbacal_core.skypower.antenna_of import antenna_of
from lbacal_core.skypower.model import compute_sky_power, vary_sky_power
from lbacal_core.skypower.sources import response_towards

LST = np.arange(24.0)


@pytest.fixture(scope="module")
def superterp() -> Instrument:
    return load_instrument("lofar-superterp")


def test_an_instrument_elsewhere_does_not_get_the_pattern_of_lofar(superterp: Instrument) -> None:
    """Before, the LBA's pattern on another antenna put C wrong by 24-51 % and nobody was told."""
    auger = replace(superterp, name="AERA", latitude_deg=-35.2, longitude_deg=-69.3, antenna=None)
    with pytest.raises(BadInputError, match=r"hamaker, hamaker-resonant, .*short-dipole"):
        compute_sky_power(auger)
    named = compute_sky_power(replace(auger, antenna="short-dipole"), lst_hours=LST)
    assert named.origin == "sky gsm, antenna short-dipole"


def test_a_file_of_a_lofar_station_that_names_no_antenna_gets_that_of_lofar(superterp: Instrument) -> None:
    assert (
        antenna_of(replace(superterp, name="RS509", latitude_deg=53.41, longitude_deg=6.79, antenna=None)) == "hamaker"
    )


def test_changes_of_the_beam_are_those_of_the_antenna_that_the_instrument_names(superterp: Instrument) -> None:
    """Before, sources and beam variations of any instrument were seen by the pattern of LOFAR."""
    named = replace(superterp, antenna="short-dipole")
    zenith, azimuth = np.array([0.9]), np.array([1.0])
    plain, other = (response_towards(one, "X", zenith, azimuth) for one in (superterp, named))
    np.testing.assert_array_equal(other, response_towards(superterp, "X", zenith, azimuth, "short-dipole"))
    assert np.max(np.abs(other / plain - 1)) > 0.1
    varied = vary_sky_power(named, lst_hours=LST, azimuth_deg=10.0)
    np.testing.assert_array_equal(
        varied.power["Y"], vary_sky_power(superterp, antenna="short-dipole", lst_hours=LST, azimuth_deg=10.0).power["Y"]
    )


def test_an_instrument_elsewhere_without_a_name_can_still_be_asked_for_ratios(superterp: Instrument) -> None:
    auger = replace(superterp, name="AERA", latitude_deg=-35.2, longitude_deg=-69.3, antenna=None)
    assert vary_sky_power(auger, lst_hours=LST, zenith_exponent=1.0).power["X"].shape == (24, 51)
