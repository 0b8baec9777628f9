from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from service.usecases.gate import drop_noise, name_members, tell_change, tell_shapes

BAND = np.array([10.0, 50.0, 90.0])
TILT = "a tilt (+5.00 ± 1.05 % at 90 MHz, -4.76 % at 10 MHz)"
CURVATURE = "a curvature (-2.00 ± 0.49 % at 10 and 90 MHz, +1.02 % halfway)"
SLIGHT = "a curvature (-1.00 ± 0.50 % at 10 and 90 MHz, +0.50 % halfway)"


def make_change(mean: float, tilt: float, curvature: float) -> dict[str, Any]:
    shape = {"tilt": {"value": tilt, "sigma": 0.01}, "curvature": {"value": curvature, "sigma": 0.005}}
    return {"size": mean, "sigma": 0.01, "shape": shape}


@pytest.mark.parametrize(
    ("mean", "tilt", "curvature", "told"),
    [
        (-0.05, 0.001, 0.001, "-5.00 ± 1.00 %"),
        (-0.05, math.log(1.05), 0.0, f"-5.00 ± 1.00 % in the mean over the band and by {TILT}"),
        (0.001, 0.001, math.log(0.98), f"{CURVATURE} and by +0.10 ± 1.00 % in the mean over the band"),
        (-0.15, math.log(1.045), 0.0, "-15.00 ± 1.00 %"),
        (0.015, 0.0, math.log(0.99), f"{SLIGHT} and by +1.50 ± 1.00 % in the mean over the band"),
    ],
)
def test_the_part_of_a_change_that_carries_it_is_told(mean: float, tilt: float, curvature: float, told: str) -> None:
    change = make_change(mean, tilt, curvature)
    sentence = tell_change(mean, 0.01, change["shape"], BAND)
    assert sentence == told


def test_a_table_has_the_mean_in_a_column_and_names_the_shapes_beside_it() -> None:
    assert tell_shapes(make_change(-0.05, 0.001, 0.001), BAND) == ""
    assert tell_shapes(make_change(-0.05, math.log(1.05), math.log(0.98)), BAND) == f"{TILT} and {CURVATURE}"


def test_who_changed_is_named_up_to_a_number() -> None:
    members = [{"antenna": 3, "dipole": "X"}, {"antenna": None, "dipole": "Y"}, {"antenna": 4, "dipole": "X"}]
    assert name_members(members, 3) == "antenna 3 X, all Y, antenna 4 X"
    assert name_members(members, 1) == "antenna 3 X and 2 more"


def test_noise_beside_a_step_was_told_as_a_step_and_cut_the_windows_of_a_sound_antenna() -> None:
    """Among three antennas a step of 51 sigma made another one step by 0.17 ± 0.14 %."""
    members = [{"antenna": a, "dipole": "Y", "significance": sigma} for a, sigma in ((1, 51.4), (2, 2.5), (0, 4.1))]
    for is_known, kept in ((False, [1, 0]), (True, [1, 2, 0])):
        report = {"threshold_sigma": 3.9, "changes": [{"is_known": is_known, "members": list(members)}]}
        assert [one["antenna"] for one in drop_noise(report)["changes"][0]["members"]] == kept
