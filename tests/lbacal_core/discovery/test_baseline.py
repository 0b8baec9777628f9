from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.discovery.baseline import relative_sky_changes
from lbacal_core.errors import BadInputError
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.skypower.variation import vary_sky_power
from lbacal_core.twin.campaign import expected_power
from lbacal_core.twin.faults.antenna import GainDrift
from tests.lbacal_core.discovery.worlds import SILENT, look_at


@pytest.fixture(scope="module")
def silent(world):
    return world.with_settings(**SILENT, noise_level=0.0)


@pytest.fixture(scope="module")
def exact(silent):
    return silent.look()


def test_spectra_without_noise_leave_nothing_and_give_the_planted_constants(silent, exact):
    assert np.abs(exact.residual).max() < 1e-6
    truth = silent.station.truth
    planted = (truth.n_lna, truth.n_rcu, truth.n_adc)
    for k, name in enumerate(("n_lna", "n_rcu", "n_adc")):
        assert exact.noise_constants()[:, k] == pytest.approx(planted[k], rel=1e-4), name


def test_the_fitted_slope_is_the_planted_calibration_to_the_power_minus_two(silent, exact):
    planted = exact.arrange(silent.station.truth.c) ** -2 * silent.instrument.antenna_gain
    assert exact.slopes() == pytest.approx(planted, rel=1e-4)


def test_the_chain_of_the_mean_path_is_that_of_its_paths(silent, exact):
    planted = exact.arrange(expected_power(silent.station.stages, silent.station.scene, []))
    # The median of three gains that scatter by 4 %.
    assert exact.modelled_power() == pytest.approx(planted, rel=0.15)
    assert np.mean(exact.modelled_power() / planted) == pytest.approx(1.0, abs=0.04)


def test_every_event_stands_at_its_time_and_every_spectrum_at_its_path(world):
    spectra = world.spectra()
    rng = np.random.default_rng(3)
    kept = rng.permutation(len(spectra))[: int(0.9 * len(spectra))]
    look = look_at(spectra.select(kept), world.instrument, world.sky)
    data = look.data
    assert np.all(np.diff(data.conditions.time_unix) > 0)
    assert data.is_present.sum() == kept.size
    for row in kept[::97]:
        path = look.paths.index((int(spectra.antenna[row]), str(spectra.dipole[row])))
        event = int(np.flatnonzero(data.conditions.time_unix == spectra.time_unix[row])[0])
        assert np.array_equal(data.power[path, event], spectra.power[row])
        assert data.conditions.temperature_c[event] == spectra.environment["temperature_c"][row]
        assert data.conditions.rain_mm_h[event] == spectra.environment["rain_mm_h"][row]
    assert np.all(look.residual[~data.is_present] == 0.0)


def test_the_events_of_a_world_are_the_same_with_a_fault(world):
    """What spares the tests a second: only the power of a spoilt station is read again."""
    fault = GainDrift(size=0.02)
    gathered = look_at(world.spectra(fault), world.instrument, world.sky)
    assert np.array_equal(gathered.data.power, world.look(fault).data.power)
    assert np.array_equal(gathered.data.event_id, world.look(fault).data.event_id)


def test_spectra_of_fewer_blocks_count_as_noisier(world):
    spectra = world.spectra()
    blocks = np.where(np.arange(len(spectra)) % 3 == 0, 50, 100)
    data = look_at(replace(spectra, blocks=blocks), world.instrument, world.sky).data
    assert set(np.unique(data.excess).tolist()) == {1.0, 2.0}


def test_a_path_with_too_few_events_is_left_out_and_a_station_of_such_paths_refused(world):
    spectra = world.spectra()
    times = np.unique(spectra.time_unix)
    few = spectra.time_unix < times[5]
    look = look_at(spectra.select((spectra.antenna != 1) | few), world.instrument, world.sky)
    assert {antenna for antenna, _ in look.paths} == {0, 2}
    with pytest.raises(BadInputError, match="ingest more"):
        look_at(spectra.select(few), world.instrument, world.sky)


def test_changes_of_the_sky_are_the_logarithm_of_with_over_without(world):
    """To first order: a large turn against the tabulated change a degree times its angle."""
    changes = relative_sky_changes(world.instrument)
    own = compute_sky_power(world.instrument)
    for name, option, amount in (
        ("dipole_azimuth", "azimuth_deg", 2.0),
        ("zenith_weighting", "zenith_exponent", 0.2),
        ("pattern_width", "zenith_gain_fraction", 0.1),
    ):
        with_it = vary_sky_power(world.instrument, **{option: amount})
        without = vary_sky_power(world.instrument, **{option: 0.0})
        assert without.power["X"] == pytest.approx(own.power["X"], rel=1e-3)
        for dipole in "XY":
            expected = np.log(with_it.power[dipole] / without.power[dipole])
            found = amount * np.log(changes[name].power[dipole])
            assert np.linalg.norm(found - expected) < 0.06 * np.linalg.norm(expected), name
    for source in ("Cas A", "Cyg A", "Tau A", "Vir A"):
        share = np.log(changes[source].power["X"])
        assert np.all(share >= -1e-12)
        assert 1e-4 < share.max() < 0.5


def test_channels_that_the_own_models_do_not_cover_have_no_changes_of_the_sky(world):
    outside = replace(world.instrument, frequency_mhz=world.instrument.frequency_mhz + 300.0)
    assert relative_sky_changes(outside) == {}
