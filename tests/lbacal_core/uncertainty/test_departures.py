from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.curves.curves import CalibrationCurve, Parameter
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra.blocks import SpectraBlock
from lbacal_core.uncertainty.one_event import compare_paths, map_departures

FREQUENCY = np.arange(30.0, 81.0)
EVENTS = 400


def curve(antenna: int | None, station: str | None = "CS002", dipole: str = "X") -> CalibrationCurve:
    parameters = {name: Parameter(value, 0.0) for name, value in (("n_lna", 0.3), ("n_rcu", 0.7), ("n_adc", 0.1))}
    c = np.full(51, 0.5)
    return CalibrationCurve(station, antenna, dipole, "converged", 900, FREQUENCY, c, 0.01 * c, None, 1, 1, parameters)


def block(instrument: Instrument, sky_power: SkyPower, gains: tuple[float, float]) -> SpectraBlock:
    """Two antennas whose power is that of the curve times a gain; the second lacks every other event."""
    time_unix = 1.4e9 + np.sort(np.random.default_rng(1).uniform(0, 3e7, EVENTS))
    sky = sky_power.at("X", local_sidereal_time(time_unix, instrument.longitude_deg))
    slope = instrument.antenna_gain / 0.25
    power = (sky + 0.3) * slope + 0.7 * instrument.receiver_gain + 0.1
    is_present = np.ones((2, EVENTS), dtype=bool)
    is_present[1, ::2] = False
    return SpectraBlock(
        "CS002", "X", FREQUENCY, np.array([4, 9]), np.array([f"E{k}" for k in range(EVENTS)]), time_unix,
        np.stack([gains[0] * power, gains[1] * power]), is_present, np.where(is_present, 100, 0),
    )  # fmt: skip


def test_a_path_is_compared_with_the_narrowest_curve_that_answers(low_band: Instrument, two_waves: SkyPower) -> None:
    seen = block(low_band, two_waves, (1.0, 1.1))
    curves = [curve(4), curve(None), curve(None, station=None), curve(9, dipole="Y"), curve(4, station="CS003")]
    found = {row: (one.antenna, ratio) for row, one, ratio in compare_paths(seen, curves, low_band, two_waves)}
    assert {row: antenna for row, (antenna, _) in found.items()} == {0: 4, 1: None}
    assert found[0][1] == pytest.approx(np.ones((EVENTS, 51)))
    assert found[1][1] == pytest.approx(np.full((EVENTS // 2, 51), 1.1))
    assert list(compare_paths(seen, [curve(9, dipole="Y")], low_band, two_waves)) == []


def test_the_map_shows_what_was_added_and_nothing_else(low_band: Instrument, two_waves: SkyPower) -> None:
    plain, curves = block(low_band, two_waves, (1.02, 1.1)), [curve(4), curve(9)]
    lst = local_sidereal_time(plain.time_unix, low_band.longitude_deg)
    power = plain.power.copy()
    power[:, (lst >= 6.0) & (lst < 6.5), 20] *= 1.3
    before, after = (map_departures(one, curves, low_band, two_waves) for one in (plain, replace(plain, power=power)))
    assert before.shape == (48, 51)
    assert np.nanmean(before) == pytest.approx((0.02 * 2 + 0.1) / 3, abs=0.005)
    difference = after - before
    assert difference[12, 20] == pytest.approx(0.3 * (1 + before[12, 20]))
    difference[12, 20] = 0.0
    assert np.nanmax(np.abs(difference)) == 0.0


def test_the_gain_of_a_path_is_no_departure_from_its_stations_curve(low_band: Instrument, two_waves: SkyPower) -> None:
    seen = block(low_band, two_waves, (0.9, 1.1))
    found = map_departures(seen, [curve(None)], low_band, two_waves)
    assert np.nanmax(np.abs(found)) < 1e-12
    assert found.shape == (48, 51)
