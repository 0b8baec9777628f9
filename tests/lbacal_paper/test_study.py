from __future__ import annotations

import numpy as np
import pytest

from lbacal_paper.study import Study


def test_the_array_fit_finds_what_was_planted(study: Study) -> None:
    for dipole in "XY":
        curve = study.mean_curve(dipole)
        assert curve.c is not None
        # 36 paths and 900 events: a tenth of a per cent, one station's sky gain in common
        assert np.median(np.abs(curve.c / study.campaign.truth.curve(dipole) - 1)) < 0.02


def test_exchanged_letters_fit_the_measured_curve_better(study: Study) -> None:
    chi2 = [sum(one.of(d, has_noise=True).chi2 for d in "XY") for one in (study.comparison, study.exchanged)]
    assert chi2[1] < chi2[0] / 3


def test_the_published_curve_is_that_of_the_shipped_table(study: Study) -> None:
    assert study.published_c()[0] == pytest.approx(1.37321452e-05)
