from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lbacal.tables import mean_curve, write_nuradio
from lbacal_core.errors import BadInputError


def test_the_one_curve_of_an_array_is_that_of_the_mean_recorded_power(calibrations: dict[str, Any]) -> None:
    text = write_nuradio(mean_curve(calibrations)).decode().splitlines()
    values = np.array([float(line) for line in text if not line.startswith("#")])
    assert values.size == 101
    c = np.array([curve["c"][:50] for curve in calibrations["curves"]])
    # recorded power of the same sky goes with C^-2
    np.testing.assert_allclose(values[30:80] ** -2, np.mean(c**-2.0, axis=0), rtol=1e-12)
    assert np.all(values[:30] == 0)
    assert np.all(values[80:] == 0)
    assert "mean recorded power of 4 curves" in text[0]
    assert "nobody's cable" in text[1]


def test_a_mean_of_other_channels_is_refused(calibrations: dict[str, Any]) -> None:
    calibrations["curves"][1]["frequency_mhz"] = list(range(31, 82))
    with pytest.raises(BadInputError, match="the same channels"):
        mean_curve(calibrations)
