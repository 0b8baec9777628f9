from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.drift.follow import follow
from lbacal_core.drift.report import describe_followed
from validation.drift_world import DAY, START, YEAR, World, draw_history

MHZ = np.arange(30.0, 81.0)


def test_a_report_tells_changes_slopes_and_the_trend_in_frequency() -> None:
    world = World(years=3.0, stations=3, antennas=4, events_per_year=400, yearly=0.01)
    history = draw_history(replace(world, trend=0.05), np.random.default_rng(1))
    after = np.flatnonzero(history.time_unix >= START + 1.5 * YEAR)
    history.ln_c[5, after, 0] += np.log(1.08)
    history.ln_c[..., 1] += (0.01 * (history.time_unix - START) / YEAR).astype(np.float32)
    report = describe_followed(history, follow(history), MHZ)
    json.dumps(report, allow_nan=False)
    (change,) = report["changes"]
    assert [(m["antenna"], m["dipole"]) for m in change["members"]] == [(2, "Y")]
    assert change["size"] == pytest.approx(0.08, abs=4 * change["sigma"])
    assert abs(change["date_unix"] - START - 1.5 * YEAR) < 5 * DAY
    assert len(report["slopes"]) == 24 + 6
    assert not any(one["is_found"] for one in report["slopes"])
    assert set(report["trends"]) == {"array", "CS002", "CS003", "CS004"}
    whole = report["trends"]["array"]
    assert whole["slope"] == pytest.approx(0.05, abs=whole["limit_95"])
    # a tilt of 0.01 a year: half of what lies between the lowest and the highest channel
    ends = np.array(whole["frequency"]["slope"])[[0, -1]]
    assert np.diff(ends) / 2 == pytest.approx([0.01], abs=0.001)
