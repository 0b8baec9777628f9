from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.instrument.instrument import Instrument
from lbacal_core.skypower.table import SkyPower
from lbacal_twin.faults.sky import (
    DipoleSwap,
    ExtraSource,
    IonosphericAbsorption,
    IsotropicLevel,
    LstOffset,
    SolarEmission,
)


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
