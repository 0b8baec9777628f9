"""The record put right is the true one, whatever was wrong with it."""

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.audit.record import NOT_NAMED, _correct, name_mistake, put_right
from lbacal_core.audit.sky_match import is_summer_time
from lbacal_core.audit.verdict import Line
from lbacal_core.simulation.simulation import Simulation
from tests.lbacal_core.audit.conftest import make_spectra
from tests.lbacal_core.audit.test_audit import exchange, kill


@pytest.fixture(scope="module")
def known(low_band):
    return replace(low_band, antenna="hamaker")


@pytest.mark.long
def test_nothing_is_put_right_where_nothing_is_wrong(spectra, known):
    assert put_right(spectra, Simulation(known)) is None
    assert name_mistake(spectra, Simulation(known)) == NOT_NAMED


@pytest.mark.long
@pytest.mark.parametrize("chosen", [(1,), (0, 1, 2, 3, 4, 5)])
def test_exchanged_letters_are_exchanged_back(spectra, known, chosen):
    wrong = exchange(spectra, np.isin(spectra.antenna, chosen))
    right = put_right(wrong, Simulation(known))
    (error,) = right.errors
    assert (error.cause.identifier, error.size) == ("dipole_swap", (1.0, None))
    assert list(right.spectra.dipole) == list(spectra.dipole)
    assert list(right.as_recorded.dipole) == list(wrong.dipole)
    assert right.simulation.instrument is known
    assert error.sentence.startswith("In station CS002, X and Y are exchanged at ")
    assert "(ln odds +" in error.sentence


def test_letters_exchanged_until_a_date_are_exchanged_back_until_then(spectra, known):
    times = np.unique(spectra.time_unix)
    right = put_right(exchange(spectra, (spectra.antenna == 1) & (spectra.time_unix < times[11])), Simulation(known))
    assert [one.label for one in right.errors] == ["antennas 1"]
    assert list(right.spectra.dipole) == list(spectra.dipole)


def test_copied_spectra_are_left_out_for_as_long_as_they_are_copies(spectra, known):
    times = np.unique(spectra.time_unix)
    own, other = ((spectra.antenna == a) & (spectra.dipole == "X") for a in np.unique(spectra.antenna)[:2])
    is_late, power = spectra.time_unix > times[10], spectra.power.copy()
    power[own & is_late] = power[other & is_late]
    right = put_right(replace(spectra, power=power), Simulation(known))
    assert right.errors == []
    assert set(right.spectra.time_unix[right.spectra.antenna == spectra.antenna[own][0]]) == set(times)
    assert len(spectra) - len(right.spectra) == 2 * np.sum(own & is_late)


def test_a_clock_that_is_off_is_set_by_its_size(spectra, known):
    late = replace(spectra, time_unix=spectra.time_unix + 5 * 3600.0)
    right = put_right(late, Simulation(known))
    (error,) = right.errors
    value, sigma = error.size
    assert (error.cause.identifier, value) == ("lst_offset", pytest.approx(-5.0, abs=4 * sigma))
    assert name_mistake(late, Simulation(known)) == error.sentence
    left_h = (right.spectra.time_unix - spectra.time_unix) / 3600.0
    assert np.abs(left_h).max() < 4 * sigma


@pytest.mark.long
@pytest.mark.parametrize("zone_h", [0.0, 1.0])
def test_local_time_with_summer_time_is_no_clock_of_one_value(known, zone_h):
    """A year of it was told as a clock that is 87 +- 3 min ahead."""
    year = np.linspace(1.3886e9, 1.42e9, 300)
    spectra = make_spectra(known, year)
    gain = np.random.default_rng(2).normal(1.0, 0.05, (len(spectra), 1))
    spectra = replace(spectra, power=gain * spectra.power)
    late = replace(spectra, time_unix=spectra.time_unix + 3600.0 * (zone_h + is_summer_time(spectra.time_unix)))
    right = put_right(late, Simulation(known))
    (error,) = right.errors
    value, sigma = error.size
    assert (error.cause.identifier, value) == ("lst_offset", pytest.approx(-zone_h - 1.0, abs=4 * sigma))
    assert error.line.seasons_h == (value, pytest.approx(-zone_h, abs=4 * sigma))
    assert f"sidereal time is {60 * value:+.0f} +- {60 * sigma:.0f} min in Europe's summer time" in error.sentence
    assert "local time with summer time?" in error.sentence
    assert np.abs(right.spectra.time_unix - spectra.time_unix).max() / 3600.0 < 4 * sigma
    zone = put_right(replace(spectra, time_unix=spectra.time_unix + 7200.0), Simulation(known))
    assert "summer" not in zone.errors[0].sentence


def test_a_clock_that_is_off_for_a_month_is_told_with_the_month_and_put_right(known):
    """Nothing described such a year: the audit found nothing wrong, and an investigation named two steps of gain."""
    rng, edges = np.random.default_rng(4), np.array(["2014-04-01", "2014-05-01"], dtype="datetime64[s]").astype(float)
    year = np.sort(rng.uniform(1.3886e9, 1.42e9, 400))
    spectra = make_spectra(known, year)
    spectra = replace(spectra, power=rng.normal(1.0, 0.02, (len(spectra), 1)) * spectra.power)
    is_off = (spectra.time_unix >= edges[0]) & (spectra.time_unix < edges[1])
    early = replace(spectra, time_unix=spectra.time_unix - 10_800.0 * is_off)
    right = put_right(early, Simulation(known))
    (error,) = right.errors
    value, sigma = error.size
    assert (error.cause.identifier, value) == ("lst_offset", pytest.approx(3.0, abs=4 * sigma))
    assert (error.line.since_unix, error.line.until_unix) == tuple(edges)
    assert not error.is_as_cause
    assert "from 2014-04-01 to 2014-05-01 sidereal time is +1" in error.sentence
    left = np.abs(right.spectra.time_unix[:, None] - spectra.time_unix).min(axis=1)
    assert left.max() < 4 * sigma * 3600.0
    assert 0 < len(spectra) - len(right.spectra) < 0.03 * len(spectra), "whose clock at the ends is that of nobody"


@pytest.mark.long
def test_arms_are_turned_and_a_place_is_moved_back(spectra, known):
    turned = replace(known, dipole_azimuth_deg={name: one + 40.0 for name, one in known.dipole_azimuth_deg.items()})
    right = put_right(replace(spectra, arms_deg=turned.dipole_azimuth_deg), Simulation(turned))
    assert right.spectra.arms_deg == {}  # the recorder said so as well
    (error,) = right.errors
    value, sigma = error.size
    assert (error.cause.identifier, value) == ("dipole_azimuth", pytest.approx(-40.0, abs=4 * sigma))
    arms = right.simulation.instrument.dipole_azimuth_deg
    assert arms == {name: pytest.approx(one, abs=4 * sigma) for name, one in known.dipole_azimuth_deg.items()}
    arms = known.dipole_azimuth_deg
    one_arm = replace(known, dipole_azimuth_deg={**arms, "Y": arms["Y"] + 40.0})
    right = put_right(spectra, Simulation(one_arm))
    (error,) = right.errors
    corrected = right.simulation.instrument.dipole_azimuth_deg
    assert corrected == {"X": arms["X"], "Y": pytest.approx(arms["Y"], abs=4 * error.line.sigma)}
    south = replace(known, latitude_deg=-known.latitude_deg)
    right = put_right(spectra, Simulation(south))
    assert [one.cause.identifier for one in right.errors] == ["site"]
    assert right.simulation.instrument.latitude_deg == known.latitude_deg
    assert right.simulation.given is None


def test_arms_that_are_turned_back_over_north_stay_within_a_turn(spectra, known):
    line = Line("arms", "wrong", "CS002", "", value=50.0)
    wrong = replace(known, dipole_azimuth_deg={"X": 20.0, "Y": 330.0})
    assert _correct(spectra, wrong, line)[1].dipole_azimuth_deg == {"X": 70.0, "Y": 20.0}


def test_a_latitude_that_is_off_is_moved_back(spectra, known):
    right = put_right(spectra, Simulation(replace(known, latitude_deg=known.latitude_deg - 15.0)))
    (error,) = right.errors
    assert (error.cause.identifier, error.size) == ("site", (1.0, None))
    assert right.simulation.instrument.latitude_deg == pytest.approx(known.latitude_deg, abs=3.0 * error.line.sigma)


def test_a_path_that_does_not_work_is_left_out(spectra, known):
    dead = (spectra.antenna == 4) & (spectra.dipole == "X")
    right = put_right(kill(spectra, dead), Simulation(known))
    assert right.errors == []
    assert [(one.antennas, one.dipole) for one in right.left_out] == [((4,), "X")]
    assert len(right.spectra) == np.sum(~dead)
