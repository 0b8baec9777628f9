"""The ideal SNR of a drawn instrument against the obvious slow formula, and against what it must not see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.skypower.model import compute_sky_power
from lbacal_twin.campaign import DrawnStation, draw_stations, expected_power
from lbacal_twin.faults.antenna import GainStep
from lbacal_twin.faults.fault import Where
from lbacal_twin.settings import TwinSettings
from validation.anywhere import draw_instrument
from validation.anywhere_ideal import ideal_snr

SETTINGS = TwinSettings(events_per_year=40)
STEP = GainStep(size=0.1, where=Where(antennas=(1,)), date="2014-07-01")


@pytest.fixture(scope="module")
def station() -> DrawnStation:
    """Two antennas with few channels."""
    drawn = draw_instrument(np.random.default_rng(5))
    channels = np.arange(0, drawn.frequency_mhz.size, drawn.frequency_mhz.size // 6)
    few = replace(
        drawn,
        frequency_mhz=drawn.frequency_mhz[channels],
        antenna_gain=drawn.antenna_gain[channels],
        receiver_gain=drawn.receiver_gain[channels],
        cables={"long": drawn.cables["long"][channels]},
        antennas=tuple(AntennaRecord("S1", number, "long") for number in range(2)),
        stages=(),
    )
    rng = np.random.default_rng(6)
    return draw_stations(SETTINGS, few, compute_sky_power(few), rng)[0][0]


def test_the_ideal_snr_is_that_of_the_whole_covariance_matrix(station: DrawnStation) -> None:
    """Every event with its full covariance, every free vector written out."""
    power, stages = expected_power(station.stages, station.scene, ()), station.stages
    antennas, dipoles, events, channels = power.shape
    paths = antennas * dipoles
    block = np.kron(np.eye(paths), np.ones((channels, channels)))
    noise = SETTINGS.radiometer**2 * np.eye(paths * channels) + SETTINGS.event_gain_path**2 * block
    inverse = np.linalg.inv(noise + SETTINGS.event_gain_common**2)

    def of_events(values: np.ndarray) -> np.ndarray:
        """Relative change of every spectrum, shape (event, path and channel)."""
        wide = np.broadcast_to(values / power, power.shape).reshape(paths, events, channels)
        return np.moveaxis(wide, 0, 1).reshape(events, -1)

    slope = stages.gain * stages.antenna * stages.cable * stages.receiver
    free = []
    for path in range(paths):
        for parts in ((stages.lna_noise * slope,), (stages.rcu_noise * stages.receiver,), (stages.adc_noise,)):
            is_own = np.repeat(np.arange(paths) == path, channels)
            free.append(of_events(parts[0]) * is_own)
        for channel in range(channels):
            is_own = np.arange(paths * channels) == path * channels + channel
            free.append(of_events((stages.sky + stages.lna_noise) * slope) * is_own)
    template = of_events(expected_power(stages, station.scene, [STEP]) - power)
    weighed = [one @ inverse for one in free]
    normal = np.array([[np.sum(one * other) for other in free] for one in weighed])
    onto = np.array([np.sum(one * template) for one in weighed])
    size = np.sqrt(np.diag(normal))
    solved = np.linalg.pinv(normal / np.outer(size, size), rcond=1e-10, hermitian=True) @ (onto / size)
    expected = np.sum(template @ inverse * template) - solved @ (onto / size)
    assert ideal_snr(station, [STEP], SETTINGS) == pytest.approx(np.sqrt(expected), rel=1e-6)


def test_a_gain_that_never_changes_has_no_snr(station: DrawnStation) -> None:
    """A step before the first event is one more factor on A(nu)."""
    always = replace(STEP, date="2013-01-01")
    assert ideal_snr(station, [always], SETTINGS) < 1e-3
