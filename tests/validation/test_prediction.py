"""A small instance of `./dev prove prediction`."""

from __future__ import annotations

import numpy as np
import pytest

from validation.machinery.records import verdicts_of
from validation.prediction import draw_station, judge_events, predict_events

pytestmark = pytest.mark.long


def test_events_that_were_not_fitted_are_predicted_with_chi2_of_1_per_channel() -> None:
    row = predict_events(5)
    assert row["events"] >= 6000
    # 1.8 % by 6400 events, each channel, and as much by the noise that was measured in as many
    np.testing.assert_allclose(row["chi2"], 1.0, atol=0.1)
    assert row["whole"] == pytest.approx(1.0, abs=0.05)  # and as they move together
    rows = [row, {**row, "chi2": [one + 0.002 for one in row["chi2"]]}]
    assert judge_events(rows)[0].n == 2 * row["events"]
    loud = [
        {**one, "chi2": [*one["chi2"][1:], 1.3], "whole": one["whole"] + 0.1 + 1e-3 * k} for k, one in enumerate(rows)
    ]
    assert verdicts_of("prediction", "events", loud) == {"chi2": "refuted", "whole": "refuted"}


def test_events_drawn_together_move_the_mean_of_a_station_as_held_out_events_do() -> None:
    row = draw_station(6)
    assert row["common"] == pytest.approx(0.36, abs=0.1)  # 3 % of 5 % are the station's
    assert row["together"] == pytest.approx(1.0, abs=0.25)  # 7 % by 400 events, and as much in what is common
    assert row["apart"] > 2.0
    assert row["pair"] == pytest.approx(row["of_pair"], abs=4e-4)  # 0.03^2, and 1.5e-4 by 400 events
    bad = [{**row, "together": 2.0 + 1e-3 * k} for k in range(3)]
    assert verdicts_of("prediction", "together", bad)["together"] == "refuted"
