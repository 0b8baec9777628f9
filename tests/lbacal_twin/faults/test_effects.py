from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lbacal_core.errors import UnknownNameError
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.sky.table import SkyPower
from lbacal_twin.campaign import draw_stations, expected_power
from lbacal_twin.faults.catalogue import catalogue_faults, draw_fault
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.hardware import (
    AdcJitter,
    CableLength,
    CableReflection,
    CableTemperature,
    Compression,
    FilterShift,
    GainStep,
    GainTemperature,
    LnaNoiseSlope,
    ResonanceShift,
    circuit_response,
)
from lbacal_twin.faults.sky import (
    DipoleSwap,
    ExtraSource,
    IonosphericAbsorption,
    IsotropicLevel,
    LstOffset,
    RfiBroadband,
    RfiLine,
    SolarEmission,
)
from lbacal_twin.faults.uncatalogued import (
    BandSaturation,
    JovianBursts,
    MainsHum,
    Thunderstorms,
    WorkingWeek,
    uncatalogued_faults,
)
from lbacal_twin.nuisances import REALISTIC
from lbacal_twin.settings import TwinSettings
from tests.lbacal_twin.faults.conftest import QUIET


def test_gain_follows_the_temperature_now_or_some_hours_ago(plant) -> None:
    now, late = (plant(GainTemperature(size=0.01, delay_h=hours)) for hours in (0.0, 3.0))
    peak = now.effect[0, 0, :, 28]  # at the resonance almost all power comes from before the gain
    assert np.corrcoef(peak, now.temperature_c)[0, 1] > 0.999
    assert np.corrcoef(late.effect[0, 0, :, 28], now.temperature_c)[0, 1] < 0.995
    expected = 0.01 * (now.temperature_c - 10) / 10
    assert np.all(np.abs(peak) <= np.abs(expected) + 1e-12)


def test_a_step_happens_on_its_date(plant) -> None:
    step = plant(GainStep(size=0.02, date="2014-06-01"))
    is_after = step.time_unix >= 1_401_580_800
    assert np.all(step.effect[:, :, ~is_after] == 0)
    assert np.all(step.effect[:, :, is_after] > 0)


def test_noise_rising_along_frequency_turns_at_55_mhz(plant) -> None:
    effect = plant(LnaNoiseSlope(size=0.1)).effect
    assert np.all(effect[..., 25] == 0)
    assert np.all(effect[..., :25] < 0)
    assert np.all(effect[..., 26:] > 0)


def test_the_circuit_peaks_where_it_is_told_and_a_shift_moves_the_antenna(plant) -> None:
    fine = np.arange(40.0, 75.0, 0.01)
    peak = fine[np.argmax(circuit_response(fine, np.array(58.0), np.array(1.0)))]
    assert peak == pytest.approx(58.0, abs=2.0)  # the load falls along frequency, which pulls the peak down a little
    for is_circuit in (True, False):
        shifted = plant(ResonanceShift(size=0.1, follows="wet", is_circuit=is_circuit))
        is_wet = shifted.rain_mm_h > 0
        assert 3 < is_wet.sum() < 100
        np.testing.assert_allclose(shifted.effect[:, :, ~is_wet], 0.0, atol=1e-12)
        assert np.all(shifted.effect[:, :, is_wet, 20] < 0)  # 50 MHz, below the resonance
        assert np.all(shifted.effect[:, :, is_wet, 36] > 0)  # 66 MHz, above it


def test_a_resonance_moves_in_a_station_of_unequal_antennas_too(low_band, two_waves, view) -> None:
    """It could not: the curve was that of antennas that are all alike."""
    rng = np.random.default_rng(1)
    (station,), _ = draw_stations(QUIET, low_band, two_waves, rng, replace(REALISTIC, departures=0.05), view)
    assert len(station.stages.antenna) > 1
    clean, moved = (
        expected_power(station.stages, station.scene, faults)
        for faults in ((), (ResonanceShift(size=0.1, follows="wet", is_circuit=False),))
    )
    is_wet = station.scene.rain_mm_h > 0
    np.testing.assert_allclose(moved[:, :, ~is_wet], clean[:, :, ~is_wet], rtol=1e-9)
    assert np.all(moved[:, :, is_wet, 36] > clean[:, :, is_wet, 36])  # 66 MHz, above the resonance


FREQUENCY = np.arange(30.0, 81.0)


def test_a_longer_cable_loses_more_at_higher_frequency_by_its_data_sheet(plant, slope: Floats) -> None:
    """0.0816 dB a metre at 30 MHz: 50 m are 4.08 dB."""
    longer = plant(CableLength(size=10.0), IsotropicLevel(size=1.0))
    bare = plant(CableLength(size=10.0))
    change = (longer.power - bare.power)[:, :, 0] / slope
    assert -10 * np.log10(change[0, 0, 0]) == pytest.approx(0.816, rel=1e-3)
    assert np.log10(change[0, 0, 50]) / np.log10(change[0, 0, 0]) == pytest.approx((80 / 30) ** 0.5, rel=1e-3)


@pytest.mark.parametrize("delay_us", [0.2, 0.65, 0.93])
def test_a_channel_damps_a_ripple_by_the_sinc_of_its_delay(plant, slope: Floats, delay_us: float) -> None:
    rippled = plant(CableReflection(size=0.01, delay_us=delay_us), IsotropicLevel(size=1.0))
    bare = plant(CableReflection(size=0.01, delay_us=delay_us))
    ripple = (rippled.power - bare.power)[0, 0, 0] / slope[0, 0] - 1.0
    expected = 0.01 * np.sinc(delay_us) * np.cos(2 * np.pi * delay_us * FREQUENCY)
    np.testing.assert_allclose(ripple, expected, atol=2e-6)  # 64 points in a channel: the sinc to 2e-4


def test_a_warm_cable_loses_in_proportion_to_its_loss_in_decibels(plant) -> None:
    warm = plant(CableTemperature(size=0.01))
    hot = np.argmax(warm.temperature_c)
    assert np.all(warm.effect[:, :, hot] < 0)
    assert np.all(np.abs(warm.effect[2, :, hot, 25]) > np.abs(warm.effect[0, :, hot, 25]))  # 115 m against 50 m


def test_a_line_stays_in_its_channel_and_hours(plant) -> None:
    line = plant(RfiLine(size=0.1, line_mhz=45.0, width_mhz=0.5, hours=(22.0, 4.0)))
    hour = line.time_unix / 3600 % 24
    is_on = (hour >= 22) | (hour < 4)
    assert np.abs(line.effect[:, :, ~is_on]).max() < 1e-12
    assert line.effect[:, :, is_on, 15].min() > 0.05
    assert np.abs(np.delete(line.effect, 15, axis=3)).max() < 1e-3
    broad = plant(RfiBroadband(size=0.1, index=-2.0, hours=(6.0, 18.0)))
    assert np.all((broad.effect[0, 0, :, 10] > 1e-9) == ((hour >= 6) & (hour < 18)))


def test_a_pass_band_that_moves_up_gains_where_it_falls(plant) -> None:
    moved = plant(FilterShift(size=-1e-3, date="2014-06-01"))
    after = moved.time_unix > 1_402_000_000
    assert moved.effect[0, 0, after, 48].min() > 0  # G(nu(1-s)) on the falling edge at 78 MHz


def test_compression_turns_power_down_when_there_is_more_than_usual(plant) -> None:
    effect = plant(Compression(size=0.1))
    total = effect.clean[3, 1].sum(axis=1)
    at_peak = effect.effect[3, 1, :, 28]
    assert np.corrcoef(at_peak, total)[0, 1] < -0.99


def test_jitter_is_white_and_rises_with_the_slope_of_the_signal(plant) -> None:
    jitter = plant(AdcJitter(size=0.01))
    added = (jitter.power - jitter.clean)[0, 0]
    np.testing.assert_allclose(added, added[:, :1] * np.ones(51), rtol=1e-6)
    steepness = jitter.clean[0, 0] @ FREQUENCY**2
    assert np.corrcoef(added[:, 0], steepness)[0, 1] > 0.999


def test_exchanged_cables_exchange_the_sky_and_a_double_exchange_is_none(plant) -> None:
    np.testing.assert_allclose(plant(DipoleSwap(size=1.0), DipoleSwap(size=1.0)).effect, 0.0, atol=1e-12)
    half = plant(DipoleSwap(size=0.5))
    sky = half.power.mean(axis=0) - half.power.mean(axis=(0, 2))[:, None]
    correlation = np.corrcoef(sky[0, :, 25], sky[1, :, 25])[0, 1]
    assert correlation > 1 - 1e-9  # both dipoles see the mean of the two skies


def test_a_clock_off_by_a_sidereal_day_is_no_fault(plant) -> None:
    np.testing.assert_allclose(plant(LstOffset(size=24.0)).effect, 0.0, atol=1e-9)
    assert np.abs(plant(LstOffset(size=12.0)).effect).max() > 0.05


def test_the_sun_shines_by_day_and_the_ionosphere_absorbs_by_day_as_frequency_to_minus_two(plant) -> None:
    sun = plant(SolarEmission(size=0.01))
    solar_hour = (sun.time_unix / 3600.0 + 6.8698 / 15) % 24
    is_night = (solar_hour < 3) | (solar_hour > 21)
    is_noon = np.abs(solar_hour - 12) < 1.5
    assert np.abs(sun.effect[:, :, is_night]).max() < 1e-12
    assert sun.effect[:, :, is_noon].min() > 0
    depth = plant(IonosphericAbsorption(size=0.01))
    np.testing.assert_allclose(depth.effect[:, :, is_night], 0.0, atol=1e-12)
    assert depth.effect[:, :, is_noon].max() < 0
    lost = (depth.clean - depth.power)[0, 0, is_noon] / depth.clean[0, 0, is_noon]
    assert np.all(lost[:, 0] > 2 * lost[:, 30])


def test_a_source_culminates_when_it_should(plant) -> None:
    """Cyg A, right ascension 20.0 h, declination 41 deg: highest, and brightest, at LST 20."""
    effect = plant(ExtraSource(size=0.5, source="cyg-a"))
    added = (effect.power - effect.clean)[0].sum(axis=(0, 2))  # both dipoles: no preferred direction
    near = np.abs((effect.lst_hours - 20.0 + 12) % 24 - 12)
    assert near[np.argmax(added)] < 1.0
    assert added[near > 11].max() < 0.1 * added.max()


def test_without_a_table_of_directions_the_effect_is_a_ratio(low_band: Instrument, two_waves: SkyPower, plant) -> None:
    """An isotropic level in a sky of other units is the same fraction: the twin needs no absolute sky."""
    del low_band
    doubled = replace(two_waves, power={name: 2 * values for name, values in two_waves.power.items()})
    assert doubled.power["X"].mean() == pytest.approx(2 * two_waves.power["X"].mean())
    effect = plant(IsotropicLevel(size=0.01)).effect
    assert 0 < effect.min() < effect.max() < 0.02


def test_uncatalogued_effects_live_on_the_axes_they_name(plant) -> None:
    hum = plant(MainsHum(size=0.01))
    hour = hum.time_unix / 3600 % 24
    np.testing.assert_allclose(np.sign(hum.effect[0, 0, :, 25]), np.sign(np.cos((hour - 8) * np.pi / 6)))
    week = plant(WorkingWeek(size=0.05))
    day = (week.time_unix // 86_400 + 4) % 7  # 0 = Sunday
    np.testing.assert_array_equal(week.effect[0, 0, :, 0] > 1e-6, (day != 0) & (day != 6))
    bursts = plant(JovianBursts(size=0.1)).effect
    assert bursts[..., 0].max() > 1e-3
    assert np.abs(bursts[..., 30:]).max() < 1e-4
    band = plant(BandSaturation(size=0.1)).effect
    assert np.abs(band[..., 28]).max() > 1e-3
    assert np.abs(band[..., [0, 10, 45]]).max() < 1e-9
    storms = plant(Thunderstorms(size=0.1)).effect[0, 0, :, 0] > 1e-6
    assert 3 < storms.sum() < 60


CAUSES = sorted(catalogue_faults())
SETTINGS = TwinSettings(stations=("CS002",))


@pytest.mark.shared
def test_every_cause_of_the_contract_can_be_planted(shared: Path) -> None:
    text = (shared / "CONTRACT.md").read_text()
    section = text[text.index("Causes: ID") : text.index("## HTTP")]
    named = set(re.findall(r"`([a-z_]+)`[:,]", section))
    assert named == set(CAUSES)
    assert len(CAUSES) == 26


@pytest.mark.parametrize("cause", CAUSES)
def test_every_law_changes_the_power_and_of_size_zero_nothing(cause: str, plant) -> None:
    entry = catalogue_faults()[cause]
    for law in (entry.laws[0], entry.laws[-1]):
        dated = {key: "2014-07-01" if value is None else value for key, value in law.items()}
        size = {"lna": 0.1, "rcu": 1e5, "adc": 1e5}[dated["stage"]] if cause == "missing_noise" else entry.typical
        effect = plant(entry.fault(size=size, **dated)).effect
        assert np.abs(effect).max() > 1e-6
        assert np.isfinite(effect).all()
        np.testing.assert_allclose(plant(entry.fault(size=0.0, **dated)).effect, 0.0, atol=1e-12)


@pytest.mark.parametrize("cause", CAUSES)
def test_small_faults_act_in_proportion_to_their_size(cause: str, plant) -> None:
    size = catalogue_faults()[cause].typical
    halves = [
        plant(draw_fault(cause, np.random.default_rng(2), SETTINGS, size=part * size)).effect for part in (0.5, 1.0)
    ]
    # Second order in the effect itself: typical sizes are of 1 % or less, the cable of 3 m is 8 %.
    np.testing.assert_allclose(2 * halves[0], halves[1], atol=0.1 * np.abs(halves[1]).max())


@pytest.mark.parametrize("cause", CAUSES)
def test_only_the_paths_named_are_touched(cause: str, plant) -> None:
    for where, touched in (
        (Where(antennas=(2,), dipoles=("Y",)), [(2, 1)]),
        (Where(cables=("80",)), [(a, d) for a in (1, 4) for d in (0, 1)]),
        (Where(stations=("CS003",)), []),
    ):
        size = 1.0 if cause == "missing_noise" else None
        effect = plant(draw_fault(cause, np.random.default_rng(3), SETTINGS, size=size, where=where)).effect
        is_changed = np.abs(effect).max(axis=(2, 3)) > 1e-12
        assert sorted(map(tuple, np.argwhere(is_changed).tolist())) == touched


@pytest.mark.parametrize("cause", CAUSES)
def test_a_fault_describes_itself_in_json_and_keeps_to_its_laws(cause: str) -> None:
    rng = np.random.default_rng(4)
    for _ in range(5):
        content = json.loads(json.dumps(draw_fault(cause, rng, SETTINGS).as_dict()))
        assert content["fault"] == catalogue_faults()[cause].fault.__name__
        if content.get("date"):
            assert "2014-03-01" < content["date"] < "2014-11-01"


def test_an_unknown_cause_is_named() -> None:
    with pytest.raises(UnknownNameError, match="gremlins"):
        draw_fault("gremlins", np.random.default_rng(1), SETTINGS)


def test_no_uncatalogued_effect_is_a_cause_of_the_catalogue() -> None:
    known = {entry.fault for entry in catalogue_faults().values()}
    assert len(uncatalogued_faults()) >= 6
    assert not known & set(uncatalogued_faults().values())
