from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_twin.faults.composed import COURSES, GATES, LAWS, PLACES, Composed, draw_composed


def test_a_change_is_its_law_times_its_courses_at_its_place(plant) -> None:
    fault = Composed(size=0.1, place="receiver", law=("level", ()), courses=(("frost", (8.0,)), ("weekend", ())))
    seen = plant(fault)
    weekend = (seen.time_unix // 86_400 + 3) % 7 >= 5
    acts = weekend & (seen.temperature_c < 8.0)
    assert 10 < acts.sum() < 290
    strong = seen.effect[0, 0, :, 28]  # at the resonance almost nothing is noise of the converter
    assert np.all(strong[~acts] == 0.0)
    np.testing.assert_allclose(strong[acts], 0.1, atol=0.01)


@pytest.mark.parametrize("place", PLACES)
def test_every_place_changes_the_power(plant, place: str) -> None:
    effect = plant(Composed(size=0.1, place=place, law=("level", ()), courses=(("light", ()),))).effect
    assert effect.max() > 1e-3
    assert effect.max() < 0.11
    assert effect.min() == 0.0


def test_drawn_effects_differ_and_cover_all_forms() -> None:
    drawn = [draw_composed(np.random.default_rng(seed), 0.1) for seed in range(200)]
    assert {one.place for one in drawn} == set(PLACES)
    assert {one.law[0] for one in drawn} == set(LAWS)
    assert {course for one in drawn for course, _ in one.courses} == set(COURSES)
    double = [one for one in drawn if len(one.courses) == 2]
    assert 40 < len(double) < 95
    assert all(one.courses[1][0] in GATES and one.courses[0][0] != one.courses[1][0] for one in double)
    assert len({repr(replace(one, size=0.0)) for one in drawn}) > 190  # forms without numbers meet
