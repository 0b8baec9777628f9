from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.traces.density import density_per_square, transform_blocks
from lbacal_core.traces.selection import find_keyed_blocks, select_background
from lbacal_core.traces.trace import Trace
from lbacal_twin.voltages import Shower, Transmitter

MakeTrace = Callable[..., Trace]


def test_noise_loses_no_block(make_trace: MakeTrace) -> None:
    selection = select_background(make_trace(1))
    assert np.all(selection.is_background)
    assert selection.dropped == {}


def test_a_pulse_takes_five_blocks_on_either_side(make_trace: MakeTrace) -> None:
    trace = make_trace(2, disturbances=[Shower(sample=200 * 1024 + 500, peak=400.0)])
    selection = select_background(trace)
    assert selection.dropped == {"pulse": 11}
    assert np.flatnonzero(~selection.is_background).tolist() == list(range(195, 206))
    assert selection.pulses == (trace.position[200],)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_spike_above_or_below_the_noise_is_a_pulse(make_trace: MakeTrace, sign: int) -> None:
    trace = make_trace(2)
    samples = trace.samples.copy()
    samples[200, 500] = sign * 400
    selection = select_background(replace(trace, samples=samples))
    assert selection.pulses == (trace.position[200],)
    assert selection.dropped == {"pulse": 11}


def test_a_known_pulse_is_left_out_even_when_it_cannot_be_seen(make_trace: MakeTrace) -> None:
    trace = make_trace(3)
    instant = trace.reference.time_unix + (50 * 1024 + 500) / 200e6
    selection = select_background(trace, instant)
    assert np.flatnonzero(~selection.is_background).tolist() == list(range(45, 56))


def test_saturated_damaged_and_burst_blocks_are_dropped_for_their_own_reason(make_trace: MakeTrace) -> None:
    trace = make_trace(4)
    samples = trace.samples.copy()
    samples[30] *= 3
    samples[60, 17] = 2047
    samples[90, 3] = -2048
    is_intact = np.ones(len(samples), dtype=bool)
    is_intact[120] = False
    selection = select_background(replace(trace, samples=samples, is_intact=is_intact))
    assert selection.dropped["damaged"] == 1
    assert selection.dropped["saturated"] == 2
    # The lone extreme samples are pulses too, and so, being three times the noise, is the burst.
    assert not np.any(selection.is_background[[30, 60, 90, 120]])
    assert np.sum(selection.is_background) >= 400 - 4 - 3 * 10


def test_a_weak_burst_without_a_peak_is_a_burst(make_trace: MakeTrace) -> None:
    trace = make_trace(5)
    samples = trace.samples.copy()
    samples[30] = np.rint(samples[30] * 1.4)
    selection = select_background(replace(trace, samples=samples))
    assert selection.dropped == {"burst": 3}  # with the blocks in which it begins and ends


@pytest.mark.parametrize(("duty", "is_keyed"), [(0.2, True), (1.0, False), (0.9, False)])
def test_only_a_transmitter_that_is_mostly_silent_costs_blocks(
    make_trace: MakeTrace, duty: float, is_keyed: bool
) -> None:
    line = Transmitter(45.0, mean_square=60.0, duty=duty, period_s=4e-4)
    trace = make_trace(6, disturbances=[line])
    strength = np.zeros(513)
    strength[round(45.0 * 1024 / 200)] = 10.0
    to_density = density_per_square(1024, 200e6)
    found = find_keyed_blocks(transform_blocks(trace.samples), strength, np.full(513, 4.0), to_density)
    on = (np.arange(400) * 1024 / 200e6 / 4e-4) % 1.0 < duty
    if is_keyed:
        assert np.all(found[on])
        assert found.mean() < 0.3
    else:
        assert not np.any(found)
