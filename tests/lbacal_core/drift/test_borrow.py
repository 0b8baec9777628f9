from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.drift.windows import borrow_curve
from tests.lbacal_core.drift.test_monthly import CABLE, make_case


def test_a_borrowed_curve_is_the_neighbours_through_its_own_cable_times_the_gain_of_its_events() -> None:
    """The power gain rose to 1.21, and of that the cables explain what they do."""
    block, curve, instrument, sky = make_case(np.full(30, 1.21), np.random.default_rng(1), noise=0.01)
    with_cables = replace(instrument, cables={"c": CABLE, "old": CABLE})
    found = borrow_curve(curve, block, with_cables, sky, ("old", "c"))
    assert found is not None
    assert curve.c is not None
    assert found.curve.c is not None
    assert found.gain == pytest.approx(1.0 / 1.1, abs=4 * found.sigma)
    assert found.curve.c / curve.c == pytest.approx(found.gain)
    assert (found.curve.status, found.curve.events) == ("converged", 30)
    neighbours_error = 0.01
    assert found.curve.c_sigma_stat is not None
    assert found.curve.c_sigma_stat / found.curve.c == pytest.approx(np.hypot(neighbours_error, found.sigma))

    shorter = replace(instrument, cables={"c": CABLE * 1.21, "old": CABLE})
    explained = borrow_curve(curve, block, shorter, sky, ("old", "c"))
    assert explained is not None
    assert explained.gain == pytest.approx(1.0, abs=4 * explained.sigma)
    assert explained.curve.c == pytest.approx(found.curve.c)


def test_too_few_events_borrow_nothing() -> None:
    block, curve, instrument, sky = make_case(np.ones(4), np.random.default_rng(1), noise=0.01)
    assert borrow_curve(curve, block, instrument, sky, ("c", "c")) is None
