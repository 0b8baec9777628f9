from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.data.tables import read_table
from lbacal_core.errors import BadInputError, UnknownNameError
from lbacal_core.instrument.antennas import AntennaRecord, GainProvenance
from lbacal_core.instrument.instrument import Instrument, parse_instrument
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.table import SkyPower
from lbacal_core.spectra.blocks import split_into_blocks
from lbacal_twin.campaign import Campaign, simulate_campaign
from lbacal_twin.gains import BEHIND, FRONT, NOISES, EventGains, shift_resonance
from lbacal_twin.nuisances import DEAF_GAIN, NONE, REALISTIC, RESIDUAL_LINE, Nuisances
from lbacal_twin.settings import YEAR_S, TwinSettings

Simulate = Callable[..., Campaign]
QUIET = TwinSettings(events_per_year=40, event_gain_common=0, event_gain_path=0, radiometer=0)


@pytest.fixture(scope="session")
def simulate(low_band: Instrument, two_waves: SkyPower) -> Simulate:
    """Simulates a campaign of the small instrument, or of another one, under the sky of two waves."""

    def run(settings: TwinSettings, seed: int = 1, instrument: Instrument = low_band, **more: Any) -> Campaign:
        return simulate_campaign(settings, instrument, two_waves, np.random.default_rng(seed), **more)

    return run


def test_what_a_laboratory_has_calibrated_in_kelvin_is_the_same_through_every_cable(
    simulate: Simulate, low_band: Instrument
) -> None:
    absolute = replace(low_band, gain_provenance=GainProvenance("absolute", "a test"), kelvin_error=1e-9)
    campaign = simulate(replace(QUIET, antennas=2), instrument=absolute)
    assert len({record.cable for record in low_band.antennas[:2]}) == 2
    station = campaign.truth.stations[0].station
    one, other = (campaign.truth.curve("X", station, antenna) for antenna in campaign.truth.stations[0].antennas)
    np.testing.assert_allclose(one, other, rtol=1e-6)


def test_without_scatter_every_spectrum_lies_on_the_line_that_the_truth_states(
    simulate: Simulate, low_band: Instrument, two_waves: SkyPower
) -> None:
    campaign = simulate(QUIET)
    for block in split_into_blocks(campaign.spectra):
        truth = next(one for one in campaign.truth.stations if one.station == block.station)
        sky = two_waves.at(block.dipole, local_sidereal_time(block.time_unix, low_band.longitude_deg))
        for row, antenna in enumerate(block.antennas):
            c = campaign.truth.curve(block.dipole, block.station, int(antenna))
            slope = low_band.antenna_gain / c**2
            expected = (sky + truth.n_lna) * slope + truth.n_rcu * low_band.receiver_gain + truth.n_adc
            np.testing.assert_allclose(block.power[row], expected, rtol=1e-12)


def test_c_of_a_station_is_that_of_its_mean_power(
    simulate: Simulate, low_band: Instrument, two_waves: SkyPower
) -> None:
    campaign = simulate(QUIET)
    block = split_into_blocks(campaign.spectra)[0]
    truth = campaign.truth.stations[0]
    sky = two_waves.at("X", local_sidereal_time(block.time_unix, low_band.longitude_deg))
    slope = low_band.antenna_gain / campaign.truth.curve("X", "CS002") ** 2
    expected = (sky + truth.n_lna) * slope + truth.n_rcu * low_band.receiver_gain + truth.n_adc
    np.testing.assert_allclose(block.power.mean(axis=0), expected, rtol=1e-12)
    both = [campaign.truth.curve("X", station) ** -2 for station in ("CS002", "CS003")]
    np.testing.assert_allclose(campaign.truth.curve("X"), np.mean(both, axis=0) ** -0.5)


def test_the_noise_terms_referred_to_the_sky_have_the_published_levels(
    simulate: Simulate, low_band: Instrument, two_waves: SkyPower
) -> None:
    settings = replace(QUIET, stations=("CS002",), noise_level=0, response=0)
    truth = simulate(settings).truth
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


def test_c_resembles_the_published_one(simulate: Simulate) -> None:
    truth = simulate(TwinSettings(events_per_year=5), 2).truth
    ratio = truth.curve("X") / read_table("published_calibration")["c"]
    assert np.abs(ratio - 1).max() < 0.1  # 3 % departures of power per station, 4 % per path: a few per cent in C
    assert np.abs(ratio - 1).max() > 1e-3


@pytest.mark.parametrize("blocks", [100, 25])
def test_radiometer_noise_falls_with_the_root_of_the_blocks(simulate: Simulate, blocks: int) -> None:
    settings = replace(QUIET, events_per_year=200, fewest_blocks=blocks, most_blocks=blocks)
    still = simulate(settings, 3).spectra.power
    noisy = replace(settings, radiometer=512**-0.5)
    spread = (simulate(noisy, 3).spectra.power / still - 1).std()
    # 245,000 draws: the standard deviation is known to 0.15 %.
    assert spread == pytest.approx(0.0442 * (100 / blocks) ** 0.5, rel=0.007)


def test_event_gain_is_flat_along_frequency_and_partly_common_to_a_station(simulate: Simulate) -> None:
    settings = replace(QUIET, events_per_year=2000)
    still = simulate(settings, 4).spectra.power
    shaken = replace(settings, event_gain_common=0.03, event_gain_path=0.04)
    power = simulate(shaken, 4).spectra.power
    gain = (power / still).reshape(2, 6, 2, 2000, 51) - 1
    assert np.ptp(gain, axis=-1).max() < 1e-12
    gain = gain[..., 0]
    assert gain.std() == pytest.approx(0.05, rel=0.03)
    common = gain.mean(axis=(1, 2)).std(axis=-1)  # 0.03 and 0.04/sqrt(12) in squares
    assert common == pytest.approx((0.03**2 + 0.04**2 / 12) ** 0.5, rel=0.06)  # 2000 events: 1.6 % each


def test_the_same_seed_gives_the_same_campaign_and_another_seed_another(simulate: Simulate) -> None:
    settings = TwinSettings(events_per_year=20)
    digests = [simulate(settings, seed).spectra.digest() for seed in (5, 5, 6)]
    assert digests[0] == digests[1] != digests[2]


def test_events_cover_the_year_and_the_weather_has_seasons(simulate: Simulate) -> None:
    settings = replace(QUIET, events_per_year=900, stations=("CS003",), antennas=1)
    spectra = simulate(settings, 7).spectra
    assert len(np.unique(spectra.event_id)) == 900
    day = (spectra.time_unix - settings.start_unix) / 86_400
    assert 0 <= day.min() < 5
    assert 360 < day.max() < YEAR_S / 86_400
    temperature = spectra.environment["temperature_c"]
    assert temperature[(day > 170) & (day < 230)].mean() - temperature[(day < 50) | (day > 330)].mean() > 10
    assert 0.02 < np.mean(spectra.environment["rain_mm_h"] > 0) < 0.2


def test_a_changed_cable_changes_the_power_from_its_date_on(simulate: Simulate, low_band: Instrument) -> None:
    change = QUIET.start_unix + YEAR_S / 2
    records = [AntennaRecord("CS002", 0, "50", until=change), AntennaRecord("CS002", 0, "115", since=change)]
    changed = replace(low_band, antennas=records)
    spectra = simulate(replace(QUIET, response=0), instrument=changed).spectra
    kept = replace(low_band, antennas=[AntennaRecord("CS002", 0, "50")])
    same = simulate(replace(QUIET, response=0), instrument=kept).spectra
    step = (spectra.power / same.power)[:, 25]
    assert np.all(step[spectra.time_unix >= change] < step[spectra.time_unix < change].min() * 0.9)
    broken = replace(low_band, antennas=[records[0], replace(records[1], since=change + YEAR_S / 4)])
    with pytest.raises(BadInputError, match="a cable on record"):
        simulate(QUIET, instrument=broken)


def test_an_unknown_station_is_named(simulate: Simulate) -> None:
    with pytest.raises(UnknownNameError, match="CS999"):
        simulate(TwinSettings(stations=("CS999",)))
    with pytest.raises(BadInputError, match="path_gain"):
        TwinSettings(path_gain=-0.1)


STILL = TwinSettings(events_per_year=400, radiometer=0, stations=("CS002",))


def relative(simulate: Simulate, gains: EventGains, settings: TwinSettings = STILL) -> np.ndarray:
    """Departure of the power from that without event gains, shape (antenna, dipole, event, freq)."""
    quiet = replace(settings, event_gain_common=0, event_gain_path=0)
    changed, plain = (simulate(one, 3, gains=kind).spectra for one, kind in ((settings, gains), (quiet, EventGains())))
    return (changed.power / plain.power - 1).reshape(6, 2, 400, 51)


def test_a_gain_in_front_shows_less_where_electronic_noise_is_a_large_share(simulate: Simulate) -> None:
    seen = relative(simulate, EventGains(FRONT, FRONT))
    by_channel = seen.std(axis=(0, 1, 2))
    # N_RCU and N_ADC are a tenth of the power at the resonance and three quarters of it at 80 MHz.
    assert by_channel.max() == pytest.approx(0.05, rel=0.1)
    assert by_channel[-1] < 0.4 * by_channel.max()
    behind = relative(simulate, EventGains(BEHIND, BEHIND))
    np.testing.assert_allclose(np.ptp(behind, axis=-1), 0.0, atol=1e-12)


def test_each_part_acts_where_it_is_put(simulate: Simulate) -> None:
    for gains, of_common, of_path in (
        (EventGains(FRONT, BEHIND), True, False),
        (EventGains(BEHIND, FRONT), False, True),
    ):
        for name, has_shape in (("event_gain_common", of_common), ("event_gain_path", of_path)):
            alone = replace(STILL, **{"event_gain_common": 0.0, "event_gain_path": 0.0, name: 0.04})
            assert (np.ptp(relative(simulate, gains, alone), axis=-1).max() > 1e-3) == has_shape


def test_a_jitter_of_the_resonance_raises_one_side_of_it_and_lowers_the_other(simulate: Simulate) -> None:
    flat = replace(STILL, event_gain_common=0, event_gain_path=0, response=0)
    seen = relative(simulate, EventGains(common_jitter_mhz=0.05), flat)
    _, sizes, patterns = np.linalg.svd(seen.mean(axis=(0, 1)), full_matrices=False)
    assert sizes[1] < 0.1 * sizes[0]
    assert patterns[0].min() < -0.1
    assert patterns[0].max() > 0.1
    # All paths of an event move together.
    np.testing.assert_allclose(np.corrcoef(seen[..., 20].reshape(12, -1)), 1.0, atol=0.05)


def test_in_a_wet_world_the_resonance_jitters_in_rain_alone(simulate: Simulate) -> None:
    settings = replace(STILL, event_gain_common=0, event_gain_path=0)
    campaign = simulate(settings, 3, gains=NOISES["wetness"])
    seen = relative(simulate, NOISES["wetness"], settings)
    is_wet = campaign.spectra.environment["rain_mm_h"].reshape(12, -1)[0] > 0
    assert np.abs(seen[:, :, ~is_wet]).max() < 1e-9
    assert np.all(np.abs(seen[:, :, is_wet]).max(axis=(0, 1, 3)) > 1e-4)


def test_a_resonance_that_moves_up_is_the_curve_read_lower() -> None:
    frequency = np.arange(30.0, 81.0)
    curve = 1.0 + 20.0 * np.exp(-(((frequency - 58.0) / 6.0) ** 2))
    moved = shift_resonance(curve[None, None, None], frequency, np.full((1, 1, 1, 1), 2.0))
    np.testing.assert_allclose(moved[0, 0, 0, 5:], curve[3:-2], rtol=1e-9)


def test_the_form_of_the_gains_changes_no_other_random_number(simulate: Simulate) -> None:
    quiet = replace(STILL, event_gain_common=0, event_gain_path=0)
    first, second = (simulate(quiet, 3, gains=kind).spectra for kind in (NOISES["behind"], NOISES["front"]))
    np.testing.assert_array_equal(first.power, second.power)


def test_places_and_jitters_that_cannot_be_are_refused() -> None:
    with pytest.raises(BadInputError, match="front or behind"):
        EventGains("beside")
    with pytest.raises(BadInputError, match="0 to 2"):
        EventGains(common_jitter_mhz=-1.0)


SETTINGS = TwinSettings(events_per_year=400)


def test_missing_events_and_dead_antennas_leave_gaps(simulate: Simulate) -> None:
    full = simulate(SETTINGS, nuisances=NONE).spectra
    assert len(full) == 400 * 24
    holed = simulate(SETTINGS, nuisances=Nuisances(missing=0.1)).spectra
    assert len(holed) / len(full) == pytest.approx(0.81, abs=0.02)
    dead = simulate(SETTINGS, nuisances=Nuisances(dead_antennas=2)).spectra
    last = {
        (s, a): dead.time_unix[(dead.station == s) & (dead.antenna == a)].max()
        for s in ("CS002", "CS003")
        for a in range(6)
    }
    assert sum(time < full.time_unix.max() for time in last.values()) == 4


def test_a_thin_part_of_the_sidereal_day_has_fewer_events(simulate: Simulate, low_band: Instrument) -> None:
    full, thin = (
        simulate(SETTINGS, nuisances=Nuisances(thin=depth, thin_lst_hours=3.0)).spectra for depth in (0.0, 0.8)
    )
    counts = [
        np.histogram(local_sidereal_time(one.time_unix, low_band.longitude_deg), 24, (0, 24))[0] for one in (full, thin)
    ]
    assert (counts[1] / counts[0]).min() < 0.5
    assert (counts[1] / counts[0]).max() == 1.0


def test_a_noisy_station_scatters_more(simulate: Simulate) -> None:
    noisy = Nuisances(noisy_stations=("CS003",), noise_factor=2.0)
    still = replace(SETTINGS, radiometer=0, event_gain_common=0, event_gain_path=0)
    clean = simulate(still, nuisances=NONE).spectra
    spectra = simulate(SETTINGS, nuisances=noisy).spectra
    scatter = [(spectra.power / clean.power - 1)[spectra.station == name].std() for name in ("CS002", "CS003")]
    assert scatter[1] / scatter[0] == pytest.approx(2.0, rel=0.05)


def test_antennas_that_see_the_same_sky_are_weakly_correlated(simulate: Simulate) -> None:
    quiet = replace(SETTINGS, event_gain_common=0, event_gain_path=0, stations=("CS002",))
    clean = simulate(replace(quiet, radiometer=0), nuisances=NONE).spectra
    spectra = simulate(quiet, nuisances=Nuisances(sky_correlation=0.1)).spectra
    noise = (spectra.power / clean.power - 1).reshape(6, 2, -1)
    correlation = np.corrcoef(noise[:, 0])[np.triu_indices(6, 1)]
    assert correlation.mean() == pytest.approx(0.1, abs=0.01)  # 15 pairs of 20,400 numbers: 0.002
    assert np.corrcoef(noise[0])[0, 1] == pytest.approx(0.0, abs=0.03)
    assert noise.std() == pytest.approx(0.0442, rel=0.02)


def test_departures_are_in_the_truth_and_have_zero_mean(simulate: Simulate) -> None:
    same, other = (simulate(SETTINGS, nuisances=Nuisances(departures=size)).truth.stations[0].c for size in (0.0, 0.02))
    departure = other / same - 1
    # Power: 2 % from g behind N_RCU and 2 % from A; half of that in C.
    assert departure.std() == pytest.approx(0.014, rel=0.4)
    assert abs(departure.mean()) < 0.014 / 12**0.5 * 3


def test_a_deaf_antenna_hardly_hears_the_sky_and_the_truth_knows(simulate: Simulate) -> None:
    same, deaf = (simulate(SETTINGS, nuisances=Nuisances(deaf_antennas=count)).truth.stations[0].c for count in (0, 1))
    ratio = (deaf / same) ** -2
    assert sorted(ratio[:, :, 25].min(axis=1).round(6)) == [DEAF_GAIN, 1, 1, 1, 1, 1]


def test_events_of_runs_lie_together(simulate: Simulate) -> None:
    counts = []
    for part in (0.0, 0.6):
        one_station = replace(SETTINGS, stations=("CS002",))
        spectra = simulate(one_station, nuisances=Nuisances(clustered=part)).spectra
        times = np.unique(spectra.time_unix)
        assert times.size == 400
        counts.append(np.histogram(times, 73, (SETTINGS.start_unix, SETTINGS.start_unix + YEAR_S))[0])
    assert counts[1].std() > 1.5 * counts[0].std()


def test_interference_that_was_left_is_in_single_channels_of_all_paths(simulate: Simulate) -> None:
    still = replace(SETTINGS, radiometer=0, event_gain_common=0, event_gain_path=0, stations=("CS002",))
    clean, spoilt = (
        simulate(still, nuisances=Nuisances(interference=lines)).spectra.power.reshape(12, -1) for lines in (0.0, 0.2)
    )
    excess = spoilt / clean - 1
    is_hit = excess > 0
    assert np.mean(is_hit.any(axis=0)) == pytest.approx(0.2 / 51, rel=0.4)  # 80 lines
    assert np.all(is_hit.all(axis=0) == is_hit.any(axis=0))
    assert excess[is_hit].mean() == pytest.approx(RESIDUAL_LINE, rel=0.4)
    assert excess.min() >= 0


def test_a_realistic_campaign_still_calibrates(simulate: Simulate, low_band: Instrument, two_waves: SkyPower) -> None:
    campaign = simulate(TwinSettings(stations=("CS002",)), nuisances=REALISTIC)
    report = fit_calibration(campaign.spectra, Simulation(low_band, two_waves))
    deviations = [
        np.abs(curve.c / campaign.truth.curve(curve.dipole or "", "CS002", curve.antenna) - 1)
        for curve in report.curves
        if curve.c is not None
    ]
    assert len(deviations) >= 8
    assert np.median(deviations) < 0.03


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(BadInputError, match="missing"):
        Nuisances(missing=1.5)


NU = np.arange(30.0, 81.0, 2.0)
RESONANCE = 5.0 * np.exp(-(((NU - 58.0) / 16.0) ** 2)) + 0.05
FREE = {"noise_temperature_k": "free"}


def make_instrument(*front, behind=({"name": "amp", "kind": "amplifier", "gain_db": 30, **FREE},)):
    passband = (1.0 / (1.0 + (NU / 70.0) ** 12)).tolist()
    content = {
        "name": "staged", "latitude_deg": 52.9, "longitude_deg": 6.9, "height_m": 10, "frequency_mhz": NU.tolist(),
        "dipoles": {"X": {"azimuth_deg": 45}, "Y": {"azimuth_deg": 135}}, "antenna": "short-dipole",
        "antenna_gain": RESONANCE.tolist(), "antenna_gain_provenance": {"kind": "absolute", "source": "drawn"},
        "stages": [
            *front,
            {"name": "coax", "kind": "cable", "gain_db": -4},
            {"name": "filter", "kind": "filter", "gain": passband, **FREE},
            *behind,
            {"name": "adc", "kind": "adc", **FREE},
        ],
        "antennas": [{"station": "S1", "antenna": number} for number in range(4)],
    }  # fmt: skip
    return parse_instrument(content, "staged")


def fit_staged(instrument, seed):
    sky = compute_sky_power(instrument)
    settings = TwinSettings(events_per_year=300)
    campaign = simulate_campaign(settings, instrument, sky, np.random.default_rng([190, seed]))
    report = fit_calibration(campaign.spectra, Simulation(instrument, sky))
    assert {curve.status for curve in report.curves} == {"converged"}
    truth = campaign.truth
    pulls = [
        np.median((curve.c - truth.curve(curve.dipole, curve.station, curve.antenna)) / curve.c_sigma_stat)
        for curve in report.curves
    ]
    return report, truth.stations[0].constants, np.array(pulls)


GROUND = {"name": "ground", "kind": "ground", "noise_temperature_k": 290, "solid_angle_sr": 0.1}
FREE_LNA = {"name": "lna", "kind": "lna", "gain_db": 25, **FREE}
KNOWN_LNA = FREE_LNA | {"noise_temperature_k": 150, "noise_temperature_error_k": 15}


@pytest.mark.parametrize("lna", [FREE_LNA, KNOWN_LNA], ids=["free", "known"])
def test_c_and_the_noise_of_stages_come_out_within_their_errors(lna):
    pulls_of_c, pulls = [], []
    for seed in range(3):
        report, planted, own = fit_staged(make_instrument(GROUND, lna), seed)
        pulls_of_c.append(own)
        for curve in report.curves:
            # a flat amplifier and the converter behind it add the same in every channel
            assert curve.merged.constants == ("n_amp", "n_adc")
            found = {name: curve.parameters[name] for name in ("n_lna", "n_filter")}
            pulls.append([(one.value - planted[name]) / one.sigma for name, one in found.items()])
    assert np.sqrt(np.mean(np.square(pulls_of_c))) < 1.5
    # a temperature that is known counts once for all curves
    assert np.sqrt(np.mean(np.square(pulls))) < 1.7


def test_a_temperature_that_is_known_is_known_better_afterwards_and_so_is_c():
    free, _, _ = fit_staged(make_instrument(GROUND, FREE_LNA), 0)
    known, _, _ = fit_staged(make_instrument(GROUND, KNOWN_LNA), 0)
    assert all(0.0 < curve.parameters["n_lna"].sigma < 15.0 for curve in known.curves)
    assert all(curve.parameters["n_lna"].sigma > 100.0 for curve in free.curves)
    errors = [np.median([np.median(curve.c_sigma_stat / curve.c) for curve in one.curves]) for one in (free, known)]
    assert errors[1] < 0.8 * errors[0]
    assert "n_lna in K, known as 150 +- 15" in known.provenance.notes["noise_constants"]


def test_a_temperature_that_is_wrong_in_the_file_moves_c_and_fails_the_chain_test():
    planted = make_instrument(GROUND, KNOWN_LNA)
    sky = compute_sky_power(planted)
    spectra = simulate_campaign(TwinSettings(events_per_year=300), planted, sky, np.random.default_rng(5)).spectra
    right = fit_calibration(spectra, Simulation(planted, sky)).curves[0]
    wrong = fit_calibration(
        spectra, Simulation(make_instrument(GROUND, KNOWN_LNA | {"noise_temperature_k": 2000}), sky)
    ).curves[0]
    assert right.chi2_per_dof < 2.0 < wrong.chi2_per_dof
    assert np.median(np.abs(wrong.c - right.c) / right.c_sigma_stat) > 2.0


def test_unlike_antennas_hand_over_powers_that_differ_as_much_as_is_asked_and_the_truth_knows_it(
    simulate: Simulate,
) -> None:
    alike, unlike = (simulate(QUIET, nuisances=Nuisances(mismatch=size)) for size in (0.0, 0.2))
    ratios = []
    for one, other in zip(alike.truth.stations, unlike.truth.stations, strict=True):
        for row, antenna in enumerate(one.antennas):
            for k, dipole in enumerate("XY"):
                ratios.append(-2.0 * np.log(other.c[row, k] / one.c[row, k]))
                at = (alike.spectra.station == one.station) & (alike.spectra.antenna == antenna)
                at &= alike.spectra.dipole == dipole
                change = np.log(unlike.spectra.power[at] / alike.spectra.power[at])
                assert np.all(np.abs(change) <= np.abs(ratios[-1]) + 1e-9), "noise behind the antenna dilutes it"
                assert np.all(change * ratios[-1] >= -1e-9)
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(0.2, rel=0.25)
    assert np.std(np.diff(ratios, axis=1)) > 0.005, "not flat along frequency"
