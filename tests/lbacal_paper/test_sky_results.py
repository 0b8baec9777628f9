from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.sky.names import load_sky
from lbacal_paper.sky_results import find_about_sky, find_skies, isotropic_temperature, mean_temperature

FREQUENCY = np.arange(30.0, 81.0)


def test_the_choice_of_the_sky_cannot_be_tested_without_lfmap_and_the_models_at_hand_are_told() -> None:
    sky = load_sky("gsm")
    found = find_about_sky([sky, sky.changed(scale=1.1)], FREQUENCY)["sky-models"]
    assert found.ours is None
    assert "needs LFmap" in found.how
    assert "+10.0 %" in found.how  # the map holds the CMB, which is scaled with it
    assert find_about_sky([sky], FREQUENCY)["sky-models"].ours is None


def test_the_isotropic_share_is_that_of_the_formula_in_the_paper() -> None:
    sky = load_sky("gsm")
    share = 100 * isotropic_temperature(FREQUENCY) / mean_temperature(sky, FREQUENCY)
    assert isotropic_temperature(np.array([150.0])) == pytest.approx(50.0)
    assert find_about_sky([sky], FREQUENCY)["isotropic-share"].ours == pytest.approx(share.max())


def test_the_default_sky_comes_first() -> None:
    skies = find_skies(None)
    assert skies[0].name == load_sky("gsm").name
    assert len(skies) >= 2
