from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_twin.campaign import draw_stations, expected_power
from lbacal_twin.faults.antenna import GainStep, GainTemperature, LnaNoiseSlope, ResonanceShift, circuit_response
from lbacal_twin.nuisances import REALISTIC
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
