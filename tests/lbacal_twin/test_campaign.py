from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lbacal_core.data.tables import read_table
from lbacal_core.errors import BadInputError, UnknownNameError
from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra.blocks import split_into_blocks
from lbacal_core.spectra.spectra import read_spectra, write_spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import YEAR_S, TwinSettings

QUIET = TwinSettings(events_per_year=40, event_gain_common=0, event_gain_path=0, radiometer=0)


def test_without_scatter_every_spectrum_lies_on_the_line_that_the_truth_states(
    low_band: Instrument, two_waves: SkyPower
) -> None:
    campaign = simulate_campaign(QUIET, low_band, two_waves, np.random.default_rng(1))
    for block in split_into_blocks(campaign.spectra):
        truth = next(one for one in campaign.truth.stations if one.station == block.station)
        sky = two_waves.at(block.dipole, local_sidereal_time(block.time_unix, low_band.longitude_deg))
        for row, antenna in enumerate(block.antennas):
            c = campaign.truth.curve(block.dipole, block.station, int(antenna))
            slope = low_band.antenna_gain / c**2
            expected = (sky + truth.n_lna) * slope + truth.n_rcu * low_band.receiver_gain + truth.n_adc
            np.testing.assert_allclose(block.power[row], expected, rtol=1e-12)


def test_c_of_a_station_is_that_of_its_mean_power(low_band: Instrument, two_waves: SkyPower) -> None:
    campaign = simulate_campaign(QUIET, low_band, two_waves, np.random.default_rng(1))
    block = split_into_blocks(campaign.spectra)[0]
    truth = campaign.truth.stations[0]
    sky = two_waves.at("X", local_sidereal_time(block.time_unix, low_band.longitude_deg))
    slope = low_band.antenna_gain / campaign.truth.curve("X", "CS002") ** 2
    expected = (sky + truth.n_lna) * slope + truth.n_rcu * low_band.receiver_gain + truth.n_adc
    np.testing.assert_allclose(block.power.mean(axis=0), expected, rtol=1e-12)
    both = [campaign.truth.curve("X", station) ** -2 for station in ("CS002", "CS003")]
    np.testing.assert_allclose(campaign.truth.curve("X"), np.mean(both, axis=0) ** -0.5)


def test_the_noise_terms_referred_to_the_sky_have_the_published_levels(
    low_band: Instrument, two_waves: SkyPower
) -> None:
    settings = replace(QUIET, stations=("CS002",), noise_level=0, response=0)
    truth = simulate_campaign(settings, low_band, two_waves, np.random.default_rng(1)).truth
    station = truth.stations[0]
    # Without a spread of gains the mean path is the chain with the mean cable, which the levels are defined for.
    slope = (station.c**-2 / station.path_gain[:, :, None]).mean(axis=(0, 1)) * low_band.antenna_gain
    terms = read_table("noise_terms")
    sky = np.mean([two_waves.power[dipole].mean(axis=0) for dipole in "XY"], axis=0)
    forward = {"lna": np.full_like(slope, station.n_lna)}
    forward |= {"rcu": station.n_rcu * low_band.receiver_gain / slope, "adc": station.n_adc / slope}
    for name, referred in forward.items():
        ratio = (referred / sky) / (terms[name] / terms["sky"])
        assert np.exp(np.log(ratio).mean()) == pytest.approx(1.0, rel=1e-9), name


def test_c_resembles_the_published_one(low_band: Instrument, two_waves: SkyPower) -> None:
    truth = simulate_campaign(TwinSettings(events_per_year=5), low_band, two_waves, np.random.default_rng(2)).truth
    ratio = truth.curve("X") / read_table("published_calibration")["c"]
    assert np.abs(ratio - 1).max() < 0.1  # 3 % departures of power per station, 4 % per path: a few per cent in C
    assert np.abs(ratio - 1).max() > 1e-3


@pytest.mark.parametrize("blocks", [100, 25])
def test_radiometer_noise_falls_with_the_root_of_the_blocks(
    low_band: Instrument, two_waves: SkyPower, blocks: int
) -> None:
    settings = replace(QUIET, events_per_year=200, fewest_blocks=blocks, most_blocks=blocks)
    still = simulate_campaign(settings, low_band, two_waves, np.random.default_rng(3)).spectra.power
    noisy = replace(settings, radiometer=512**-0.5)
    spread = (simulate_campaign(noisy, low_band, two_waves, np.random.default_rng(3)).spectra.power / still - 1).std()
    # 245,000 draws: the standard deviation is known to 0.15 %.
    assert spread == pytest.approx(0.0442 * (100 / blocks) ** 0.5, rel=0.007)


def test_event_gain_is_flat_along_frequency_and_partly_common_to_a_station(
    low_band: Instrument, two_waves: SkyPower
) -> None:
    settings = replace(QUIET, events_per_year=2000)
    still = simulate_campaign(settings, low_band, two_waves, np.random.default_rng(4)).spectra.power
    shaken = replace(settings, event_gain_common=0.03, event_gain_path=0.04)
    power = simulate_campaign(shaken, low_band, two_waves, np.random.default_rng(4)).spectra.power
    gain = (power / still).reshape(2, 6, 2, 2000, 51) - 1
    assert np.ptp(gain, axis=-1).max() < 1e-12
    gain = gain[..., 0]
    assert gain.std() == pytest.approx(0.05, rel=0.03)
    common = gain.mean(axis=(1, 2)).std(axis=-1)  # 0.03 and 0.04/sqrt(12) in squares
    assert common == pytest.approx((0.03**2 + 0.04**2 / 12) ** 0.5, rel=0.06)  # 2000 events: 1.6 % each


def test_the_same_seed_gives_the_same_campaign_and_another_seed_another(
    low_band: Instrument, two_waves: SkyPower
) -> None:
    settings = TwinSettings(events_per_year=20)
    digests = [
        simulate_campaign(settings, low_band, two_waves, np.random.default_rng(seed)).spectra.digest()
        for seed in (5, 5, 6)
    ]
    assert digests[0] == digests[1] != digests[2]


def test_events_cover_the_year_and_the_weather_has_seasons(low_band: Instrument, two_waves: SkyPower) -> None:
    settings = replace(QUIET, events_per_year=900, stations=("CS003",), antennas=1)
    spectra = simulate_campaign(settings, low_band, two_waves, np.random.default_rng(7)).spectra
    assert len(np.unique(spectra.event_id)) == 900
    day = (spectra.time_unix - settings.start_unix) / 86_400
    assert 0 <= day.min() < 5
    assert 360 < day.max() < YEAR_S / 86_400
    temperature = spectra.environment["temperature_c"]
    assert temperature[(day > 170) & (day < 230)].mean() - temperature[(day < 50) | (day > 330)].mean() > 10
    assert 0.02 < np.mean(spectra.environment["rain_mm_h"] > 0) < 0.2


def test_a_campaign_goes_through_a_spectra_file_unchanged(
    low_band: Instrument, two_waves: SkyPower, tmp_path: Path
) -> None:
    spectra = simulate_campaign(TwinSettings(events_per_year=9), low_band, two_waves, np.random.default_rng(8)).spectra
    write_spectra(spectra, tmp_path / "s.h5")
    assert read_spectra(tmp_path / "s.h5").digest() == spectra.digest()


def test_a_changed_cable_changes_the_power_from_its_date_on(low_band: Instrument, two_waves: SkyPower) -> None:
    change = QUIET.start_unix + YEAR_S / 2
    records = [AntennaRecord("CS002", 0, "50", until=change), AntennaRecord("CS002", 0, "115", since=change)]
    changed = replace(low_band, antennas=records)
    spectra = simulate_campaign(replace(QUIET, response=0), changed, two_waves, np.random.default_rng(1)).spectra
    kept = replace(low_band, antennas=[AntennaRecord("CS002", 0, "50")])
    same = simulate_campaign(replace(QUIET, response=0), kept, two_waves, np.random.default_rng(1)).spectra
    step = (spectra.power / same.power)[:, 25]
    assert np.all(step[spectra.time_unix >= change] < step[spectra.time_unix < change].min() * 0.9)
    broken = replace(low_band, antennas=[records[0], replace(records[1], since=change + YEAR_S / 4)])
    with pytest.raises(BadInputError, match="a cable on record"):
        simulate_campaign(QUIET, broken, two_waves, np.random.default_rng(1))


def test_an_unknown_station_is_named(low_band: Instrument, two_waves: SkyPower) -> None:
    with pytest.raises(UnknownNameError, match="CS999"):
        simulate_campaign(TwinSettings(stations=("CS999",)), low_band, two_waves, np.random.default_rng(1))
    with pytest.raises(BadInputError, match="path_gain"):
        TwinSettings(path_gain=-0.1)
