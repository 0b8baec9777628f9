from pathlib import Path

import numpy as np
import pytest
from scipy.constants import speed_of_light

from lbacal_core.antenna.ideal import ShortDipole
from lbacal_core.antenna.lofar import load_hamaker
from lbacal_core.antenna.model import directional_response
from lbacal_core.antenna.names import take_antenna_gain
from lbacal_core.antenna.unfolding import effective_heights
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import parse_instrument

NU = np.array([30.0, 45.0, 60.0, 80.0])
ZENITH, AZIMUTH = np.arange(0.0, 91.0, 5.0), np.arange(0.0, 360.0, 10.0)
HEIGHT_M, LENGTH_M = 1.2, 1.5
CONTENT = {
    "name": "one", "latitude_deg": -35.2, "longitude_deg": -69.3, "height_m": 1400.0,
    "frequency_mhz": NU.tolist(), "dipoles": {"X": {"azimuth_deg": 0.0}, "Y": {"azimuth_deg": 90.0}},
    "receiver_gain": [1.0] * 4, "cables": {"a": [0.5] * 4},
    "antennas": [{"station": "A", "antenna": 0, "cable": "a"}],
}  # fmt: skip


@pytest.fixture
def table(tmp_path: Path) -> str:
    """Voltage per field of a dipole of a given length: the textbook case times its length."""
    zenith, azimuth = np.meshgrid(np.radians(np.minimum(ZENITH, 89.999)), np.radians(AZIMUTH), indexing="ij")
    theta, phi = ShortDipole(HEIGHT_M).jones(NU, zenith, azimuth)
    path = tmp_path / "dipole.npz"
    grid = {"frequency_mhz": NU, "zenith_deg": ZENITH, "azimuth_deg": AZIMUTH}
    np.savez(path, **grid, v_theta=LENGTH_M * theta, v_phi=LENGTH_M * phi)
    return str(path)


def test_g_ant_of_a_dipole_over_a_plane_is_that_of_the_textbook(table):
    made = take_antenna_gain(CONTENT, "i.json", table, "textbook", is_absolute=True, scale_error=0.01)
    instrument = parse_instrument(made, "i.json")
    # H at zenith is l 2 sin(k h), with the image: G_ant = |H|^2
    exact = (LENGTH_M * 2 * np.sin(2e6 * np.pi * NU / speed_of_light * HEIGHT_M)) ** 2
    np.testing.assert_allclose(instrument.antenna_gain, exact, rtol=1e-5)
    assert instrument.antenna == table
    assert instrument.gain_provenance is not None
    assert (instrument.gain_provenance.kind, instrument.gain_provenance.scale_error) == ("absolute", 0.01)


def test_a_table_that_is_right_up_to_a_factor_is_relative(table):
    made = take_antenna_gain(CONTENT, "i.json", table, "somebody", is_absolute=False)
    assert made["antenna_gain_provenance"]["kind"] == "relative"


def test_a_pattern_without_a_level_and_an_export_of_a_transmitting_simulation_give_no_g_ant(tmp_path):
    path = tmp_path / "far.ra1"
    rows = [f"{phi} {theta} 0.1 0.2 0.3 0.4" for phi in range(0, 360, 30) for theta in range(0, 91, 30)]
    path.write_text("\n".join(["> 0 0 0 0.06", *rows]))
    for name in ("hamaker", "short-dipole", "isotropic", str(path)):
        with pytest.raises(BadInputError, match="a pattern that does not give the level"):
            take_antenna_gain(CONTENT, "i.json", name, "x", is_absolute=True)


def test_the_square_of_the_height_is_gain_times_response():
    nu, gain = np.array([40.0, 60.0]), np.array([0.2, 3.0])
    height = effective_heights(load_hamaker(), gain, nu, 0.8, 2.5)
    response = directional_response(load_hamaker(), nu, np.array([0.8]), np.array([2.5]))[:, 0]
    assert np.sum(np.abs(height) ** 2, axis=1) == pytest.approx(gain * response, rel=1e-12)
