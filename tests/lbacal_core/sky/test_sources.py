from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.errors import BadInputError
from lbacal_core.sky.sources import SOURCES, find_sources


def test_cassiopeia_a_fades_and_the_others_do_not() -> None:
    nu = np.array([60.0])
    assert SOURCES["cas-a"].flux_jy(nu, 2015.0) / SOURCES["cas-a"].flux_jy(nu, 2014.0) == pytest.approx(1 - 0.0077)
    assert SOURCES["cyg-a"].flux_jy(nu, 2015.0) == SOURCES["cyg-a"].flux_jy(nu, 1990.0)


def test_in_2005_cassiopeia_a_had_faded_to_cygnus_a_at_74_mhz() -> None:
    nu = np.array([73.8])
    # In 1965 it was brighter by a third; 10 % is the accuracy of the scale and the decline over 40 years together.
    ratio = SOURCES["cas-a"].flux_jy(nu, 2005.0) / SOURCES["cyg-a"].flux_jy(nu, 2005.0)
    assert ratio == pytest.approx(1.0, abs=0.1)


def test_an_unknown_source_is_refused() -> None:
    with pytest.raises(BadInputError, match="cas-a, cyg-a"):
        find_sources(["sgr-a"])
