from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.errors import BadInputError
from lbacal_twin.faults.antenna import GainDrift, GainTemperature
from tests.lbacal_core.discovery.worlds import look_at


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
        assert data.conditions.covariates["temperature_c"][event] == spectra.environment["temperature_c"][row]
        assert data.conditions.covariates["rain_mm_h"][event] == spectra.environment["rain_mm_h"][row]
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
    assert set(np.unique(data.relative_variance).tolist()) == {1.0, 2.0}


def test_a_path_with_too_few_events_is_left_out_and_a_station_of_such_paths_refused(world):
    spectra = world.spectra()
    times = np.unique(spectra.time_unix)
    few = spectra.time_unix < times[5]
    look = look_at(spectra.select((spectra.antenna != 1) | few), world.instrument, world.sky)
    assert {antenna for antenna, _ in look.paths} == {0, 2}
    with pytest.raises(BadInputError, match="ingest more"):
        look_at(spectra.select(few), world.instrument, world.sky)


def test_a_cable_that_changes_within_the_data_is_refused_as_the_fit_refuses_it(world):
    """A cable changed at mid-year was once named a reflection."""
    spectra = world.spectra()
    middle = float(np.median(spectra.time_unix))
    (record,) = (r for r in world.instrument.antennas if (r.station, r.antenna) == ("CS002", 1))
    other = next(name for name in world.instrument.cables if name != record.cable)
    changed = [replace(record, until=middle), replace(record, cable=other, since=middle)]
    antennas = [*(r for r in world.instrument.antennas if r is not record), *changed]
    instrument = replace(world.instrument, antennas=antennas)
    with pytest.raises(BadInputError, match=r"antenna 1.*one cable over the window"):
        look_at(spectra, instrument, world.sky)
    with pytest.raises(BadInputError, match=r"antenna 1.*one cable over the window"):
        fit_calibration(spectra, instrument, world.sky)


@pytest.mark.long
def test_one_unknown_temperature_costs_one_event(world):
    """One temperature missing in 250 events once turned a gain that follows it into two other causes."""
    fault = GainTemperature(size=0.02)
    spectra = world.spectra(fault)
    whole = look_at(spectra, world.instrument, world.sky).investigate()
    unknown = spectra.environment["temperature_c"].copy()
    chosen = np.random.default_rng(4).choice(np.unique(spectra.time_unix), 8, replace=False)
    unknown[np.isin(spectra.time_unix, chosen)] = np.nan
    gappy = replace(spectra, environment={**spectra.environment, "temperature_c": unknown})
    report = look_at(gappy, world.instrument, world.sky).investigate()
    (finding,), (same,) = report.findings, whole.findings
    assert finding.hypothesis.cause.identifier == same.hypothesis.cause.identifier == "gain_temperature"
    assert finding.score.events == same.score.events - 8
    assert abs(finding.hypothesis.size - same.hypothesis.size) < same.hypothesis.sigma
    assert report.structure is None


def test_a_dipole_hears_the_sun_best_across_its_arms(station, chain):
    """By azimuths of Sun and arms alone: with the wrong sign of one, morning and afternoon are exchanged."""
    conditions = station.conditions
    arms = np.radians([chain.dipole_azimuth_deg[letter] for letter in ("X", "Y")])
    across = np.abs(np.sin(conditions.sun_azimuth - arms[:, None]))
    is_up = (conditions.sun_altitude > 0.2) & (conditions.sun_altitude < 0.8)
    x, y = (conditions.sun_response[conditions.dipoles.index(letter)] for letter in ("X", "Y"))
    better, worse = (is_up & (sign * (across[0] - across[1]) > 0.3) for sign in (1, -1))
    assert min(better.sum(), worse.sum()) > 10
    assert np.all(x[better] > y[better])
    assert np.all(x[worse] < y[worse])
    assert np.all(conditions.sun_response[:, conditions.sun_altitude < 0] == 0.0)
