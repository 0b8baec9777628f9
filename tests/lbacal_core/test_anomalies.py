from __future__ import annotations

import json

from lbacal_core.curves.anomalies import MOST_NAMED, NONE, Anomalies, Anomaly, parse_anomalies

HUGE = Anomaly("e1", "CS003", 5, "X", 947.0)
DEAD = Anomaly("e2", "CS003", 6, "Y", 1e-4, 45.0)
KEPT = Anomaly("e3", "CS003", 5, "X", 1.7, kept="it lasts for 12 events")


def test_a_summary_counts_and_names_the_worst_first() -> None:
    found = Anomalies.of([KEPT, HUGE, DEAD])
    assert (found.left_out, found.fitted) == (2, 1)
    assert found.worst == (DEAD, HUGE, KEPT)
    assert found.name_worst(2) == (
        "e2 of CS003/6/Y (power 0.0001 times the usual at 45 MHz), e1 of CS003/5/X (power 947 times the usual)"
    )
    assert KEPT.reason == "power 1.7 times the usual; fitted: it lasts for 12 events"


def test_a_summary_survives_json_and_names_a_limited_number() -> None:
    many = Anomalies.of([HUGE] * (MOST_NAMED + 7))
    assert (many.left_out, len(many.worst)) == (MOST_NAMED + 7, MOST_NAMED)
    for summary in (many, Anomalies.of([KEPT, DEAD]), NONE):
        assert parse_anomalies(json.loads(json.dumps(summary.as_dict(), allow_nan=False))) == summary
