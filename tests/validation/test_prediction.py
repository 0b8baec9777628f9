"""A small instance of `./dev prove prediction`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from validation.machinery.records import verdicts_of
from validation.prediction import draw_station, judge_events, predict_events, stand_one_trace_for_all

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


@pytest.mark.shared
def test_measured_over_predicted_power_is_what_the_page_says(shared: Path, tmp_path: Path, repository: Path) -> None:
    """The ratio has no limit: it is what it is, and the page says so."""
    for command in (
        ["lbacal", "spectra", str(shared / "data/tbb"), "--output", str(tmp_path / "S.h5")],
        ["validation.scripts.compare_prediction", str(tmp_path / "S.h5")],
    ):
        ran = subprocess.run(
            [sys.executable, "-m", *command], capture_output=True, text=True, check=True, cwd=repository
        )
    sys.stdout.write(ran.stdout)
    rows = [line.split() for line in ran.stdout.splitlines()[1:]]
    median = {(row[1], row[4]): row[5] for row in rows}
    page = " ".join((repository / "docs/how-to/predict.md").read_text().split())
    x, y, old = (median[path] for path in (("CS011", "X"), ("CS011", "Y"), ("CS001", "Y")))
    assert (
        f"in the median over 30-80 MHz {x} and {y} in X and Y of CS011 in 2011, {old} in a trace of CS001 of 2008"
        in page
    )
    assert len(rows) == 5


def test_one_trace_for_all_hours_loses_the_galaxy_by_hour() -> None:
    row = stand_one_trace_for_all(8)
    assert row["predicted"] < 0.3  # 0.05 dB by gains of 5 % in 17 events an hour; the worst of 24 hours
    assert row["one_trace"] > 0.5
