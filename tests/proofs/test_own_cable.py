"""A small instance of `./dev prove own_cable`."""

from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.instrument import load_instrument
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.twin.settings import TwinSettings
from proofs.own_cable import SCOPES, Told, coverage, judge, tell_paths

CAMPAIGNS = 6
STATIONS = ("CS002", "CS003", "CS004", "CS005")


@pytest.fixture(scope="module")
def told() -> list[Told]:
    instrument = load_instrument("lofar-superterp")
    sky_power = compute_sky_power(instrument, lst_hours=np.arange(24.0))
    settings = TwinSettings(stations=STATIONS, antennas=16, events_per_year=200)
    return [
        one
        for k in range(CAMPAIGNS)
        for one in tell_paths(settings, instrument, sky_power, seed=k, silent=STATIONS[k % len(STATIONS)])
    ]


@pytest.mark.parametrize("by", SCOPES[:3])
def test_the_truth_of_every_path_lies_within_the_error_that_it_is_told(told: list[Told], by: str) -> None:
    of_scope = [one for one in told if one.by == by]
    assert {cable for one in of_scope for cable in one.cables} == {"50", "80", "115"}
    # the errors of a campaign have much in common: 6 campaigns know a rate to 0.02-0.03
    assert coverage(of_scope, 1.0)[0] == pytest.approx(0.68, abs=0.12)
    assert coverage(of_scope, 2.0)[0] == pytest.approx(0.95, abs=0.06)


def test_no_cable_is_told_another_ones_curve(told: list[Told]) -> None:
    # without the path's own cable these medians are +0.36 to +0.57 (50 m) and -0.25 to -0.42 (115 m)
    for by in ("station", "array"):
        for cable in ("50", "80", "115"):
            errors = [one.fraction[np.array(one.cables) == cable] for one in told if one.by == by]
            assert abs(float(np.median(np.concatenate(errors)))) < 0.03


def test_the_array_tells_its_spread_and_a_silent_station_more_with_a_flag(told: list[Told]) -> None:
    own, near, far = ([one for one in told if one.by == by] for by in (SCOPES[1], SCOPES[2], SCOPES[3]))
    sizes = [np.median(np.concatenate([one.sigma for one in group])) for group in (own, near, far)]
    assert sizes[0] < sizes[1] < sizes[2]
    assert {flag for one in near for flag in one.flags} == {"ok"}
    assert {flag for one in far for flag in one.flags} == {"uncertain"}
    assert coverage(far, 2.0)[0] > 0.8


def test_the_judgement_fails_when_errors_are_too_small(told: list[Told]) -> None:
    _, lines = judge(told)
    assert len(lines) == 2 + 4 * 4
    boasting = [Told(one.by, one.cables, 3.0 * one.pull, one.fraction, one.sigma / 3, one.flags) for one in told]
    assert not judge(boasting)[0]
