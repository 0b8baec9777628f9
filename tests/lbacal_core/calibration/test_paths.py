from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.calibration.paths import paths_of_scope, radiometer_limit, require_one_cable_each


@pytest.fixture(scope="module")
def spectra(scene):
    return scene.spectra(np.random.default_rng(11), events=400, stations=2)


def test_an_event_that_one_antenna_of_four_recorded_has_the_noise_of_its_power_and_not_of_four(scene, spectra):
    one_station = spectra.select((spectra.station == "CS002") & (spectra.dipole == "X"))
    is_lonely = np.isin(one_station.event_id, np.unique(one_station.event_id)[::4])
    some = one_station.select(~is_lonely | (one_station.antenna == 0))
    cables = require_one_cable_each(some, scene.instrument)
    (read,) = paths_of_scope(some, scene.instrument, scene.sky_power, "station", cables)
    mean = read()
    level = np.array([np.mean(one_station.power[one_station.antenna == antenna]) for antenna in range(4)])
    # of equal cables it would be 4; 1 % because the level is that of noisy spectra
    assert mean.relative_variance[0, 0::4] == pytest.approx(level.sum() ** 2 / np.sum(level**2), rel=0.01)
    assert np.delete(mean.relative_variance[0], np.s_[0::4]) == pytest.approx(1.0)


def test_radiometer_noise_is_that_of_the_samples_of_a_channel(spectra):
    # 100 blocks of 1024 samples at 160 MHz or faster are 640 microseconds or less: 1280 samples of 2 MHz
    assert radiometer_limit(spectra) == pytest.approx(1280**-0.5)
    known = replace(spectra, duration_s=np.full(len(spectra), 0.0005))
    assert radiometer_limit(known) == pytest.approx(1000**-0.5)


def test_a_mean_knows_the_scatter_of_the_single_spectra(scene, spectra):
    cables = require_one_cable_each(spectra, scene.instrument)
    for read in paths_of_scope(spectra, scene.instrument, scene.sky_power, "station", cables):
        paths = read()
        assert paths.scatter == pytest.approx(0.045, rel=0.03)
        assert paths.smallest_scatter == pytest.approx(1280**-0.5)
