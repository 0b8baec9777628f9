from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from lbacal_core.antenna.hamaker import load_hamaker
from lbacal_core.antenna.ideal import ShortDipole
from lbacal_core.antenna.model import AntennaModel, directional_response, zenith_gain
from lbacal_core.antenna.names import load_antenna
from lbacal_core.antenna.varied import VariedAntenna, beam_solid_angle
from lbacal_core.errors import BadInputError, UnknownNameError, UnreadableFileError

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
def test_every_kind_of_file_gives_the_antenna_that_was_written(
    tmp_path: Path, writer: Callable[[Path], Path], name: str
) -> None:
    antenna = load_antenna(str(writer(tmp_path / name)))
    zenith, azimuth = np.radians([3.0, 22.0, 41.0, 77.0]), np.radians([14.0, 133.0, 222.0, 355.0])
    expected = directional_response(ANTENNA, NU, zenith, azimuth)
    # 1e-3: cubic splines through a grid of 5 x 10 degrees.
    assert directional_response(antenna, NU, zenith, azimuth) == pytest.approx(expected, abs=1e-3)
    # The wrong sense of azimuth would be visible.
    assert np.abs(directional_response(ANTENNA, NU, zenith, -azimuth) - expected).max() > 0.02


def test_the_gain_at_zenith_comes_with_the_table(tmp_path: Path) -> None:
    antenna = load_antenna(str(write_npz(tmp_path / "a.npz")))
    between = np.array([50.0])
    assert zenith_gain(antenna, between) == pytest.approx(zenith_gain(ANTENNA, between), rel=0.01)


def test_a_missing_direction_is_named(tmp_path: Path) -> None:
    path = write_text(tmp_path / "a.csv")
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:500] + lines[501:]))
    with pytest.raises(BadInputError, match="none at 30 MHz"):
        load_antenna(str(path))


def test_a_bad_number_is_named_by_its_line(tmp_path: Path) -> None:
    path = write_text(tmp_path / "a.csv")
    path.write_text(path.read_text().replace("30.0,0.0,20.0,", "30.0,0.0,20.0,x", 1))
    with pytest.raises(BadInputError, match="line 5: expected numbers"):
        load_antenna(str(path))


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("hello\n")
    with pytest.raises(UnreadableFileError, match=r"FEKO \.ffe"):
        load_antenna(str(path))
    with pytest.raises(UnknownNameError, match="hamaker"):
        load_antenna("yagi")


def test_frequencies_outside_the_table_are_refused(tmp_path: Path) -> None:
    antenna = load_antenna(str(write_npz(tmp_path / "a.npz")))
    with pytest.raises(BadInputError, match="30 to 80 MHz"):
        zenith_gain(antenna, np.array([90.0]))


@pytest.mark.shared
def test_the_simulated_lba_agrees_with_the_element_beam_about_arm_and_width(shared: Path) -> None:
    simulated = load_antenna(str(shared / "data/antenna/lba_vout.npz"))
    element = load_hamaker()
    nu = np.array([35.0, 50.0, 65.0])
    ratio = beam_solid_angle(simulated, nu) / beam_solid_angle(element, nu)
    assert ratio == pytest.approx(1.0, abs=0.1)
    zenith, azimuth = np.full(2, np.radians(60.0)), np.array([0.0, np.pi / 2])
    along, across = directional_response(simulated, nu, zenith, azimuth).T
    assert np.all(across > 1.5 * along)
