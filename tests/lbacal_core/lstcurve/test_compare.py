from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.data.tables import read_table
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import Instrument, load_instrument
from lbacal_core.lstcurve.curve import (
    AS_RECORDED,
    BAND_MHZ,
    FLAT,
    LstCurve,
    band_weights,
    compare_lst_curve,
    in_db,
    noise_prior,
    published_noise_share,
    simulate_band_power,
)
from lbacal_core.skypower.table import SkyPower

BAND = (30.0, 80.0)
LST = np.arange(48) * 0.5 + 0.25
SHARES = {"X": 0.2, "Y": 0.45}


@pytest.fixture
def noiseless(lst_instrument: Instrument, lst_sky: SkyPower) -> LstCurve:
    """What an instrument with these noise shares would record."""
    weights = band_weights(lst_instrument, AS_RECORDED, BAND)
    variation = {d: in_db(simulate_band_power(lst_sky, d, LST, weights), SHARES[d]) - 0.7 for d in "XY"}
    return LstCurve(LST, variation, np.full(48, 0.11), 0.5, is_centre_stated=True)


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


def test_the_published_terms_make_a_third_to_a_half_of_the_band_noise():
    """Fig. 5: the sky dominates at 40-65 MHz, where the weight is, and the LNA alone has 0.35-0.5 of the sky."""
    share = published_noise_share(BAND)
    assert share is not None
    assert 0.3 < share < 0.5


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
