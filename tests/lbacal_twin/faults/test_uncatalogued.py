from __future__ import annotations

import numpy as np

from lbacal_twin.faults.uncatalogued import BandSaturation, JovianBursts, MainsHum, Thunderstorms, WorkingWeek


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
