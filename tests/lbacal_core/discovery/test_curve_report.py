from __future__ import annotations

import json

import pytest

from lbacal_core.discovery.curve_report import describe_curve
from lbacal_core.discovery.lst_curve import best_without, investigate_curve
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
    assert finding["gain"]["held_out_log_likelihood_gain"] > 0
    assert report["verdict"] == "explained"
    json.dumps(report, allow_nan=False)


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
    assert before["drawn_bars"] > 4 * after["drawn_bars"]
    assert after["estimated"] < 1.3
    assert set(before) == {"estimated", "drawn_bars"}


def test_the_sentence_says_the_cause_its_size_and_the_gain(report):
    for words in ("dipole_swap", "+-", "Chi^2 per point falls from", "drawn bars"):
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


def test_an_exchange_of_letters_raises_c_of_one_dipole_and_lowers_that_of_the_other(report):
    change = report["findings"][0]["calibration_change"]
    assert change["X"]["median_fraction"] > 0.05
    assert change["Y"]["median_fraction"] < -0.05
    assert change["max_fraction"] >= change["median_fraction"]


def test_noise_alone_leaves_c_as_it_is_where_the_fit_has_noise_terms(report):
    noise = next(
        one for one in report["hypotheses"] if [cause["cause"] for cause in one["causes"]] == ["missing_noise"]
    )
    assert abs(noise["calibration_change"]["X"]["median_fraction"]) < 1e-9


def test_nothing_without_an_exchange_of_letters_fits_as_well(found):
    rival = best_without(found, "dipole_swap", most=2)
    assert rival.chi2 > found.last.chi2 + 20


def test_sizes_at_the_end_of_their_range_are_marked(report):
    marked = [cause for one in report["hypotheses"] for cause in one["causes"] if cause["is_at_edge_of_its_range"]]
    assert marked
    assert all(cause["cause"] not in {"dipole_swap", "lst_offset"} for cause in marked)
