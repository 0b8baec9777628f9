from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.drift.model import median_of_members, median_over


def test_the_median_is_that_of_the_known_values() -> None:
    rng = np.random.default_rng(1)
    values = rng.standard_normal((7, 40, 3)).astype(np.float32)
    values[rng.uniform(size=(7, 40)) < 0.2] = np.nan
    assert median_over(values, axis=0) == pytest.approx(np.nanmedian(values, axis=0), nan_ok=True)
    assert median_over(values, axis=1) == pytest.approx(np.nanmedian(values, axis=1), nan_ok=True)


def test_two_known_series_have_no_median() -> None:
    values = np.ones((5, 2, 3), dtype=np.float32)
    values[:3, 0] = np.nan
    assert np.isnan(median_of_members(values)[:, 0]).tolist() == [True, False]
