import os
import pickle
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from lbacal_core.antenna.files import grid_rows, turn_to_arm
from lbacal_core.antenna.ideal import ShortDipole
from lbacal_core.antenna.lofar import load_hamaker
from lbacal_core.antenna.model import AntennaModel, directional_response, zenith_gain
from lbacal_core.antenna.names import load_antenna
from lbacal_core.antenna.varied import VariedAntenna
from lbacal_core.errors import BadInputError, UnknownNameError, UnreadableFileError
from tests.lbacal_core.antenna.conftest import DIPOLE
from tests.oracles import beam_solid_angle

NU = np.array([30.0, 45.0, 60.0, 80.0])
ZENITH = np.arange(0.0, 91.0, 5.0)
AZIMUTH = np.arange(0.0, 360.0, 10.0)
# Turned against its own arm, so that no mirror symmetry hides a wrong sense of azimuth.
ANTENNA = VariedAntenna(ShortDipole(height_m=1.2), azimuth_deg=25.0)


def grid(antenna: AntennaModel = ANTENNA) -> tuple[np.ndarray, np.ndarray]:
    zenith, azimuth = np.meshgrid(np.radians(np.minimum(ZENITH, 89.999)), np.radians(AZIMUTH), indexing="ij")
    return antenna.jones(NU, zenith, azimuth)


def write_npz(path: Path) -> Path:
    theta, phi = grid()
    np.savez(path, frequency_mhz=NU, zenith_deg=ZENITH, azimuth_deg=AZIMUTH, v_theta=theta, v_phi=phi)
    return path


def write_text(path: Path) -> Path:
    theta, phi = grid()
    rows = ["# a table of Jones terms", "frequency_mhz,zenith_deg,azimuth_deg,theta_re,theta_im,phi_re,phi_im"]
    for f, z, a in np.ndindex(theta.shape):
        one, two = theta[f, z, a], phi[f, z, a]
        rows.append(f"{NU[f]},{ZENITH[z]},{AZIMUTH[a]},{one.real},{one.imag},{two.real},{two.imag}")
    path.write_text("\n".join(rows))
    return path


def transmitted() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """E_theta, E_phi as a simulator gives them: times frequency, phi counterclockwise."""
    theta, phi = grid()
    return theta * NU[:, None, None], -phi * NU[:, None, None], (-AZIMUTH) % 360.0


def write_feko(path: Path) -> Path:
    e_theta, e_phi, angle = transmitted()
    lines = ["##File Type: Far Field", "##File Format: 3"]
    for f, nu in enumerate(NU):
        lines += [f"#Frequency:   {nu * 1e6:.8E}", "#Coordinate System: Spherical"]
        lines += ['#"Theta" "Phi" "Re(Etheta)" "Im(Etheta)" "Re(Ephi)" "Im(Ephi)" "Directivity(Total)"']
        for z, a in np.ndindex(e_theta.shape[1:]):
            one, two = e_theta[f, z, a], e_phi[f, z, a]
            lines.append(f" {ZENITH[z]} {angle[a]} {one.real} {one.imag} {two.real} {two.imag} -3.0")
    path.write_text("\n".join(lines))
    return path


def write_nec(path: Path) -> Path:
    e_theta, e_phi, angle = transmitted()
    lines = ["  ********  NUMERICAL ELECTROMAGNETICS CODE (nec2c)  ********"]
    for f, nu in enumerate(NU):
        lines += ["    --------- FREQUENCY --------", f"    FREQUENCY : {nu:.4E} MHz", "  FREQUENCY LOOP OVER"]
        lines += [
            "    ---------- RADIATION PATTERNS -----------",
            "  THETA  PHI  VERTC HORIZ TOTAL AXIAL TILT SENSE MAG",
        ]
        for z, a in np.ndindex(e_theta.shape[1:]):
            one, two = e_theta[f, z, a], e_phi[f, z, a]
            lines.append(
                f"{ZENITH[z]:8.2f} {angle[a]:8.2f} -1.0 -2.0 0.5 0.0 0.0 LINEAR {abs(one):.9E} "
                f"{np.degrees(np.angle(one)):.6f} {abs(two):.9E} {np.degrees(np.angle(two)):.6f}"
            )
        lines.append("  TOTAL RUN TIME: 0.1 s")
    path.write_text("\n".join(lines))
    return path


def write_wipl(path: Path) -> Path:
    e_theta, e_phi, angle = transmitted()
    lines = []
    for f, nu in enumerate(NU):
        lines.append(f"> Gen. no. 1 {nu / 1e3} GHz")
        for z, a in np.ndindex(e_theta.shape[1:]):
            one, two = -e_theta[f, z, a], e_phi[f, z, a]
            lines.append(f"{angle[a]} {90 - ZENITH[z]} {two.real} {two.imag} {one.real} {one.imag} 1.0 0.0")
    path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize(
    ("writer", "name"),
    [(write_npz, "a.npz"), (write_text, "a.csv"), (write_feko, "a.ffe"), (write_nec, "a.out"), (write_wipl, "a.ra1")],
)
def test_every_kind_of_file_gives_the_antenna_that_was_written(tmp_path, writer, name):
    antenna = load_antenna(str(writer(tmp_path / name)))
    zenith, azimuth = np.radians([3.0, 22.0, 41.0, 77.0]), np.radians([14.0, 133.0, 222.0, 355.0])
    expected = directional_response(ANTENNA, NU, zenith, azimuth)
    # 1e-3: cubic splines through a grid of 5 x 10 degrees.
    assert directional_response(antenna, NU, zenith, azimuth) == pytest.approx(expected, abs=1e-3)
    # The wrong sense of azimuth would be visible.
    assert np.abs(directional_response(ANTENNA, NU, zenith, -azimuth) - expected).max() > 0.02


def test_the_gain_at_zenith_comes_with_the_table_and_within_its_frequencies(tmp_path):
    antenna = load_antenna(str(write_npz(tmp_path / "a.npz")))
    between = np.array([50.0])
    assert zenith_gain(antenna, between) == pytest.approx(zenith_gain(ANTENNA, between), rel=0.01)
    with pytest.raises(BadInputError, match="30 to 80 MHz"):
        zenith_gain(antenna, np.array([90.0]))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("30.0,0.0,20.0,", "30.0,0.0,20.0,x", "line 5: expected numbers"),
        ("30.0,65.0,30.0,", "# 30.0,65.0,30.0,", "none at 30 MHz"),
    ],
)
def test_a_bad_number_is_named_by_its_line_and_a_missing_direction_by_its_place(tmp_path, old, new, said):
    path = write_text(tmp_path / "a.csv")
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(BadInputError, match=said):
        load_antenna(str(path))


def test_a_file_of_another_kind_is_refused(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("hello\n")
    with pytest.raises(UnreadableFileError, match=r"FEKO \.ffe"):
        load_antenna(str(path))
    with pytest.raises(UnknownNameError, match="hamaker"):
        load_antenna("yagi")


@pytest.mark.shared
def test_the_simulated_lba_agrees_with_the_element_beam_about_arm_and_width(shared):
    simulated = load_antenna(str(shared / "data/antenna/lba_vout.npz"))
    element = load_hamaker()
    nu = np.array([35.0, 50.0, 65.0])
    ratio = beam_solid_angle(simulated, nu) / beam_solid_angle(element, nu)
    assert ratio == pytest.approx(1.0, abs=0.1)
    zenith, azimuth = np.full(2, np.radians(60.0)), np.array([0.0, np.pi / 2])
    along, across = directional_response(simulated, nu, zenith, azimuth).T
    assert np.all(across > 1.5 * along)


def write_xml(one, path):
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


def test_what_is_missing_is_named(tabulated, tmp_path):
    path = write_xml(tabulated, tmp_path / "dipole.xml")
    text = path.read_text()
    path.write_text(text.replace("<phi ", "<fi ").replace("</phi>", "</fi>"))
    with pytest.raises(UnreadableFileError, match="found no phi"):
        load_antenna(str(path))
    path.write_text(text.replace('idfreq="50.0"', 'idfreq="51.0"', 1))
    with pytest.raises(BadInputError, match="EAHTheta_amp at 50 MHz: expected 684 numbers, found none"):
        load_antenna(str(path))


def turn(one, theta, phi):
    return turn_to_arm("x", "x.xml", [one.frequency_mhz, one.zenith_deg, one.phi_deg], theta, phi, has_level=True)


def test_the_arm_is_found_in_the_pattern_wherever_it_lies(tabulated):
    tabulated.require_the_same(turn(tabulated, tabulated.theta, tabulated.phi))


def test_an_antenna_that_answers_to_every_direction_alike_has_no_arm(tabulated):
    quarter = tabulated.phi_deg.size // 4
    crossed_theta = tabulated.theta + 1j * np.roll(tabulated.theta, quarter, axis=2)
    crossed_phi = tabulated.phi + 1j * np.roll(tabulated.phi, quarter, axis=2)
    with pytest.raises(BadInputError, match=r"expected one arm: 90% of the response at zenith .* found 50%"):
        turn(tabulated, crossed_theta, crossed_phi)


def test_rows_come_in_any_order_and_a_hole_is_named():
    frequency, zenith, phi = (np.array(one, dtype=float) for one in ([30, 30, 30, 30], [0, 0, 5, 5], [90, 360, 90, 0]))
    axes, (grid,) = grid_rows("x", (frequency, zenith, phi), (np.array([2.0, 1.0, 4.0, 3.0], dtype=complex),))
    assert [axis.tolist() for axis in axes] == [[30.0], [0.0, 5.0], [0.0, 90.0]]
    np.testing.assert_array_equal(grid[0], [[1.0, 2.0], [3.0, 4.0]])
    with pytest.raises(BadInputError, match="found none at 30 MHz, 5, 0 deg"):
        grid_rows("x", (frequency[:3], zenith[:3], phi[:3]), (np.ones(3, dtype=complex),))


def test_a_direction_stands_twice_only_with_the_same_response():
    """An export of two ports, one behind the other, was read as the last."""
    frequency, zenith, phi = (np.array(one, dtype=float) for one in ([30, 30, 30], [0, 0, 0], [0, 90, 360]))
    _, (grid,) = grid_rows("x", (frequency, zenith, phi), (np.array([1.0, 2.0, 1.0001], dtype=complex),))
    assert grid.shape == (1, 1, 2)
    with pytest.raises(BadInputError, match="found two that differ at 30 MHz, 0, 0 deg"):
        grid_rows("x", (frequency, zenith, phi), (np.array([1.0, 2.0, 1.5], dtype=complex),))


def columns(one):
    """One row a frequency and direction, phi before zenith, as NuRadioMC sorts them; GHz, rad, m."""
    nu, phi, zenith = np.meshgrid(
        one.frequency_mhz / 1e3, np.radians(one.phi_deg), np.radians(one.zenith_deg), indexing="ij"
    )
    rows = (nu, zenith, phi, one.phi.transpose(0, 2, 1), one.theta.transpose(0, 2, 1))
    return [0.0, 0.0, np.pi / 2, np.float64(0.0), *(row.ravel() for row in rows)]


@pytest.mark.parametrize("protocol", [None, 2, 4, 5])
def test_a_dipole_comes_back_with_its_level_from_xml_and_from_a_pickle(protocol, tabulated, tmp_path):
    if protocol is None:
        path = write_xml(tabulated, tmp_path / "dipole.xml")
    else:
        path = tmp_path / "dipole.pkl"
        path.write_bytes(pickle.dumps(columns(tabulated), protocol=protocol))
    table, nu = load_antenna(str(path)), tabulated.frequency_mhz
    tabulated.require_the_same(table)
    assert table.has_level
    np.testing.assert_allclose(zenith_gain(table, nu), zenith_gain(DIPOLE, nu), rtol=1e-5)


@pytest.mark.parametrize("protocol", [2, 5])
def test_arrays_of_a_pickle_may_lie_in_memory_by_columns(protocol, tabulated, tmp_path):
    """Where some do and others do not, values belong to other directions if the order is not read."""
    made = columns(tabulated)
    shape = tabulated.frequency_mhz.size, -1
    made[4:] = [np.array(one.reshape(shape), order="CFCFF"[k]) for k, one in enumerate(made[4:])]
    path = tmp_path / "dipole.pkl"
    path.write_bytes(pickle.dumps(made, protocol=protocol))
    tabulated.require_the_same(load_antenna(str(path)))


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
