from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.calibration.chain_test import SkyFreedom
from lbacal_core.calibration.lines import SKY_HARMONICS, PathLines, fit_lines, harmonics_at, move_lines, move_lines_by
from lbacal_core.calibration.singles import chain_forms


def test_the_freedom_of_the_sky_moves_the_lines_as_a_fit_with_shared_noise_does(scene):
    """The covariance of an event was a gain that is flat in frequency; now it has a few vectors."""
    rng = np.random.default_rng(6)
    lst = rng.uniform(0.0, 24.0, 500)
    sky = scene.sky_power.at("X", lst)
    forms = chain_forms(scene.instrument)
    front = 1 + 0.05 * rng.standard_normal((1, 500, 1)) * forms.antenna_slope / np.max(np.abs(forms.antenna_slope))
    clean = scene.mean_power(sky) * (1 + 0.03 * rng.standard_normal((1, 500, 1))) * front
    power = clean * rng.gamma(0.045**-2, 0.045**2, clean.shape)
    variance = rng.uniform(0.5, 2.0, power.shape[:2])
    lines = fit_lines(power, sky, variance, forms)
    assert np.count_nonzero(np.any(lines.levels.vectors[0] != 0, axis=1)) >= 2
    change = 0.01 * np.linspace(-1.0, 1.0, sky.shape[1])[None] * np.cos(2 * np.pi * (np.arange(48)[:, None] - 9) / 48)
    series = SkyFreedom({"X": change[None]}, "").series("X")
    basis = harmonics_at(lst, SKY_HARMONICS)
    path = PathLines.of(power[0], sky, variance[0], lines.select(np.array([0])))
    moved = move_lines(path, basis, series)[0]
    added = lines.slope[:, None] * sky * (basis @ series[0])
    up, down = (fit_lines(power + sign * added, sky, variance, forms) for sign in (1.0, -1.0))
    refitted = np.concatenate([up.slope - down.slope, up.intercept - down.intercept], axis=1)[0] / 2.0
    scale = np.repeat([np.max(np.abs(half)) for half in np.split(refitted, 2)], sky.shape[1])
    # weights follow the lines that are fitted first, which the change moves too
    assert moved / scale == pytest.approx(refitted / scale, abs=0.05)
    by_event = move_lines_by(path, (added / lines.power(sky))[:1])[0]
    assert by_event / scale == pytest.approx(moved / scale, abs=1e-9)
