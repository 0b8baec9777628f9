from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.spectra.screening import FEWEST_EVENTS
from lbacal_core.spectra.spectra import Spectra
from lbacal_core.traces.assembly import find_anomalous_spectra

LONGITUDE = 6.87
EVENTS, ANTENNAS = 150, 6


def campaign(factor: np.ndarray, events: int = EVENTS) -> Spectra:
    """A sky that swings by 40 % over the sidereal day, 5 % gain scatter, and a factor (antenna, event) on top."""
    rng = np.random.default_rng(1)
    time_unix = 1.4e9 + np.sort(rng.uniform(0, 3e7, events))
    sky = 1 + 0.4 * np.cos(2 * np.pi * (local_sidereal_time(time_unix, LONGITUDE) - 18) / 24)
    gain = rng.normal(1, 0.03, (1, events)) * rng.normal(1, 0.04, (ANTENNAS, events))
    level = sky * gain * rng.normal(1, 0.3, (ANTENNAS, 1)) ** 2 * factor[:, :events]
    rows = ANTENNAS * events
    return Spectra(
        frequency_mhz=np.arange(30.0, 81.0),
        power=level.reshape(-1, 1) * rng.normal(1, 0.04, (rows, 51)),
        event_id=np.tile([f"e{k}" for k in range(events)], ANTENNAS),
        time_unix=np.tile(time_unix, ANTENNAS),
        station=np.full(rows, "CS002"),
        antenna=np.repeat(np.arange(ANTENNAS), events),
        dipole=np.full(rows, "X"),
        blocks=np.full(rows, 400),
    )


def test_ordinary_scatter_and_the_turning_sky_are_not_anomalous() -> None:
    assert find_anomalous_spectra(campaign(np.ones((ANTENNAS, EVENTS))), LONGITUDE) == {}


@pytest.mark.parametrize("factor", [0.5, 1.6, 30.0])
def test_a_thunderstorm_takes_the_station_and_a_bad_receiver_its_path(factor: float) -> None:
    change = np.ones((ANTENNAS, EVENTS))
    change[:, 40] = factor
    change[2, 70] = factor
    found = find_anomalous_spectra(campaign(change), LONGITUDE)
    station = {("e40", "CS002", antenna, "X") for antenna in range(ANTENNAS)}
    assert set(found) == station | {("e70", "CS002", 2, "X")}
    words = found["e70", "CS002", 2, "X"]
    assert words.startswith("anomalous power: this path's is ")
    assert float(words.split(" is ")[1].split(" times")[0]) == pytest.approx(factor, rel=0.2)


def test_a_bad_receiver_is_seen_where_the_gain_of_the_whole_station_scatters() -> None:
    """What all paths share is taken out before one of them is compared with the others."""
    change = np.exp(0.12 * np.random.default_rng(2).standard_normal((1, EVENTS))) * np.ones((ANTENNAS, 1))
    change[2, 70] *= 1.6
    assert set(find_anomalous_spectra(campaign(change), LONGITUDE)) == {("e70", "CS002", 2, "X")}


def test_few_events_are_left_alone() -> None:
    change = np.ones((ANTENNAS, EVENTS))
    change[:, 3] = 10.0
    assert find_anomalous_spectra(campaign(change, FEWEST_EVENTS - 1), LONGITUDE) == {}
