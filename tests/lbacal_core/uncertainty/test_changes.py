from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.uncertainty.refit import list_changes

INSTRUMENT = load_instrument("lofar-superterp")


def test_the_papers_budget_holds_the_papers_terms():
    sizes = {change.name: float(np.mean(change.d_ln_p["X"])) for change in list_changes(INSTRUMENT, "paper")[:3]}
    assert sizes == pytest.approx({"scale of the sky maps": 0.2, "fit of the maps": 0.1, "choice of the map": 0.05})
    assert list_changes(INSTRUMENT, "paper")[-1].name == "antenna pattern"


@pytest.mark.parametrize("name", ["paper", "models", "measured"])
def test_every_change_is_finite_and_smaller_than_the_sky(name):
    for change in list_changes(INSTRUMENT, name):
        for values in change.d_ln_p.values():
            assert values.shape == (change.lst_hours.size, INSTRUMENT.frequency_mhz.size)
            assert np.max(np.abs(values)) < 0.5


def test_the_pattern_changes_the_power_along_lst_and_the_ground_is_largest_when_the_sky_is_cold():
    of_name = {change.name: change for change in list_changes(INSTRUMENT, "models")}
    assert np.ptp(of_name["antenna pattern"].d_ln_p["X"][:, 25]) > 0.01
    ground = of_name["ground and losses"].d_ln_p["X"][:, 25]
    assert 0.005 < ground.min() < 0.017 < ground.max() < 0.04


def test_where_no_model_reaches_the_channels_the_level_of_the_sky_is_left():
    high = replace(INSTRUMENT, frequency_mhz=INSTRUMENT.frequency_mhz + 400.0)
    (change,) = list_changes(high, "models")
    assert float(change.d_ln_p["X"][0, 0]) == pytest.approx(0.229, abs=0.001)


def test_beyond_the_default_sky_the_wide_skies_differ():
    """At 50-350 MHz the budget of the models was the level of the paper alone, as if no model reached."""
    channels = INSTRUMENT.frequency_mhz * 6.0 - 130.0
    wide = replace(INSTRUMENT, frequency_mhz=channels, antenna="quarter-wave", sky=None)
    changes = {change.name: change for change in list_changes(wide, "models")}
    shapes = [f"spectrum and LST shape ({name})" for name in ("haslam-wide", "lfsm-wide")]
    assert set(changes) == {"level of the sky", *shapes, "antenna pattern", "ground and losses"}
    rms = [float(np.sqrt(np.mean(np.square(changes[name].d_ln_p["X"])))) for name in shapes]
    assert 0.01 < min(rms) < max(rms) < 0.15
    assert len(list_changes(wide, "paper")) == 4


def test_an_unknown_budget_is_refused_with_the_known_ones():
    with pytest.raises(BadInputError, match="paper, models, measured"):
        list_changes(INSTRUMENT, "guess")
