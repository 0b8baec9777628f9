from __future__ import annotations

import numpy as np
import pytest
from astropy import units as u
from astropy.table import QTable

import lbacal
from lbacal_core.errors import BadInputError

NU = np.array([30.0, 55.0, 80.0])
GAIN = np.array([3.5, 310.0, 19.0])


def make_table() -> QTable:
    table = QTable()
    table["frequency_mhz"] = np.tile(NU, 2) * u.MHz
    table["c"] = np.tile([1.0, 2.0, 3.0], 2) * 1e-5 * u.V
    table["c_sigma_stat"] = 0.01 * table["c"]
    table["c_sigma_sys"] = 0.1 * table["c"]
    table["antenna_gain"] = np.tile(GAIN, 2) * u.m**2
    table["c_over_h"] = table["c"] / np.sqrt(table["antenna_gain"])
    return table


def test_c_carried_to_another_antenna_gives_the_same_field() -> None:
    table, other = make_table(), np.array([20.0, 3.5, 457.0])
    carried = lbacal.carry_to_antenna(table, NU[[2, 0, 1]], other)  # in any order of channels
    np.testing.assert_allclose((carried["c"] / np.sqrt(carried["antenna_gain"]) / table["c_over_h"]).value, 1.0)
    np.testing.assert_allclose((carried["c"] / table["c"]).value[:3], np.sqrt(other[[1, 2, 0]] / GAIN))
    np.testing.assert_allclose((carried["c_sigma_stat"] / carried["c"]).value, 0.01)
    np.testing.assert_array_equal(table["antenna_gain"].value, np.tile(GAIN, 2))  # the table given is as it was


def test_c_carried_to_its_own_antenna_is_what_it_was() -> None:
    np.testing.assert_array_equal(lbacal.carry_to_antenna(make_table(), NU, GAIN)["c"], make_table()["c"])


@pytest.mark.parametrize(
    ("nu", "gain", "said"),
    [(NU[:2], GAIN[:2], "none at 80 MHz"), (NU, GAIN[:2], "a finite number > 0"), (NU, -GAIN, "a finite number > 0")],
)
def test_a_gain_that_does_not_cover_the_channels_is_refused(nu: np.ndarray, gain: np.ndarray, said: str) -> None:
    with pytest.raises(BadInputError, match=said):
        lbacal.carry_to_antenna(make_table(), nu, gain)


def test_c_of_unknown_antenna_gain_is_not_mixed_with_another_antenna() -> None:
    table = make_table()
    table["antenna_gain"] = np.nan * u.m**2
    with pytest.raises(BadInputError, match="refit"):
        lbacal.carry_to_antenna(table, NU, GAIN)
    table.remove_column("antenna_gain")
    with pytest.raises(BadInputError, match="no such column"):
        lbacal.carry_to_antenna(table, NU, GAIN)
