from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.errors import BadInputError
from lbacal_core.instrument import Instrument, load_instrument
from lbacal_core.skypower.antenna_of import antenna_of
from lbacal_core.skypower.model import compute_sky_power

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
