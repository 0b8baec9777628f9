from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.discovery.baseline import SMALLEST_SHARE, leave_out_deaf, sky_shares
from lbacal_core.discovery.report import investigate
from lbacal_core.discovery.station import gather_stations
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.receiver import Compression
from lbacal_twin.nuisances import Nuisances
from lbacal_twin.world import World
from tests.lbacal_core.discovery.conftest import SEED, SETTINGS


@pytest.fixture(scope="module")
def broken(chain):
    """A year in which one of eight antennas hardly hears the sky, and that sky is not the finder's."""
    world = World("maeda", "hamaker", "behind")
    nuisances = Nuisances(deaf_antennas=1)
    return simulate_campaign(
        SETTINGS, chain, world.sky_power(chain), np.random.default_rng(SEED), nuisances=nuisances
    ).spectra


def test_an_antenna_that_hardly_hears_the_sky_is_left_out_and_no_other(broken, chain, sky):
    (station,) = gather_stations(broken, chain, sky)
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


def test_the_last_path_of_a_class_stays(broken, chain, sky):
    (station,) = gather_stations(broken, chain, sky)
    number = int(leave_out_deaf(station)[1][0].split()[1])
    cable = chain.cable_of("CS002", number, station.conditions.time_unix[0])
    others = [r.antenna for r in chain.antennas if r.station == "CS002" and r.cable == cable and r.antenna != number]
    alone = broken.select(~np.isin(broken.antenna, others))
    (station,) = gather_stations(alone, chain, sky)
    assert leave_out_deaf(station)[1] == []


@pytest.mark.long
def test_a_deaf_antenna_under_a_wrong_sky_is_named_deaf_and_nothing_else(broken, chain, sky):
    """It was `adc_jitter` and `compression` of that antenna at 5 sigma."""
    report, _ = investigate(broken, chain, sky, is_own_sky=True)
    assert report["findings"] == []
    assert len(report["stations"][0]["deaf"]) == 2
