from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from lbacal_core.antenna.hamaker import load_hamaker
from lbacal_core.antenna.model import directional_response, zenith_gain

FREQUENCY_MHZ = np.array([30.0, 55.0, 80.0])


def test_the_response_is_symmetric_about_the_arm() -> None:
    azimuth = np.linspace(0, np.pi / 2, 7)
    zenith = np.full(7, 0.9)
    response = directional_response(load_hamaker(), FREQUENCY_MHZ, zenith, azimuth)
    for mirrored in (-azimuth, np.pi - azimuth, np.pi + azimuth):
        assert directional_response(load_hamaker(), FREQUENCY_MHZ, zenith, mirrored) == pytest.approx(response)


def test_a_dipole_sees_low_directions_better_across_its_arm_than_along_it() -> None:
    low = np.full(2, np.radians(60.0))
    response = directional_response(load_hamaker(), FREQUENCY_MHZ, low, np.array([0.0, np.pi / 2]))
    assert np.all(response[:, 1] > 1.5 * response[:, 0])


def test_the_response_is_one_at_zenith_and_nothing_below_the_horizon() -> None:
    zenith, azimuth = np.array([0.0, 1.7, 3.0]), np.array([np.pi / 4, 0.0, 0.0])
    response = directional_response(load_hamaker(), FREQUENCY_MHZ, zenith, azimuth)
    assert response[:, 0] == pytest.approx(1.0, abs=3e-3)  # theta and phi parts of the fit differ by 0.2 %
    assert np.all(response[:, 1:] == 0)


def test_the_element_beam_has_no_resonance() -> None:
    assert zenith_gain(load_hamaker(), np.arange(30.0, 81.0)) == pytest.approx(1.0, abs=0.02)


def test_both_dipoles_agree_with_everybeam() -> None:
    content = json.loads((Path(__file__).parent / "everybeam_values.json").read_text())
    antenna = load_hamaker()
    assert len(content["rows"]) == 20
    for nu, zenith, angle, *values in content["rows"]:
        matrix = (np.array(values[::2]) + 1j * np.array(values[1::2])).reshape(2, 2)
        for row, arm in zip(matrix, (0.0, np.pi / 2), strict=True):
            ours = antenna.jones(np.array([nu]), np.array(zenith), np.array(angle - arm))
            # Rounding of double precision: the same polynomials.
            assert np.array(ours)[:, 0] == pytest.approx(row, abs=1e-13)
