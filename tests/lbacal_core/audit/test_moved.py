"""Antennas that change places are told with the dates and put back; steps and drifts that only look so are not."""

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.audit.moved import find_moved
from lbacal_core.audit.record import put_right
from lbacal_core.audit.station import split_stations
from lbacal_core.simulation.simulation import Simulation
from tests.lbacal_core.audit.conftest import make_spectra

GAINS = np.array([0.0, 0.06, -0.05, 0.02, 0.0, -0.03])
"""ln of the gain of each antenna, which the station of these tests has alike."""
FIRST, YEAR_S, EVENTS = 1.3886e9, 31_557_600.0, 240


@pytest.fixture
def known(low_band):
    return replace(low_band, antenna="hamaker")


@pytest.fixture
def year(known):
    """A year of antennas whose gains differ by some per cent, and scatter by 3 % from event to event."""
    spectra = make_spectra(known, FIRST + YEAR_S * np.sort(np.random.default_rng(2).uniform(size=EVENTS)))
    scatter = 0.03 * np.random.default_rng(3).standard_normal(len(spectra))
    return replace(spectra, power=spectra.power * np.exp(GAINS[spectra.antenna] + scatter)[:, None])


def recable(spectra, circle, since, until=np.inf, dipole=None):
    """Spectra in which each of some antennas is recorded as the one before it in a part of the year."""
    part = (spectra.time_unix - FIRST) / YEAR_S
    is_moved = (part >= since) & (part < until) & (dipole is None or spectra.dipole == dipole)
    recorded = dict(zip((*circle[1:], circle[0]), circle, strict=True))
    moved = np.array([recorded.get(one, one) for one in spectra.antenna.tolist()])
    return replace(spectra, antenna=np.where(is_moved, moved, spectra.antenna))


def moved(spectra, instrument):
    (station,) = split_stations(spectra, instrument)
    return find_moved(station)


@pytest.mark.parametrize(
    ("circle", "since", "until", "dipole", "told"),
    [
        ((1, 2), 0.5, np.inf, None, "antennas 1 and 2 change places since a date between 2014-"),
        ((1, 2), 0.07, np.inf, None, "antennas 1 and 2 change places since a date between 2014-"),
        ((1, 2), 0.4, 0.65, None, "antennas 1 and 2 change places since a date between 2014-"),
        ((1, 2, 5), 0.6, np.inf, None, "antennas 1, 2 and 5 change places since a date between 2014-"),
        ((1, 2), 0.5, np.inf, "Y", "Y of antennas 1 and 2 change places since a date between 2014-"),
    ],
)
def test_antennas_that_change_places_are_told_with_the_dates_and_put_back(
    year, known, circle, since, until, dipole, told
):
    wrong = recable(year, circle, since, until, dipole)
    (line,) = moved(wrong, known)
    assert line.sentence.startswith(told)
    assert (line.antennas, line.dipole) == (circle, dipole)
    assert line.since_unix == pytest.approx(FIRST + since * YEAR_S, abs=0.02 * YEAR_S)
    assert (line.until_unix is None) == (until == np.inf)
    right = put_right(wrong, Simulation(known))
    (error,) = right.errors
    assert (error.cause.identifier, error.size, error.is_as_cause) == ("antenna_exchange", (1.0, None), False)
    near = np.abs((year.time_unix - FIRST) / YEAR_S - since) < 0.02
    near |= np.abs((year.time_unix - FIRST) / YEAR_S - until) < 0.02
    assert right.left_out == []
    assert list(right.spectra.antenna[~near]) == list(year.antenna[~near])


@pytest.mark.parametrize("steps", [(0.0, 0.0), (0.08, 0.0), (0.08, -0.08), (-0.11, -0.11), (0.2, -0.2), (0.0, 0.11)])
def test_steps_of_two_antennas_are_no_change_of_places(year, known, steps):
    """Antennas that differ by 0.11 step by as much in one direction, or by other amounts."""
    step = np.zeros(GAINS.size)
    step[[1, 2]] = steps
    is_late = year.time_unix > FIRST + YEAR_S / 2
    assert moved(replace(year, power=year.power * np.exp(is_late * step[year.antenna])[:, None]), known) == []


def test_seasons_that_differ_from_antenna_to_antenna_are_no_change_of_places(year, known):
    """A pair whose half years are each other's was told, and in a station of 24 antennas a dozen."""
    phase = 2.0 * np.pi * ((year.time_unix - FIRST) / YEAR_S + year.antenna / GAINS.size)
    assert moved(replace(year, power=year.power * np.exp(0.07 * np.sin(phase))[:, None]), known) == []


def test_two_antennas_of_which_one_steps_do_not_change_places(year, known):
    """Of two, the median steps as well."""
    pair = year.select(np.flatnonzero(year.antenna < 2))
    is_late = (pair.time_unix > FIRST + YEAR_S / 2) & (pair.antenna == 1)
    assert moved(replace(pair, power=pair.power * np.exp(-0.12 * is_late)[:, None]), known) == []
