from pathlib import Path

import numpy as np
import pytest

from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.lstcurve.curve import LstCurve, estimate_noise, estimate_point_noise, measured_curve, read_lst_curve

HEADER = "lst_h,x_db,y_db,error_db"
ROWS = [f"{lst:g},{0.1 * lst:g},{-0.1 * lst:g},0.1" for lst in np.arange(0, 24, 2.0)]


def _write(folder: Path, *lines: str) -> Path:
    path = folder / "curve.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_the_shipped_curve_has_the_91_points_of_the_figure():
    curve = read_lst_curve(measured_curve())
    assert [int(curve.has_point(dipole).sum()) for dipole in "XY"] == [44, 47]
    assert curve.bin_hours == 0.5
    assert set(np.unique(curve.error_db)) == {0.11}


def test_lst_is_the_left_edge_of_the_bin_unless_the_file_says_centre(tmp_path):
    edge = read_lst_curve(_write(tmp_path, "# a comment", HEADER, *ROWS))
    centre = read_lst_curve(_write(tmp_path, "# lst: centre", HEADER, *ROWS))
    np.testing.assert_allclose(edge.lst_hours - centre.lst_hours, 1.0)
    assert (edge.is_centre_stated, centre.is_centre_stated) == (False, True)


def test_further_columns_and_lines_are_ignored_and_an_empty_cell_is_no_point(tmp_path):
    rows = [f"7,{row}" for row in ROWS]
    rows[3] = "7,6.0,,-0.6,0.1"
    curve = read_lst_curve(_write(tmp_path, "# anything", "", f"other,{HEADER}", *rows, ""))
    assert not curve.has_point("X")[3]
    assert curve.has_point("Y")[3]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["lst_h,x_db,error_db", "0,0,0.1"], "no y_db"),
        ([HEADER], "at least one row"),
        ([HEADER, *ROWS[:3], "6.0,nan,0.1,0.1"], "line 5: x_db: expected a finite number"),
        ([HEADER, *ROWS[:3], "6.0,0.1,inf,0.1"], "line 5: y_db"),
        ([HEADER, *ROWS[:3], "6.0,0.1,much,0.1"], "line 5: y_db.*found much"),
        ([HEADER, *ROWS, "24.0,0.1,0.1,0.1"], "line 14: lst_h: expected hours from 0 to 24, found 24"),
        ([HEADER, *ROWS, "-1,0.1,0.1,0.1"], "line 14: lst_h"),
        ([HEADER, *ROWS, ",0.1,0.1,0.1"], "line 14: lst_h.*an empty cell"),
        ([HEADER, *ROWS, "2,0.1,0.1,0.1"], "line 14: expected one row an LST, found 2 twice"),
        ([HEADER, *ROWS, "1,0.1,0.1,"], "line 14: error_db"),
        ([HEADER, *ROWS, "1,0.1,0.1,0"], "line 14: error_db"),
        ([HEADER, *ROWS, "1,0.1,0.1"], "line 14: expected 4 cells as in the header, found 3"),
        ([HEADER, *[f"{k},,0.1,0.1" for k in range(12)]], "x_db: expected at least 4 points, found 0"),
    ],
)
def test_what_is_wrong_in_a_file_is_named_with_its_line(tmp_path, lines, message):
    with pytest.raises(BadInputError, match=message):
        read_lst_curve(_write(tmp_path, *lines))


@pytest.mark.parametrize("content", [b"", b"# only a comment\n", bytes(range(128, 256))])
def test_a_file_that_is_no_table_is_unreadable(tmp_path, content):
    path = tmp_path / "curve.csv"
    path.write_bytes(content)
    with pytest.raises(UnreadableFileError):
        read_lst_curve(path)
    with pytest.raises(UnreadableFileError, match="cannot be read"):
        read_lst_curve(tmp_path / "absent.csv")


LST = np.arange(0, 24, 0.1)
SMOOTH = np.cos((LST - 19) * np.pi / 12) + 0.3 * np.sin(LST * np.pi / 4)


def curve_with(noise):
    """A smooth curve of 240 points with noise of shape (dipole, point)."""
    values = {d: SMOOTH + one for d, one in zip("XY", noise, strict=True)}
    return LstCurve(LST, values, np.full(240, 0.11), 0.1, is_centre_stated=True)


def test_the_point_noise_is_found_about_a_smooth_curve():
    curve = curve_with(np.random.default_rng(2).normal(scale=0.05, size=(2, 240)))
    assert estimate_point_noise(curve, "X") == pytest.approx(0.05, rel=0.15)  # 227 degrees of freedom: 5 %


def test_what_the_dipoles_share_is_found_as_their_correlation():
    rng = np.random.default_rng(3)
    shared, own = 0.045 * rng.standard_normal(240), 0.015 * rng.standard_normal((2, 240))
    noise = estimate_noise(curve_with(shared + own))
    assert noise.correlation == pytest.approx(0.9, abs=0.04)  # 0.013 one sigma
    assert noise.sigma_db["Y"] == pytest.approx(np.hypot(0.045, 0.015), rel=0.15)
    assert noise.free == 2 * (240 - 13)


def test_independent_dipoles_are_not_correlated():
    noise = estimate_noise(curve_with(0.05 * np.random.default_rng(4).standard_normal((2, 240))))
    assert abs(noise.correlation) < 0.2  # 0.066 one sigma


def test_the_covariance_links_only_the_two_points_of_one_lst():
    curve = read_lst_curve(measured_curve())
    noise = estimate_noise(curve)
    covariance = noise.covariance(curve)
    points = int(curve.has_point("X").sum())
    assert covariance.shape == (91, 91)
    np.linalg.cholesky(covariance)
    assert np.count_nonzero(covariance[:points, points:]) == int((curve.has_point("X") & curve.has_point("Y")).sum())


def test_the_measured_dipoles_share_most_of_their_noise():
    noise = estimate_noise(read_lst_curve(measured_curve()))
    assert noise.correlation > 0.85
    assert all(0.04 < sigma < 0.06 for sigma in noise.sigma_db.values())  # less than half of the drawn 0.11 dB


def test_too_few_points_are_refused_with_the_number_needed():
    few = np.arange(0, 24, 2.0)
    values = {d: np.cos(few) for d in "XY"}
    with pytest.raises(BadInputError, match="18 points or more"):
        estimate_noise(LstCurve(few, values, np.full(12, 0.1), 2.0, is_centre_stated=True))
