from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.errors import BadInputError
from lbacal_core.sky.names import load_sky

NU = np.array([30.0, 60.0, 80.0])


def mean(sky: object) -> np.ndarray:
    return sky.temperature(NU)[:, 0, 0].real / np.sqrt(4 * np.pi)  # type: ignore[attr-defined]


def test_scale_and_spectral_index_change_the_maps_and_not_the_cmb() -> None:
    sky = load_sky("gsm")
    changed = mean(sky.changed(scale=1.2, spectral_index=0.1)) - 2.725
    assert changed == pytest.approx((mean(sky) - 2.725) * 1.2 * (NU / 60.0) ** -0.1, rel=1e-4)


def test_isotropic_brightness_is_added_in_units_of_the_extragalactic_level() -> None:
    sky = load_sky("gsm")
    added = mean(sky.changed(extra_isotropic=0.5)) - mean(sky)
    assert added == pytest.approx(25.0 * (150.0 / NU) ** 2.75)


def test_a_changed_model_has_another_digest_and_says_what_changed() -> None:
    sky = load_sky("gsm")
    changed = sky.changed(scale=1.1)
    assert changed.digest() != sky.digest()
    assert changed.name == "gsm(scale=1.1)"
    assert sky.changed().digest() == sky.digest()


def test_a_negative_scale_is_refused() -> None:
    with pytest.raises(BadInputError, match="scale: expected a factor > 0"):
        load_sky("gsm").changed(scale=-1.0)
