"""What the benchmark compares has the same minimum; the speeds themselves are no test."""

from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.spectra.blocks import split_into_blocks
from validation.benchmarks.fit import OnePath, farthest, make_scene, make_spectra
from validation.fit import Scene


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_scene(stations=1, antennas=2)


@pytest.fixture(scope="module")
def path(scene: Scene) -> OnePath:
    block = split_into_blocks(make_spectra(scene, 300, np.random.default_rng(1)))[0]
    lst = local_sidereal_time(block.time_unix, scene.instrument.longitude_deg)
    return OnePath(scene, block.power[0], scene.sky_power.at(block.dipole, lst))


def test_the_fit_finds_the_minimum_that_scipy_finds_with_all_spectra(scene: Scene, path: OnePath):
    spectra = make_spectra(scene, 300, np.random.default_rng(1))
    report = fit_calibration(spectra, scene.instrument, scene.sky_power)
    # SciPy stops when chi^2 changes by 1e-8 of itself, 1e-4 in chi^2 = 0.01 sigma
    assert farthest(report, scene, path.minimise(path.jacobian), path) < 0.01


def test_the_analytic_derivatives_are_those_of_finite_differences(path: OnePath):
    at = np.random.default_rng(2).uniform(0.8, 1.2, path.start.size)
    step = 1e-6
    for k in (0, 25, 51, 52, 53):
        shift = np.zeros_like(at)
        shift[k] = step
        slope = (path.residual(at + shift) - path.residual(at - shift)) / (2 * step)
        np.testing.assert_allclose(path.jacobian(at)[:, k], slope, rtol=1e-6, atol=1e-6)
