from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.calibration.singles import SMALLEST_SHARE
from lbacal_core.discovery.baseline import leave_out_deaf, sky_shares
from lbacal_core.discovery.report import investigate
from lbacal_core.discovery.station import gather_stations
from lbacal_core.errors import BadInputError
from lbacal_core.simulation.simulation import Simulation
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.hardware import Compression, GainTemperature
from lbacal_twin.nuisances import Nuisances
from lbacal_twin.world import World
from tests.lbacal_core.discovery.conftest import SEED, SETTINGS
from tests.lbacal_core.discovery.worlds import look_at


def test_every_event_stands_at_its_time_and_every_spectrum_at_its_path(world):
    spectra = world.spectra()
    rng = np.random.default_rng(3)
    kept = rng.permutation(len(spectra))[: int(0.9 * len(spectra))]
    look = look_at(spectra.select(kept), world.simulation)
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


def test_spectra_of_fewer_blocks_count_as_noisier(world):
    spectra = world.spectra()
    blocks = np.where(np.arange(len(spectra)) % 3 == 0, 50, 100)
    data = look_at(replace(spectra, blocks=blocks), world.simulation).data
    assert set(np.unique(data.relative_variance).tolist()) == {1.0, 2.0}


def test_a_path_with_too_few_events_is_left_out_and_a_station_of_such_paths_refused(world):
    spectra = world.spectra()
    times = np.unique(spectra.time_unix)
    few = spectra.time_unix < times[5]
    look = look_at(spectra.select((spectra.antenna != 1) | few), world.simulation)
    assert {antenna for antenna, _ in look.paths} == {0, 2}
    with pytest.raises(BadInputError, match="ingest more"):
        look_at(spectra.select(few), world.simulation)


def test_a_cable_that_changes_within_the_data_is_refused_as_the_fit_refuses_it(world):
    """A cable changed at mid-year was once named a reflection."""
    spectra = world.spectra()
    middle = float(np.median(spectra.time_unix))
    (record,) = (r for r in world.instrument.antennas if (r.station, r.antenna) == ("CS002", 1))
    other = next(name for name in world.instrument.cables if name != record.cable)
    changed = [replace(record, until=middle), replace(record, cable=other, since=middle)]
    antennas = [*(r for r in world.instrument.antennas if r is not record), *changed]
    changed = Simulation(replace(world.instrument, antennas=antennas), world.sky)
    for act in (look_at, fit_calibration):
        with pytest.raises(BadInputError, match=r"antenna 1.*one cable over the window"):
            act(spectra, changed)


@pytest.mark.long
def test_one_unknown_temperature_costs_one_event(world):
    """One temperature missing in 250 events once turned a gain that follows it into two other causes."""
    fault = GainTemperature(size=0.02)
    spectra = world.spectra(fault)
    whole = look_at(spectra, world.simulation).investigate()
    unknown = spectra.environment["temperature_c"].copy()
    chosen = np.random.default_rng(4).choice(np.unique(spectra.time_unix), 8, replace=False)
    unknown[np.isin(spectra.time_unix, chosen)] = np.nan
    gappy = replace(spectra, environment={**spectra.environment, "temperature_c": unknown})
    report = look_at(gappy, world.simulation).investigate()
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


@pytest.fixture(scope="module")
def broken(chain):
    """A year in which one of eight antennas hardly hears the sky, and that sky is not the finder's."""
    world = World("maeda", "hamaker", "behind")
    nuisances = Nuisances(deaf_antennas=1)
    return simulate_campaign(
        SETTINGS, chain, world.sky_power(chain), np.random.default_rng(SEED), nuisances=nuisances
    ).spectra


def test_an_antenna_that_hardly_hears_the_sky_is_left_out_and_no_other(broken, simulation):
    (station,) = gather_stations(broken, simulation)
    without, names = leave_out_deaf(station)
    assert len(names) == 2
    assert names[0].removesuffix(" X") == names[1].removesuffix(" Y")
    assert len(without.antenna) == len(station.antenna) - 2
    number = int(names[0].split()[1])
    assert number not in without.antenna
    assert without.power.shape[0] == without.relative_variance.shape[0] == without.group.size == without.antenna.size


def test_a_station_that_hears_the_sky_stays_as_it_is(station):
    without, names = leave_out_deaf(station)
    assert without is station
    assert names == []
    share = sky_shares(station)
    assert share.min() > 1.2 * SMALLEST_SHARE * np.median(share)


def test_a_path_that_compresses_is_not_deaf(world):
    """What the gain loses to the power looks like noise behind the sky: two such paths in drawn worlds were "deaf"."""
    antenna = int(world.station.scene.antennas[1])
    where = Where(antennas=(antenna,), dipoles=("X",))
    look = world.look(Compression(size=0.85, where=where))
    share = sky_shares(look.data)
    seems = share[look.paths.index((antenna, "X"))] / np.median(share)
    assert SMALLEST_SHARE < seems < 0.4
    assert leave_out_deaf(look.data)[1] == []


def test_the_last_path_of_a_class_stays(broken, chain, simulation):
    (station,) = gather_stations(broken, simulation)
    number = int(leave_out_deaf(station)[1][0].split()[1])
    cable = chain.cable_of("CS002", number, station.conditions.time_unix[0])
    others = [r.antenna for r in chain.antennas if r.station == "CS002" and r.cable == cable and r.antenna != number]
    alone = broken.select(~np.isin(broken.antenna, others))
    (station,) = gather_stations(alone, simulation)
    assert leave_out_deaf(station)[1] == []


@pytest.mark.long
def test_a_deaf_antenna_under_a_wrong_sky_is_named_deaf_and_nothing_else(broken, chain, sky):
    """It was `adc_jitter` and `compression` of that antenna at 5 sigma."""
    report, _ = investigate(broken, Simulation(chain, sky, is_own_sky=True))
    assert report["findings"] == []
    assert len(report["stations"][0]["deaf"]) == 2


def test_paths_antennas_cables_and_the_station_are_targets(world):
    look = world.with_settings(antennas=8).look()
    scopes = [scope for scope, _, _ in look.targets()]
    cables = {record.cable for record in world.instrument.antennas if record.station == "CS002" and record.antenna < 8}
    assert scopes.count("path") == 16
    assert scopes.count("antenna") == 8
    assert scopes.count("cable") == len(cables) > 1
    assert scopes.count("station") == 1
    members = {label: paths for _, label, paths in look.targets()}
    assert members["antenna 3"] == [(3, "X"), (3, "Y")]
    assert members["antenna 3 Y"] == [(3, "Y")]
    assert sorted(members["station"]) == [(a, d) for a in range(8) for d in "XY"]
    for cable in cables:
        antennas = {r.antenna for r in world.instrument.antennas if r.station == "CS002" and r.cable == cable}
        assert members[f"cable {cable}"] == [(a, d) for d in "XY" for a in range(8) if a in antennas]


def test_antennas_of_one_board_are_a_target_unless_they_are_one_antenna_or_all(world):
    def targets_of(groups):
        records = [replace(record, group=groups(record.antenna)) for record in world.instrument.antennas]
        return look_at(world.spectra(), Simulation(replace(world.instrument, antennas=records), world.sky)).targets()

    targets = targets_of({0: "board 1", 2: "board 1", 1: "board 2"}.get)
    of_groups = [(label, paths) for scope, label, paths in targets if scope == "group"]
    assert of_groups == [("group board 1", [(0, "X"), (2, "X"), (0, "Y"), (2, "Y")])]
    assert "group" not in {scope for scope, _, _ in targets_of(lambda _: "cabinet")}


def test_sets_of_paths_that_coincide_are_one_target(world):
    spectra = world.spectra()
    of_dipole = ["antenna 0 X", "antenna 1 X", "antenna 2 X", "station"]
    for rows, expected in ((spectra.antenna == 1, ["station"]), (spectra.dipole == "X", of_dipole)):
        targets = look_at(spectra.select(rows), world.simulation).targets()
        assert [label for _, label, _ in targets] == expected
