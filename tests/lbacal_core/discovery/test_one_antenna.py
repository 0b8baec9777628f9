from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.causes.cable import AntennaTemplate
from lbacal_core.discovery.antennas import Comparison, smooth_departures, typical_amounts

CHANNELS = 40
PLACE = np.linspace(0.0, 1.0, CHANNELS)
COSINES = np.cos(np.pi * np.outer([1, 2, 3], PLACE))


@pytest.fixture
def rng():
    return np.random.default_rng(20261123)


def draw(rng, amounts, count=200, error=1e-3):
    """Antennas that depart along three cosines by normal amounts, beside a gain that is flat and the noise of a fit."""
    root = error * np.diag(1.0 + PLACE)
    found = []
    for _ in range(count):
        smooth = rng.normal(size=(2, 3)) * amounts @ COSINES
        departure = rng.normal(size=(2, 1)) + smooth + rng.normal(size=(2, CHANNELS)) @ root
        found.append(Comparison(root, departure, np.empty((0, CHANNELS)), np.empty(0)))
    return found


def test_typical_amounts_are_the_scatter_of_the_antennas(rng):
    amounts = np.array([0.1, 0.03, 0.01])
    # 400 values: the median is known to 6 %.
    assert typical_amounts(draw(rng, amounts), COSINES) == pytest.approx(amounts, rel=0.25)
    far = draw(rng, np.zeros(3), count=1)[0]
    far = Comparison(far.root, far.departure + 10 * COSINES[0], far.smooth, far.typical)
    assert typical_amounts([*draw(rng, amounts), far], COSINES) == pytest.approx(amounts, rel=0.25)


def test_antennas_that_are_alike_have_no_typical_departures(rng):
    alike = draw(rng, np.zeros(3), count=10)
    smooth = smooth_departures(alike, np.array(["80"] * 10), 30.0 + 50 * PLACE)
    assert (len(smooth), len(typical_amounts(alike, smooth))) == (0, 0)


@pytest.mark.parametrize("typical", [np.array([0.1, 0.03, 0.01]), np.array([0.05, np.inf, 1e-6])])
def test_beside_departures_of_typical_amounts_a_template_is_weighed_by_their_covariance(rng, typical):
    """As by hand: noise of the fit, a flat gain without limit, and each departure with its variance."""
    one = draw(rng, np.array([0.1, 0.03, 0.01]), count=1)[0]
    template = AntennaTemplate({}, np.sqrt(0.3 + PLACE))
    beside = one.beside(COSINES, typical)
    variance = np.where(np.isinf(typical), 10.0, typical) ** 2
    covariance = one.root @ one.root.T + (COSINES.T * variance) @ COSINES + 100.0 * np.ones((CHANNELS, CHANNELS))
    weighed = np.linalg.solve(covariance, template.departure)
    expected = one.departure @ weighed / np.sqrt(template.departure @ weighed)
    assert beside.amplitudes([template])[:, 0] == pytest.approx(expected, rel=1e-3)
    before, after = beside.chi_squared(template, 0.0)
    assert before == after == pytest.approx(one.departure[0] @ np.linalg.solve(covariance, one.departure[0]), rel=1e-3)
