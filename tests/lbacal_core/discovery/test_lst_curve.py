import json
from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.discovery.curve_search import describe_curve, investigate_curve
from lbacal_core.lstcurve.curve import AS_RECORDED, LstCurve, band_weights, measured_curve, read_lst_curve
from lbacal_core.provenance import Provenance
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.power import vary_sky_power

BAND = (30.0, 80.0)
LST = np.arange(48) / 2.0
RIPPLE = 0.3 * np.sin(2 * np.pi * 5 * LST / 24)
"""What no cause makes of a curve, dB."""


@pytest.fixture(scope="module")
def curve_of(chain, sky):
    """A curve of 48 points a dipole with 0.05 dB of noise."""

    def make(power=sky, noise_share=0.3, at=LST):
        rng = np.random.default_rng(0)
        weights = band_weights(chain, AS_RECORDED, BAND)
        variation = {}
        for dipole in "XY":
            band = power.at(dipole, at) @ weights
            band = band / band.mean()
            variation[dipole] = 10 * np.log10((1 - noise_share) * band + noise_share) + 0.05 * rng.standard_normal(48)
        return LstCurve(LST, variation, np.full(48, 0.1), 0.5, True, "simulated")

    return make


@pytest.fixture(scope="module")
def exchanged(sky):
    return replace(sky, power={"X": sky.power["Y"], "Y": sky.power["X"]})


def report_on(curve, simulation):
    return describe_curve(investigate_curve(curve, simulation, BAND), Provenance({}))


def with_ripple(curve):
    return replace(curve, variation_db={dipole: curve.variation_db[dipole] + RIPPLE for dipole in "XY"})


def names_of(finding):
    return {finding["cause"], *finding["indistinguishable"]}


def test_exchanged_letters_are_named_with_share_one(curve_of, exchanged, simulation):
    report = report_on(curve_of(exchanged), simulation)
    assert [finding["cause"] for finding in report["findings"]] == ["dipole_swap"]
    assert report["findings"][0]["size"]["value"] == 1.0
    assert report["verdict"] == "explained"


def test_noise_beyond_what_is_published_is_found_and_named_beside_an_isotropic_level(curve_of, simulation):
    report = report_on(curve_of(noise_share=0.7), simulation)
    (finding,) = report["findings"]
    assert names_of(finding) >= {"missing_noise", "isotropic_level"}
    share = finding["parameters"]["fraction_of_mean_sky_power"] + report["noise"]["of_mean_sky_power"]["prior"]["value"]
    relative = finding["size"]["sigma"] / finding["size"]["value"]
    assert abs(share / (0.7 / 0.3) - 1) < 4 * relative  # a share of 0.7 of the total is 0.7 / 0.3 of the sky


@pytest.mark.parametrize("noise_share", [0.0, 0.2, 0.3, 0.4])
def test_a_curve_of_the_simulation_with_noise_within_its_prior_is_consistent(noise_share, curve_of, simulation):
    report = report_on(curve_of(noise_share=noise_share), simulation)
    assert report["verdict"] == "consistent"
    assert report["findings"] == []
    assert report["noise"]["of_mean_sky_power"]["share"] == pytest.approx(noise_share, abs=0.05)


def test_noise_that_nobody_published_is_free_and_no_cause(chain, sky, curve_of):
    other = Simulation(replace(chain, name="another"), replace(sky, made_for=None))
    report = report_on(curve_of(noise_share=0.7), other)
    assert report["verdict"] == "consistent"
    assert report["noise"]["of_mean_sky_power"]["prior"] is None
    assert {"missing_noise", "isotropic_level"} <= {one["cause"] for one in report["unidentifiable"]}


def test_a_shift_in_sidereal_time_comes_out_in_hours(curve_of, simulation):
    (finding, *_) = report_on(curve_of(at=(LST + 0.5) % 24), simulation)["findings"]
    assert finding["cause"] == "lst_offset"
    assert abs(finding["size"]["value"] - 0.5) < 4 * finding["size"]["sigma"]


@pytest.mark.long
def test_a_pair_is_found_although_neither_fits_alone(curve_of, exchanged, simulation):
    report = report_on(curve_of(exchanged, noise_share=0.7), simulation)
    named = {finding["cause"]: names_of(finding) for finding in report["findings"]}
    assert "dipole_swap" in named
    assert any("missing_noise" in names for names in named.values())
    assert report["verdict"] == "explained"


def test_half_a_cosine_too_many_in_the_sky_integral_is_named_beside_a_wider_pattern(chain, curve_of):
    report = report_on(curve_of(), Simulation(chain, vary_sky_power(chain, zenith_exponent=0.5)))
    (finding,) = report["findings"]
    assert names_of(finding) == {"zenith_weighting", "pattern_width"}
    if finding["cause"] == "zenith_weighting":
        assert finding["size"]["value"] == pytest.approx(-0.5, abs=4 * finding["size"]["sigma"])


def test_a_whole_cosine_too_many_reads_as_one(chain, curve_of):
    """By the ratio own(-1)/own(0) it read as 0.77."""
    wrong = Simulation(chain, vary_sky_power(chain, zenith_exponent=1.0))
    (first, *_) = investigate_curve(curve_of(), wrong, BAND).single
    assert first.labels == ("zenith_weighting",)
    assert first.sizes[0] == pytest.approx(-1.0, abs=4 * first.sigmas[0])
    assert first.sigmas[0] < 0.05


def test_what_no_cause_describes_is_unexplained(curve_of, simulation):
    report = report_on(with_ripple(curve_of()), simulation)
    assert report["verdict"] == "unexplained"
    assert report["unexplained"]["where"]["axis"] == "lst"
    assert report["findings"] == []


def test_a_cause_beside_residual_structure_is_similar_to_it_and_no_finding(curve_of, exchanged, simulation):
    """A curve has one axis, along which both act: the structure might be what the cause is taken for."""
    report = report_on(with_ripple(curve_of(exchanged)), simulation)
    assert report["verdict"] == "unexplained"
    assert report["findings"] == []
    assert "dipole_swap" in [finding["cause"] for finding in report["unexplained"]["similar_to"]]
    assert "residual structure" in report["sentence"]


def test_the_same_curve_gives_the_same_report(curve_of, simulation):
    once, again = (report_on(curve_of(noise_share=0.2), simulation) for _ in range(2))
    assert json.dumps(once) == json.dumps(again)


@pytest.fixture(scope="module")
def found(chain, sky):
    return investigate_curve(read_lst_curve(measured_curve()), Simulation(chain, sky, is_own_sky=True), BAND)


@pytest.fixture(scope="module")
def report(found):
    return describe_curve(found, Provenance({}))


def test_the_measured_curve_says_that_the_letters_are_exchanged(report):
    (finding,) = report["findings"]
    assert finding["cause"] == "dipole_swap"
    assert finding["size"] == {"value": 1.0, "sigma": None, "unit": "share, 1 = exchanged"}
    assert "letters of the dipoles X and Y are exchanged" in finding["sentence"]
    assert "as published" in finding["sentence"]
    assert finding["gain"]["held_out_log_likelihood_gain"] > 0
    assert report["verdict"] == "explained"
    json.dumps(report, allow_nan=False)


def test_the_measured_curve_has_the_noise_that_is_published_and_chi2_is_that_of_the_point_noise(found, report):
    """A review's own least squares: letters exchanged and noise of 0.49 of the mean sky, nothing free: 96.1."""
    noise = report["noise"]["of_mean_sky_power"]
    assert noise["value"] == pytest.approx(0.42, abs=0.02)
    assert noise["prior"]["value"] == pytest.approx(0.46, abs=0.01)
    assert found.last.chi2 == pytest.approx(95.6, abs=0.5)
    assert found.first.chi2 == pytest.approx(261.5, abs=2.0)


def test_a_turn_by_a_right_angle_is_listed_because_it_exchanges_the_letters_too(report):
    assert "dipole_azimuth" in report["findings"][0]["indistinguishable"]
    turned = next(
        one for one in report["hypotheses"] if [c["parameters"].get("near") for c in one["causes"]] == ["90 deg"]
    )
    assert turned["standing"] == "not excluded"


def test_the_significance_is_the_one_after_the_look_elsewhere_correction(report):
    (finding,) = report["findings"]
    assert 5 < finding["significance_sigma"] < finding["evidence"]["score_sigma"]


def test_every_hypothesis_says_how_it_fits_what_it_does_to_c_and_what_would_decide(report):
    standings = [one["standing"] for one in report["hypotheses"]]
    assert standings[0] == "named"
    assert {"not excluded", "excluded"} <= set(standings)
    for one in report["hypotheses"]:
        assert set(one["chi2_per_point"]) == {"estimated", "drawn_bars"}
        assert all(cause["would_decide"] for cause in one["causes"])
        for dipole in "XY":
            assert {"30", "55", "80"} <= set(one["calibration_change"][dipole]["at_mhz"])


def test_an_exchange_of_letters_moves_c_by_percents(report):
    """A line a channel said +9 % and -13 % of the median; the chain's fit says less."""
    change = report["findings"][0]["calibration_change"]
    assert 0.005 < change["X"]["median_fraction"] < 0.04
    assert -0.08 < change["Y"]["median_fraction"] < -0.02
    assert change["max_fraction"] >= change["median_fraction"]


def test_nothing_without_an_exchange_of_letters_fits_as_well(found, chain, sky):
    curve = read_lst_curve(measured_curve())
    other = investigate_curve(curve, Simulation(chain, sky, is_own_sky=True), BAND, without="dipole_swap")
    assert "dipole_swap" not in {kind for choice in other.last.choices for kind in choice.kinds}
    assert other.last.chi2 > found.last.chi2 + 20


def test_chi2_per_point_is_quoted_with_the_estimated_noise_and_the_drawn_bars(report):
    before, after = report["chi2"]["per_point_before"], report["chi2"]["per_point_after"]
    assert before["drawn_bars"] > 6 * after["drawn_bars"]
    assert after["estimated"] < 1.3
    assert set(before) == {"estimated", "drawn_bars"}
