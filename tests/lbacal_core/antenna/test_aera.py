"""Antenna models of Auger Offline."""

from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.antenna.model import zenith_gain
from lbacal_core.antenna.names import load_antenna
from lbacal_core.errors import BadInputError, UnreadableFileError
from tests.lbacal_core.antenna.conftest import DIPOLE


def write(one, path):
    zenith, phi = (axis.ravel() for axis in np.meshgrid(one.zenith_deg, one.phi_deg, indexing="ij"))

    def block(name, values, attributes=""):
        return f"<{name} {attributes}> {' '.join(f'{value:.9g}' for value in values)} </{name}>\n"

    text = "<!-- <frequency>1 2 3</frequency> -->\n"
    text += block("frequency", one.frequency_mhz, 'unit="MHz"') + block("theta", zenith, 'unit="deg"')
    text += block("phi", phi, 'unit="deg"')
    for k, nu in enumerate(one.frequency_mhz):
        for name, values in (("EAHTheta", one.theta[k].ravel()), ("EAHPhi", one.phi[k].ravel())):
            text += block(f"{name}_amp", np.abs(values), f'unit="m" idfreq="{nu:.1f}"')
            text += block(f"{name}_phase", np.degrees(np.angle(values)), f'unit="deg" idfreq="{nu:.1f}"')
    path.write_text(text)
    return path


def test_a_dipole_comes_back_with_its_level(tabulated, tmp_path):
    table = load_antenna(str(write(tabulated, tmp_path / "dipole.xml")))
    tabulated.require_the_same(table)
    assert table.has_level
    np.testing.assert_allclose(
        zenith_gain(table, tabulated.frequency_mhz), zenith_gain(DIPOLE, tabulated.frequency_mhz), rtol=1e-5
    )


def test_what_is_missing_is_named(tabulated, tmp_path):
    path = write(tabulated, tmp_path / "dipole.xml")
    text = path.read_text()
    path.write_text(text.replace("<phi ", "<fi ").replace("</phi>", "</fi>"))
    with pytest.raises(UnreadableFileError, match="found no phi"):
        load_antenna(str(path))
    path.write_text(text.replace('idfreq="50.0"', 'idfreq="51.0"', 1))
    with pytest.raises(BadInputError, match="EAHTheta_amp at 50 MHz: expected 684 numbers, found none"):
        load_antenna(str(path))
