"""Antenna models of NuRadioMC."""

from __future__ import annotations

import os
import pickle
from dataclasses import dataclass

import numpy as np
import pytest

from lbacal_core.antenna.model import zenith_gain
from lbacal_core.antenna.names import load_antenna
from lbacal_core.errors import UnreadableFileError
from tests.lbacal_core.antenna.conftest import DIPOLE


def columns(one):
    """One row a frequency and direction, phi before zenith, as NuRadioMC sorts them; GHz, rad, m."""
    nu, phi, zenith = np.meshgrid(
        one.frequency_mhz / 1e3, np.radians(one.phi_deg), np.radians(one.zenith_deg), indexing="ij"
    )
    rows = (nu, zenith, phi, one.phi.transpose(0, 2, 1), one.theta.transpose(0, 2, 1))
    return [0.0, 0.0, np.pi / 2, np.float64(0.0), *(row.ravel() for row in rows)]


@pytest.mark.parametrize("protocol", [2, 4, 5])
def test_a_dipole_comes_back_with_its_level(protocol, tabulated, tmp_path):
    path = tmp_path / "dipole.pkl"
    path.write_bytes(pickle.dumps(columns(tabulated), protocol=protocol))
    table = load_antenna(str(path))
    tabulated.require_the_same(table)
    np.testing.assert_allclose(
        zenith_gain(table, tabulated.frequency_mhz), zenith_gain(DIPOLE, tabulated.frequency_mhz), rtol=1e-5
    )


@dataclass(frozen=True)
class Touches:
    """Made again by calling `os.mkdir`, as a hostile pickle calls what it likes."""

    path: str

    def __reduce__(self):
        return (os.mkdir, (self.path,))


def test_a_pickle_that_names_a_function_is_refused_and_nothing_of_it_is_executed(tmp_path):
    path, made = tmp_path / "evil.pkl", tmp_path / "made"
    path.write_bytes(pickle.dumps([0, 0, 0, 0, Touches(str(made))]))
    with pytest.raises(UnreadableFileError, match=r"it names posix.mkdir, which is no part of an array"):
        load_antenna(str(path))
    assert not made.exists()


@pytest.mark.parametrize("content", [b"", b"no pickle", pickle.dumps([1, 2]), pickle.dumps("text")])
def test_a_file_that_is_none_is_one_sentence(content, tmp_path):
    (tmp_path / "no.pkl").write_bytes(content)
    with pytest.raises(UnreadableFileError, match="expected a pickled list of four angles and the arrays"):
        load_antenna(str(tmp_path / "no.pkl"))
