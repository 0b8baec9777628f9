"""The ladder of hidden effects: one, two, and one that nobody catalogued.

The same code as `./dev prove discovery`, which measures the rates; here one data set of each rung.
"""

from __future__ import annotations

import numpy as np
import pytest

from validation.hidden.data_sets import DataSet, realistic
from validation.hidden.held_out import gains_of, hide_in_halves
from validation.hidden.no_catalogue import FIRST_SEED, hide_unknown
from validation.hidden.one_effect import hide_one
from validation.hidden.several_effects import hide_several


def test_nothing_is_found_where_nothing_is_hidden():
    answer = realistic(7).ask()
    assert (answer.verdict, answer.named) == ("consistent", [])


def test_a_strong_drift_is_detected_named_and_measured():
    outcome = hide_one(3, 12.0, "gain_drift")
    assert outcome.is_detected
    assert outcome.is_named
    # The score of 12 ideal standard deviations scatters by one; a tenth of it may be lost.
    assert outcome.score > 7.5
    assert outcome.pull is None or abs(outcome.pull) < 4


@pytest.mark.long
def test_two_effects_at_once_come_out_one_after_the_other():
    row = hide_several(1, 2)
    assert row["are_all_named"], row


@pytest.mark.parametrize("axes", ["temperature", pytest.param("frequency, lst", marks=pytest.mark.long)])
def test_effects_of_no_catalogue_are_called_unexplained_along_their_axes_and_get_no_name(axes):
    """Gain over temperature squared; a band that saturates, first taken for a line."""
    row = hide_unknown(DataSet(FIRST_SEED + 1), axes)
    assert (row["verdict"], row["is_right_axis"], row["named"]) == ("unexplained", True, []), row


@pytest.mark.long
def test_bursts_of_lightning_and_of_jupiter_are_called_unexplained_and_get_no_name():
    """The noise that events share took them in: "consistent", or broad-band interference."""
    for axes in ("event, frequency", "frequency, lst, date"):
        row = hide_unknown(DataSet(FIRST_SEED + 1), axes)
        assert (row["verdict"], row["named"]) == ("unexplained", []), row


@pytest.mark.long
def test_what_was_found_in_half_the_events_is_gone_from_the_other_half():
    row = hide_in_halves(4)
    # SNR 10 raises chi^2 by 100 +- 20; what the error of one fitted size leaves is a few.
    assert 40 < row["before"] < 160
    assert row["after"] < 0.3 * row["before"]
    assert np.isfinite(gains_of([row])[-1])
