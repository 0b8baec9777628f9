"""What a page says and draws of a finding, from the values of its report."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lbacal.pages.chart import Chart
from lbacal.pages.finding import draw_finding, draw_scores, draw_sentence, draw_station, tell_finding
from lbacal.pages.report import draw_investigation

MHZ = [30.0, 55.0, 80.0]
COURSE = {"label": "date", "at": [1.0, 2.0], "observed": [0.01, None], "sigma": [0.002, 0.004], "expected": [0.0, 0.02]}
LAW = {"frequency_mhz": MHZ, "observed": [0.01, 0.02, 0.03], "sigma": [0.001] * 3, "expected": [0.01, 0.01, 0.02]}
MAP = {"label": "LST (h)", "from": 0.0, "to": 24.0, "frequency_mhz": [30.0, 80.0], "before": [[0.03, -0.04]]}
CHANGE = {"low": [-0.02] * 3, "median": [0.01] * 3, "high": [0.04] * 3}
PICTURE = {"course": COURSE, "law": LAW, "maps": [{**MAP, "after": [[0.01, 0.01]]}], "change_of_c": CHANGE}
FINDING: dict[str, Any] = {
    "cause": "gain_step", "size": {"value": -0.19, "sigma": 0.011, "unit": "fraction"}, "significance_sigma": 12.34,
    "gain": {"chi2_before": 1300.0, "chi2_after": 1000.0, "held_out_log_likelihood_gain": 55.5, "held_out_events": 300},
    "indistinguishable": ["filter_shift", "gain_drift"], "left_open": [{"cause": "gain_step", "weight": 1.0},
    {"cause": "adc_noise_step", "weight": 0.052}],
    "calibration_change": {"median_fraction": 0.05, "max_fraction": 0.111},
    "evidence": {
        "target": "antenna 3", "confirm": "look at the log", "note": "by night",
        "rivals": [{"cause": "sentence", "target": "antenna 3", "odds": 0.031}], "is_converged": False,
        "correlations": {"filter_shift": 0.987},
        "picture": PICTURE,
    },
}  # fmt: skip


def values_of(chart: Chart, part: str = "y") -> list[list[float | None]]:
    """Values of every series of a chart, to a thousandth."""
    found = [np.atleast_1d(np.asarray(getattr(one, part), dtype=float)) for one in chart.series]
    return [[None if np.isnan(x) else round(float(x), 3) for x in one] for one in found]


def test_a_finding_is_told_by_its_numbers() -> None:
    assert dict(tell_finding(FINDING)) == {
        "size": "-0.19 ± 0.011 fraction",
        "significance": "12.3 sigma after the look-elsewhere correction",
        "caution": "the fit of all causes together has not converged",
        "chi²": "1300 without it, 1000 with it (300 gained)",
        "gain on unseen events": "ln L +55.5 on 300 events, in four folds",
        "these data cannot tell it from": "filter_shift (r = 0.99), gain_drift, adc_noise_step (0.052 : 1 beside it)",
        "rivals, with their odds to it": "sentence (antenna 3) 0.03 : 1",
        "C of its paths changes": "by 5.00 % in the median, 11.10 % at most, against a fit of the window without it",
        "C behind the date": "+11.11 % against C before it; one C for the window lies between",
        "note": "by night",
        "how to confirm it": "look at the log",
    }


def test_what_a_finding_does_not_have_is_not_told() -> None:
    bare = {
        **FINDING, "cause": "dipole_swap", "size": {"value": 1.0, "sigma": None, "unit": ""}, "left_open": [],
        "gain": {**FINDING["gain"], "held_out_log_likelihood_gain": None}, "indistinguishable": [],
        "evidence": {"confirm": "x"},
        "calibration_change": {"median_fraction": 0.0, "max_fraction": 0.0},
    }  # fmt: skip
    told = dict(tell_finding(bare))
    assert list(told) == ["size", "significance", "chi²", "these data cannot tell it from", "how to confirm it"]
    assert (told["size"], told["these data cannot tell it from"]) == ("1 ", "nothing else in the catalogue")
    assert draw_finding(bare) == {}
    assert draw_sentence({}) == {}


def test_a_finding_is_drawn_in_per_cent_with_its_errors() -> None:
    charts = draw_finding(FINDING)
    assert list(charts) == ["course", "law", "before 0", "after 0", "change"]
    assert charts["course"].title == "gain_step along date"
    assert values_of(charts["course"]) == [[1.0, None], [0.0, 2.0]]
    assert [values_of(charts["course"], part)[0] for part in ("low", "high")] == [[0.8, None], [1.2, None]]
    assert charts["course"].series[0].titles == ["1 : 1 %", "2 : nan %"]
    assert values_of(charts["law"]) == [[1.0, 2.0, 3.0], [1.0, 1.0, 2.0]]
    assert charts["law"].series[0].titles[1] == "55 : 2 %"
    assert charts["before 0"].title == "residuals of antenna 3 before: 3.54 % rms"
    assert charts["after 0"].title == "residuals of antenna 3 after: 1.00 % rms"
    assert charts["after 0"].series[0].limit == pytest.approx(3.97)
    assert charts["before 0"].y_limits == (0.0, 24.0)
    band, line = charts["change"].series
    assert (list(band.low), list(band.high), list(line.y)) == ([-2.0] * 3, [4.0] * 3, [1.0] * 3)
    assert line.titles[0] == "30 MHz: 1 %"
    same = {**PICTURE, "maps": [{**MAP, "after": MAP["before"]}]}
    alone = draw_finding({**FINDING, "evidence": {**FINDING["evidence"], "picture": same}})
    assert alone["before 0"].title == "residuals of antenna 3: 3.54 % rms"
    assert "after 0" not in alone
    assert list(draw_sentence({"picture": PICTURE})) == ["course", "law"]
    assert list(draw_finding({**FINDING, "evidence": {"picture": {"course": COURSE}}})) == ["course"]


def test_an_error_of_the_record_is_drawn_against_the_record() -> None:
    against = {
        "frequency_mhz": MHZ, "observed": [0.01, 0.0, 0.02], "sigma": [0.002] * 3, "label": "over the 80 m cable",
        "fine_mhz": [30.0, 80.0], "fine": [0.0, 0.03],
    }  # fmt: skip
    chart = draw_finding({**FINDING, "evidence": {"picture": {"against": against}}})["against"]
    assert values_of(chart) == [[1.0, 0.0, 2.0], [0.0, 3.0]]
    assert [values_of(chart, part)[0] for part in ("low", "high")] == [[0.8, -0.2, 1.8], [1.2, 0.2, 2.2]]
    assert chart.series[0].titles[2] == "80 MHz: 2 %"


def test_structure_without_a_cause_is_drawn_with_its_amounts_and_the_scores_beside() -> None:
    amounts = {"in": "antenna 1 X", "paths": [[1, "X", 1.0, 0.1], [2, "X", 0.5, 0.2], [1, "Y", -0.3, 0.1]]}
    structure = {"course": COURSE, "spectrum": {"frequency_mhz": MHZ, "rms_1": [1.0, -1.0, 1.0]}, "amounts": amounts}
    scores = [
        {"cause": f"cause_{k}", "target": "all", "score_sigma": (-1) ** k * float(k), "p_value": 0.5**k}
        for k in range(14)
    ]
    charts = draw_station({"picture": {"structure": structure, "maps": []}}, scores)
    assert list(charts) == ["structure", "spectrum", "amounts", "scores"]
    assert values_of(charts["spectrum"]) == [[1.0, -1.0, 1.0]]
    assert [one.name for one in charts["amounts"].series] == ["X", "Y"]
    assert values_of(charts["amounts"], "low") == [[0.9, 0.3], [-0.4]]
    assert values_of(charts["amounts"], "high") == [[1.1, 0.7], [-0.2]]
    assert charts["amounts"].y_label == "amount, of that in antenna 1 X"
    ranking = draw_scores(scores)
    assert list(ranking.series[0].x) == [float(k) for k in range(13, 1, -1)]
    assert ranking.series[0].titles[0] == "cause_13, all: -13.0 sigma, p = 0.00012"
    assert ranking.rows[-1] == "cause_2, all"
    assert draw_station({}) == {}


def test_the_page_of_an_investigation_holds_its_report() -> None:
    sentence = {
        "odds_to_first": 0.2, "equation": "P -> P (1 + a)", "size": {"value": -0.2, "sigma": 0.01}, "picture": PICTURE,
        "gain": {"held_out_log_likelihood_gain": 44.0},
    }  # fmt: skip
    left = {
        "description": "structure along date", "p_value": 1e-9, "similar_to": [{**FINDING, "sentence": "Alike."}],
        "in_words": "Power changes.", "sentences": [sentence, sentence], "would_decide": "Another year.",
    }  # fmt: skip
    station = {
        "station": "CS002", "paths": 12, "events": 400, "dates": ["2014-01-02T03", "2014-12-30T01"], "findings": [0],
        "unexplained": left, "picture": {"maps": []},
    }  # fmt: skip
    content = {
        "verdict": "explained", "stations": [station], "findings": [{**FINDING, "sentence": "The gain stepped."}],
        "scores": {"CS002": [{"cause": "gain_step", "target": "all", "score_sigma": 5.0, "p_value": 1e-6}]},
        "unidentifiable": [{"cause": "lst_offset", "why": "one hour alone"}],
        "provenance": {"inputs": {"spectra": "abcd"}, "model_version": 7, "notes": {"audit": "nothing wrong"}},
    }  # fmt: skip
    page = draw_investigation(content)
    assert page.count("<svg ") == len(draw_finding(FINDING)) * 2 + len(draw_sentence(sentence)) + 1
    for words in (
        "wrong in spectra: explained", "Station CS002: 12 paths, 400 events, 2014-01-02 to 2014-12-30",
        "The gain stepped.",
        "structure along date (p = 1.0e-09)", "It resembles gain_step, which does not describe it", "Power changes.",
        "likeliest", "0.2 : 1 to the first", "a = -0.2 ± 0.01; 44 gained", "Another year.", "one hour alone",
        "sha256 of spectra", "abcd", "nothing wrong",
    ):  # fmt: skip
        assert words in page, words
    assert "wrong in S.h5:" in draw_investigation(content, [("file", "S.h5")])
