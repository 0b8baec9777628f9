from __future__ import annotations

import json

import pytest

from lbacal_core.discovery.curve_search import describe_curve, investigate_curve
from lbacal_core.lstcurve.curve import measured_curve, read_lst_curve
from lbacal_core.provenance import Provenance


@pytest.fixture(scope="module")
def found(chain, sky):
    return investigate_curve(read_lst_curve(measured_curve()), sky, chain, (30.0, 80.0), is_own_sky=True)


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


def test_chi2_per_point_is_quoted_with_the_estimated_noise_and_the_drawn_bars(report):
    before, after = report["chi2"]["per_point_before"], report["chi2"]["per_point_after"]
    assert before["drawn_bars"] > 6 * after["drawn_bars"]
    assert after["estimated"] < 1.3
    assert set(before) == {"estimated", "drawn_bars"}


def test_the_sentence_says_the_cause_its_size_and_the_gain(report):
    for words in ("dipole_swap", "electronic noise", "chi^2 per point falls from", "drawn bars"):
        assert words in report["sentence"]


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
    other = investigate_curve(curve, sky, chain, (30.0, 80.0), is_own_sky=True, without="dipole_swap")
    assert "dipole_swap" not in {kind for choice in other.last.choices for kind in choice.kinds}
    assert other.last.chi2 > found.last.chi2 + 20


def test_sizes_at_the_end_of_their_range_are_marked(report):
    marked = [cause for one in report["hypotheses"] for cause in one["causes"] if cause["is_at_edge_of_its_range"]]
    assert marked
    assert all(cause["cause"] not in {"dipole_swap", "lst_offset"} for cause in marked)
