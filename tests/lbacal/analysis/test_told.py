"""What an investigation tells in words and in its table, from the values of its report."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from lbacal.analysis.investigate import Investigation, _make

LATE: dict[str, Any] = {
    "cause": "lst_offset", "where": {"station": "CS002"}, "size": {"value": 0.30123, "sigma": 0.0123, "unit": "h"},
    "significance_sigma": 24.56, "sentence": "The clock of CS002 is off.", "gain": {"chi2_before": 1900.0, "dof": 4},
    "indistinguishable": [], "evidence": {"is_converged": False, "sentences": ["the sky moves"]},
}  # fmt: skip
SEEN: dict[str, Any] = {
    "cause": "recorded_gap", "where": {"station": None}, "size": {"value": 12.0, "sigma": None, "unit": "events"},
    "significance_sigma": 7.0, "sentence": "Events are missing.", "gain": {"words": "none"}, "indistinguishable": [],
    "evidence": {},
}  # fmt: skip
LEFT = {
    "description": "structure along utc", "p_value": 0.0004, "in_words": "more by night", "would_decide": "one night",
    "similar_to": [{"sentence": "a timer"}],
}  # fmt: skip
REPORT: dict[str, Any] = {
    "verdict": "unexplained", "findings": [LATE, SEEN], "unexplained": LEFT,
    "adopted": [
        {"cause": "gain_step", "target": "antenna 3", "station": "CS002", "size": {"value": 0.05, "sigma": 0.01}},
    ],
    "provenance": {"notes": {"sky": "gsm"}},
}  # fmt: skip


def investigation() -> Investigation:
    simulation: Any = SimpleNamespace()
    return _make("S.h5", REPORT, simulation, str, list, lambda _: [])


def test_a_size_has_its_error_and_its_unit_and_no_error_where_none_is_known() -> None:
    found = investigation()
    assert found.title == "S.h5: unexplained"
    assert found.rows == [
        ("cause", "station", "size", "sigma", "what is wrong"),
        ("lst_offset", "CS002", "0.301 ± 0.012 h", "24.6", "The clock of CS002 is off."),
        ("recorded_gap", "", "12 events", "7.0", "Events are missing."),
    ]
    assert [one.title for one in found.findings] == ["lst_offset 0.301 ± 0.012 h", "recorded_gap 12 events"]
    assert [one.rows[1:] for one in found.findings] == [[("chi2_before", "1900"), ("dof", "4")], []]
    assert found.table["size"].tolist() == [0.30123, 12.0]
    np.testing.assert_array_equal(found.table["size_sigma"], [0.0123, np.nan])


def test_an_investigation_tells_what_was_adopted_what_was_found_and_what_is_left() -> None:
    assert investigation().told == [
        "  adopted: gain_step in antenna 3 of CS002, here 0.05 ± 0.01",
        "  24.6 sigma: The clock of CS002 is off.",
        "    caution: the fit of all causes together has not converged",
        "    nearly as likely: the sky moves",
        "  7.0 sigma: Events are missing.",
        "  structure along utc (p = 4.0e-04)",
        "    in words: more by night",
        "    what would decide: one night",
        "    similar to: a timer",
        "sky: gsm",
    ]
