"""Events that are added to those of a year, against the year read whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.drift.events import EventModes, add_events, measure_event_modes
from lbacal_core.spectra.blocks import SpectraBlock
from tests.lbacal_core.drift.test_monthly import make_case

LAST = np.array([11, 57])
"""Numbers of the events that came later: one between others."""


def pick(block: SpectraBlock, events: np.ndarray) -> SpectraBlock:
    """Some events of a block."""
    return replace(
        block, power=block.power[:, events], is_present=block.is_present[:, events], blocks=block.blocks[:, events],
        time_unix=block.time_unix[events], event_id=block.event_id[events],
    )  # fmt: skip


@pytest.fixture
def case():
    block, curve, *rest = make_case(
        np.random.default_rng(3).normal(1.0, 0.05, 58), np.random.default_rng(2), noise=0.04
    )
    return block, {7: curve}, *rest


@pytest.fixture
def kept(case) -> EventModes:
    block, *others = case
    return measure_event_modes(pick(block, np.setdiff1d(np.arange(58), LAST)), *others)


def test_a_year_with_two_events_more_is_the_whole_year(case, kept) -> None:
    block, *others = case
    whole, found = measure_event_modes(block, *others), add_events(kept, pick(block, LAST), *others)
    assert np.array_equal(found.antennas, whole.antennas)
    assert np.array_equal(found.time_unix, whole.time_unix)
    np.testing.assert_allclose(found.ln_c, whole.ln_c, rtol=1e-12)


@pytest.mark.parametrize("factor", [2.0, 0.5])
def test_a_spectrum_that_may_be_left_out_is_left_to_the_whole_year(case, kept, factor) -> None:
    block, *others = case
    odd = pick(block, LAST)
    odd.power[:, 1] *= factor
    assert add_events(kept, odd, *others) is None


def test_a_channel_with_three_times_its_power_is_left_to_the_whole_year(case, kept) -> None:
    block, *others = case
    odd = pick(block, LAST)
    odd.power[0, 1, 2] *= 3.0
    assert add_events(kept, odd, *others) is None


def test_a_path_that_becomes_known_well_enough_to_be_screened_is_left_to_the_whole_year(case) -> None:
    block, *others = case
    few = measure_event_modes(pick(block, np.arange(19)), *others)
    assert add_events(few, pick(block, LAST), *others) is None


def test_an_antenna_without_events_before_is_left_to_the_whole_year(case, kept) -> None:
    block, *others = case
    assert add_events(replace(kept, antennas=kept.antennas + 1), pick(block, LAST), *others) is None
