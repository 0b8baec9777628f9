from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest


def seconds(date):
    return datetime.fromisoformat(date).replace(tzinfo=UTC).timestamp()


@pytest.mark.parametrize(
    ("phase_deg", "warmest"),
    [(0.0, "2014-01-01"), (90.0, "2014-04-02"), (180.0, "2014-07-02"), (270.0, "2014-10-01")],
)
def test_a_season_is_highest_when_its_phase_says(phase_deg, warmest, world):
    conditions = world.look().data.conditions
    days = seconds("2014-01-01") + 86_400.0 * np.arange(-90, 275)
    season = replace(conditions, time_unix=days).season(phase_deg)[:, 0]
    highest = days[np.argmax(season)]
    assert abs(highest - seconds(warmest)) < 3 * 86_400.0
    assert season.max() == pytest.approx(1.0, abs=1e-3)
    assert season.min() == pytest.approx(-1.0, abs=1e-3)
