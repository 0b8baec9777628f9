"""Antennas that change places are told with the date and put back; steps that only look so are not."""

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.audit.moved import find_moved
from lbacal_core.audit.record import put_right
from lbacal_core.audit.station import split_stations
from lbacal_core.simulation.simulation import Simulation

GAINS = np.array([0.0, 0.06, -0.05, 0.02, 0.0, -0.03])
"""ln of the gain of each antenna, which the station of these tests has alike."""


@pytest.fixture
def known(low_band):
    return replace(low_band, antenna="hamaker")


@pytest.fixture
def unlike(spectra):
    """Antennas whose gains differ by some per cent."""
    return replace(spectra, power=spectra.power * np.exp(GAINS[spectra.antenna])[:, None])


def recable(spectra, one, other, split):
    """Spectra of which two antennas change places from an instant on, by its number."""
    is_late = spectra.time_unix >= np.unique(spectra.time_unix)[split]
    antenna = spectra.antenna.copy()
    antenna[is_late & (spectra.antenna == one)] = other
    antenna[is_late & (spectra.antenna == other)] = one
    return replace(spectra, antenna=antenna)


def moved(spectra, instrument):
    (station,) = split_stations(spectra, instrument)
    return find_moved(station, np.arange(station.antennas.size))


def test_antennas_that_change_places_are_told_with_the_date_and_put_back(unlike, known):
    wrong = recable(unlike, 1, 2, 13)
    (line,) = moved(wrong, known)
    times = np.unique(unlike.time_unix)
    assert (line.antennas, line.verdict) == ((1, 2), "wrong")
    assert line.sentence.startswith("antennas 1 and 2 change places since a date between ")
    assert times[12] < line.since_unix < times[13]
    right = put_right(wrong, Simulation(known))
    (error,) = right.errors
    assert (error.cause.identifier, error.size, error.is_as_cause) == ("antenna_exchange", (1.0, None), False)
    assert list(right.spectra.antenna) == list(unlike.antenna)


@pytest.mark.parametrize("steps", [(0.0, 0.0), (0.08, 0.0), (0.08, -0.08), (-0.11, -0.11), (0.2, -0.2)])
def test_steps_of_two_antennas_are_no_change_of_places(unlike, known, steps):
    """Antennas that differ by 0.11 step by as much in one direction, or by other amounts."""
    is_late = unlike.time_unix >= np.unique(unlike.time_unix)[13]
    step = np.zeros(GAINS.size)
    step[[1, 2]] = steps
    power = unlike.power * np.exp(is_late * step[unlike.antenna])[:, None]
    assert moved(replace(unlike, power=power), known) == []
