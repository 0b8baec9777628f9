from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.causes.axes import AXES, axis_named, list_axes


@pytest.fixture(scope="module")
def conditions(world):
    return world.look().data.conditions


def left_of(wave, basis):
    """Share of the mean square of a wave that functions of an axis and a constant do not describe."""
    columns = np.vstack([np.ones_like(wave), basis]).T
    rest = wave - columns @ np.linalg.lstsq(columns, wave, rcond=None)[0]
    return np.mean(rest**2) / np.var(wave)


def test_a_drift_whose_ends_differ_is_a_smooth_function_of_the_date(conditions):
    """Waves of whole periods alone would bend it back at both ends, and leave 6 % of it."""
    date = axis_named("date")
    days = date.values(conditions)
    assert left_of(days, date.basis(conditions)) < 1e-3


def test_structure_of_five_weeks_is_a_smooth_function_of_the_date_and_of_a_fortnight_is_not(conditions):
    date = axis_named("date")
    days = date.values(conditions)
    # Maxima 73 days apart: five weeks up and five weeks down.
    assert left_of(np.cos(2 * np.pi * days / 73.0), date.basis(conditions)) < 0.01
    assert left_of(np.cos(2 * np.pi * days / 28.0), date.basis(conditions)) > 0.5


@pytest.mark.parametrize(("name", "period_h"), [("lst", 24.0), ("utc", 24.0)])
def test_a_day_has_five_harmonics_and_no_more(name, period_h, conditions):
    axis = axis_named(name)
    hours, basis = axis.values(conditions), axis.basis(conditions)
    assert left_of(np.cos(2 * np.pi * 5 * hours / period_h + 1.0), basis) < 1e-6
    assert left_of(np.cos(2 * np.pi * 7 * hours / period_h + 1.0), basis) > 0.5


def test_every_column_of_env_that_varies_is_an_axis_by_its_name(conditions):
    events = conditions.time_unix.size
    wave = np.cos(np.arange(events) / 7.0)
    scarce = np.where(np.arange(events) < 20, wave, np.nan)
    columns = {"humidity": wave, "dead_clock": np.full(events, 3.0), "scarce": scarce, "lst": wave}
    names = [axis.name for axis in list_axes(conditions.with_covariates(**columns))]
    assert names == [*(axis.name for axis in AXES), "humidity", "env/lst"]
    humidity = list_axes(conditions.with_covariates(humidity=wave))[-1]
    assert left_of(wave**2, humidity.basis(conditions.with_covariates(humidity=wave))) < 0.01
