from __future__ import annotations

import json

from lbacal_core.audit.verdict import WRONG, Line


def test_a_line_becomes_json_with_null_for_what_is_not_known() -> None:
    line = Line("clock", WRONG, "CS002", "late", value=1.23456, sigma=0.0512, unit="h")
    assert json.loads(json.dumps(line.as_dict())) == {
        "check": "clock",
        "verdict": "wrong",
        "station": "CS002",
        "antennas": [],
        "dipole": None,
        "log_odds": None,
        "value": 1.235,
        "sigma": 0.051,
        "unit": "h",
        "candidates": [],
        "sentence": "late",
    }
