from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.grids import Floats
from lbacal_twin.faults.cable import CableLength, CableReflection, CableTemperature
from lbacal_twin.faults.sky import IsotropicLevel

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
