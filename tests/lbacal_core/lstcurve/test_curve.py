from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lbacal_core.data.tables import read_table
from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.instrument.instrument import Instrument, load_instrument
from lbacal_core.lstcurve.curve import (
    AS_RECORDED,
    BAND_MHZ,
    FLAT,
    LstCurve,
    band_weights,
    compare_lst_curve,
    estimate_noise,
    estimate_point_noise,
    in_db,
    measured_curve,
    noise_prior,
    published_noise_share,
    read_lst_curve,
    simulate_band_power,
)
from lbacal_core.sky.table import SkyPower

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
    apart = estimate_noise(curve_with(0.05 * np.random.default_rng(4).standard_normal((2, 240))))
    assert abs(apart.correlation) < 0.2  # 0.066 one sigma


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


BAND = (30.0, 80.0)
HALF_HOURS = np.arange(48) * 0.5 + 0.25
SHARES = {"X": 0.2, "Y": 0.45}


@pytest.fixture
def noiseless(lst_instrument: Instrument, lst_sky: SkyPower) -> LstCurve:
    """What an instrument with these noise shares would record."""
    weights = band_weights(lst_instrument, AS_RECORDED, BAND)
    variation = {d: in_db(simulate_band_power(lst_sky, d, HALF_HOURS, weights), SHARES[d]) - 0.7 for d in "XY"}
    return LstCurve(HALF_HOURS, variation, np.full(48, 0.11), 0.5, is_centre_stated=True)


@pytest.fixture(scope="module")
def lst_instrument() -> Instrument:
    frequency = np.arange(30.0, 81.0)
    return Instrument(
        "plain", 52.9, 6.87, 49.0, frequency, {"X": 45.0, "Y": 135.0},
        1.0 / (1.0 + ((frequency - 58.0) / 5.0) ** 2), np.ones(51), {"80": np.full(51, 0.3)}, (),
    )  # fmt: skip


@pytest.fixture(scope="module")
def lst_sky(lst_instrument: Instrument) -> SkyPower:
    lst = np.arange(96) * 0.25
    shape = {"X": 1 + 0.3 * np.cos((lst - 19) * np.pi / 12), "Y": 1 + 0.25 * np.cos((lst - 17.5) * np.pi / 12)}
    steeper = (lst_instrument.frequency_mhz[None, :] / 55.0) ** (-0.5 - 0.1 * np.cos(lst * np.pi / 12))[:, None]
    return SkyPower(lst_instrument.frequency_mhz, lst, {d: shape[d][:, None] * steeper for d in "XY"})


def test_noise_share_and_offset_are_recovered_exactly(noiseless, lst_sky, lst_instrument):
    comparison = compare_lst_curve(noiseless, lst_sky, lst_instrument)
    for dipole, share in SHARES.items():
        fit = comparison.of(dipole, has_noise=True)
        assert fit.noise_share == pytest.approx(share, abs=1e-5)  # tolerance of the scalar minimiser
        assert fit.offset_db == pytest.approx(-0.7, abs=1e-4)
        assert fit.chi2 < 1e-6
        assert comparison.of(dipole, has_noise=False).chi2 / fit.points > 1


def test_the_stated_error_of_the_share_is_its_scatter(noiseless, lst_sky, lst_instrument):
    rng = np.random.default_rng(1)
    shares = []
    for _ in range(300):
        noisy = {d: noiseless.variation_db[d] + rng.normal(scale=0.11, size=48) for d in "XY"}
        comparison = compare_lst_curve(replace(noiseless, variation_db=noisy), lst_sky, lst_instrument)
        shares.append(comparison.of("X", has_noise=True).noise_share)
    fit = compare_lst_curve(noiseless, lst_sky, lst_instrument).of("X", has_noise=True)
    assert np.std(shares) == pytest.approx(fit.noise_share_sigma, rel=0.12)  # 300 draws: 4 % one sigma
    assert np.mean(shares) == pytest.approx(0.2, abs=3 * np.std(shares) / 300**0.5 + 1e-3)


def test_the_share_stays_between_nothing_and_everything(noiseless, lst_sky, lst_instrument):
    for stretch, bound in ((3.0, 0.0), (-1.0, 1.0)):
        stretched = {d: stretch * noiseless.variation_db[d] for d in "XY"}
        comparison = compare_lst_curve(replace(noiseless, variation_db=stretched), lst_sky, lst_instrument)
        assert comparison.of("X", has_noise=True).noise_share == bound


def test_points_that_are_absent_change_nothing(noiseless, lst_sky, lst_instrument):
    variation = {d: noiseless.variation_db[d].copy() for d in "XY"}
    variation["X"][5:9] = np.nan
    fit = compare_lst_curve(replace(noiseless, variation_db=variation), lst_sky, lst_instrument).of("X", has_noise=True)
    assert fit.points == 44
    assert fit.noise_share == pytest.approx(0.2, abs=1e-5)
    assert np.isnan(fit.residual_db[5:9]).all()


def test_weights_follow_c_and_the_antenna_and_stay_inside_the_band(lst_instrument):
    lst_instrument = replace(lst_instrument, name="lofar-superterp")
    c = read_table("published_calibration")["c"]
    weights = band_weights(lst_instrument, AS_RECORDED, (40.0, 60.0))
    assert weights.sum() == pytest.approx(1.0)
    assert np.flatnonzero(weights).tolist() == list(range(10, 31))
    ratio = lst_instrument.antenna_gain[20] / c[20] ** 2 / (lst_instrument.antenna_gain[15] / c[15] ** 2)
    assert weights[20] / weights[15] == pytest.approx(ratio)
    np.testing.assert_allclose(band_weights(lst_instrument, FLAT, BAND), 1 / 51)


@pytest.mark.parametrize("band", [(60.0, 40.0), (10.0, 20.0), (55.0, 55.0)])
def test_a_band_without_channels_is_refused(lst_instrument, band):
    with pytest.raises(BadInputError, match="band"):
        band_weights(lst_instrument, AS_RECORDED, band)


def test_the_band_of_another_instrument_was_weighed_with_lofars_calibration_and_ended_at_80_mhz():
    lofar = load_instrument("lofar-superterp")
    nu = np.arange(60.0, 190.0, 10.0)
    other = replace(
        lofar, name="elsewhere", frequency_mhz=nu, antenna_gain=nu / 60.0, receiver_gain=np.full(nu.size, 2.0),
        cables={name: np.full(nu.size, 0.5) for name in lofar.cables}, gain_provenance=None,
    )  # fmt: skip
    weights = band_weights(other, AS_RECORDED, (100.0, 150.0))
    inside = (nu >= 100.0) & (nu <= 150.0)
    np.testing.assert_allclose(weights, np.where(inside, nu, 0.0) / nu[inside].sum())
    with pytest.raises(
        BadInputError, match=r"expected LO below HI and channels of elsewhere \(60 to 180 MHz\) between"
    ):
        band_weights(other, AS_RECORDED, (30.0, 50.0))


@pytest.fixture(scope="module")
def weights(chain):
    return band_weights(chain, AS_RECORDED, BAND_MHZ)


def test_the_published_noise_is_smaller_against_a_sky_without_the_cosine(chain, weights):
    """The paper's ratio is 0.66 of a sky that its integral makes 0.70 times too dark."""
    prior = noise_prior(chain, BAND_MHZ, weights)
    share = published_noise_share(BAND_MHZ)
    # Fig. 5: the sky dominates at 40-65 MHz, where the weight is, and the LNA alone has 0.35-0.5 of the sky.
    assert 0.3 < share < 0.5
    assert share / (1 - share) == pytest.approx(0.66, abs=0.01)
    assert prior.mean == pytest.approx(0.696 * share / (1 - share), rel=1e-3)
    # Without the cosine the ratio is 1.1 standard deviations larger: its existence is an inference.
    assert prior.mean / 0.696 - prior.mean == pytest.approx(1.15 * prior.sigma, rel=0.05)


def test_the_stages_have_the_spectra_of_the_chain(chain, weights):
    lna, receiver, adc = noise_prior(chain, BAND_MHZ, weights).stages
    assert np.ptp(lna / weights) < 1e-12 * lna[0] / weights[0]
    assert np.ptp(receiver / chain.receiver_gain) < 1e-9 * receiver[0] / chain.receiver_gain[0]
    assert np.ptp(adc) == 0.0


def test_nothing_is_known_of_another_instrument_or_band(chain, weights):
    assert not noise_prior(replace(chain, name="another"), BAND_MHZ, weights).is_known
    assert not noise_prior(chain, (20.0, 25.0), weights).is_known
