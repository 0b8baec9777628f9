from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.discovery.refit import average_size, open_noise
from lbacal_twin.faults.antenna import GainStep
from lbacal_twin.faults.fault import Where
from tests.lbacal_core.discovery.worlds import CALM
from validation.anywhere import STEP, investigate_drawn

FAULT = GainStep(size=0.02, date="2014-07-01", where=Where(antennas=(1,)))


@pytest.fixture(scope="module")
def fitted(world):
    """A gain step where the published chain tells noise in front of the receiver from that behind it."""
    look = world.with_settings(**CALM).look(FAULT)
    (score,) = look.scan(["gain_step"], ["antenna 1"])
    return look.fit("gain_step", score.template, "antenna 1").model


def test_a_size_whose_noise_is_told_apart_is_that_of_the_fit(fitted):
    assert average_size(fitted, 0) is None


def _with_open_noise(model, share):
    """The same fitted model, whose noise in front of the receiver is known to a share of itself."""
    solution, everyone = model.baseline.solution, np.ones(len(model.station.antenna), dtype=bool)
    constants, covariance = model.baseline.noise_of(everyone)
    wider = solution.covariance * (share * constants[0]) ** 2 / covariance[0, 0]
    return replace(model, baseline=replace(model.baseline, solution=replace(solution, covariance=wider)))


def test_the_error_of_a_size_contains_how_noise_may_be_shared(fitted):
    """A step seen at 130 sigma says itself how noise is shared: the size stays, its error is no smaller."""
    own = fitted.hypotheses[0]
    found = average_size(_with_open_noise(fitted, 0.9), 0)
    assert own.sigma <= found.sigma < 0.1 * FAULT.size
    assert abs(found.size - FAULT.size) < 3 * found.sigma


def test_no_drawn_noise_is_negative_and_what_is_hardly_known_has_its_order_of_magnitude(fitted):
    model = _with_open_noise(fitted, 1.0)
    noise = open_noise(model, model.hypotheses[0])
    drawn = noise.draw(np.random.default_rng(1).normal(size=(4000, 3)))
    front = np.array([n[0] for n, _ in drawn])
    assert all(np.all(n >= 0) and np.all(q >= 0) for n, q in drawn)
    # |N(0, s)| with s^2 = 2 middle^2: a fifth lies below 0.253 s
    assert np.quantile(front, 0.2) == pytest.approx(0.253 * np.sqrt(2) * noise.front[0], rel=0.1)


@pytest.mark.long
@pytest.mark.parametrize("seed", [41, 65])
def test_a_step_is_not_four_errors_low_where_noise_is_hardly_told_apart(seed):
    """Of 0.1 were found 0.034 +- 0.006, because the noise in front of the receiver was taken for ten times too much."""
    row = investigate_drawn(seed)
    assert row["named"]
    assert abs(row["pulls"][0]) < 3.0, (STEP, row["said"])


@pytest.mark.long
def test_a_step_is_no_moving_resonance_where_noise_is_hardly_told_apart():
    """Causes were compared at one share of the noise, at which the step lost 53 of chi^2, and a resonance 12."""
    row = investigate_drawn(125)
    assert (row["named"], row["others"]) == (True, 0), row["said"]


@pytest.mark.long
def test_a_step_that_is_not_significant_at_the_fitted_noise_is_still_a_rival():
    """A step of ideal SNR 8 scored 4.5 at the fitted share of the noise, and a resonance was named that fits worse."""
    row = investigate_drawn(501)
    assert (row["named"], row["others"]) == (True, 0), row["said"]
