from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.drift.model import SeriesModel
from tests.lbacal_core.drift.test_search import NOISE, _draw


def test_the_noise_of_events_does_not_contain_the_season() -> None:
    """With the season in it the noise was a fifth too large, and steps of 0.4 % were missed."""
    model = SeriesModel(_draw(np.random.default_rng(1)), None, 0.05)
    model.fit()
    model.fit()
    # the median of 24 paths takes 1/24 pi/2 of the variance with it
    assert np.median(model.scale[0]) == pytest.approx(NOISE, rel=0.04)


def test_the_model_of_some_series_is_that_of_all() -> None:
    series = _draw(np.random.default_rng(2), series=6)
    one, other = SeriesModel(series, None, 0.05), SeriesModel(series, None, 0.05)
    one.fit()
    other.fit()
    other.fit_terms(np.array([1, 4]))
    assert other.model == pytest.approx(one.model)
    assert other.result.theta == pytest.approx(one.result.theta)
    assert one.scores(np.array([1, 4]))[0] == pytest.approx(one.scores(one.all)[0][[1, 4]])
