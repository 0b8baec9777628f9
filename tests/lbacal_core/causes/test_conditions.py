from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from lbacal_core.causes.antenna import DipoleSwap


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


def test_of_three_dipoles_each_pair_of_letters_may_be_exchanged_and_the_third_keeps_its_sky(world):
    conditions = world.look().data.conditions
    sky = np.stack([np.full((1, 1), level) for level in (1.0, 2.0, 3.0)])
    three = replace(conditions, dipoles=["A", "B", "C"], cables=["80"] * 3, sky_of=dict(zip("ABC", sky, strict=True)))
    assert three.dipole_pairs == [("A", "B"), ("A", "C"), ("B", "C")]
    assert three.across(sky, ("A", "C"))[:, 0, 0].tolist() == [3.0, 2.0, 1.0]
    named = [template.parameters for template in DipoleSwap().templates(three)]
    assert named == [{"between": "A B"}, {"between": "A C"}, {"between": "B C"}]
    lonely = replace(three, dipoles=["B"], cables=["80"])
    assert lonely.dipole_pairs == [("A", "B"), ("B", "C")]
    assert lonely.across(sky[1:2], ("A", "B"))[:, 0, 0].tolist() == [1.0]


def test_one_dipole_has_no_letter_to_be_exchanged_with(world):
    conditions = world.look().data.conditions
    one = replace(conditions, dipoles=["A"], cables=["80"], sky_of={"A": np.ones((1, 1))})
    assert DipoleSwap().templates(one) == []
