"""Arms and letters against real data: one LOFAR station, one frequency, one integration (tests/data/rs509)."""

from __future__ import annotations

import calendar
import csv
import hashlib
from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.antenna.names import load_antenna
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.traces.trace import name_dipole
from validation.cross_correlations import SUN, StationCorrelations, arm_ratio, expected_arm_ratio

SOURCES = ("cas-a", "cyg-a", "tau-a", SUN)
SHA256 = "534532fdedcd1e01d0c95addf3398ef4b5f41aa5ff0d532955ef6207eca6e989"
EVEN = 2 * np.arange(48)


@pytest.fixture(scope="module")
def antennas(repository):
    lines = (repository / "tests/data/rs509/antennas.csv").read_text().splitlines()
    return list(csv.DictReader(line for line in lines if not line.startswith("#")))


@pytest.fixture(scope="module")
def is_inner(antennas):
    return np.array([row["field"] == "inner" for row in antennas])


@pytest.fixture(scope="module")
def station(repository, antennas):
    raw = (repository / "tests/data/rs509/20170621_072634_sb350_xst.dat").read_bytes()
    assert hashlib.sha256(raw).hexdigest() == SHA256
    gains = [
        complex(float(row[f"gain_{parity}_re"]), float(row[f"gain_{parity}_im"]))
        for row in antennas
        for parity in ("even", "odd")
    ]
    return StationCorrelations(
        matrix=np.frombuffer(raw, dtype=np.complex128).reshape(96, 96),
        gains=np.array(gains),
        offsets_m=np.array([[float(row[axis]) for axis in ("x_m", "y_m", "z_m")] for row in antennas]),
        centre_m=np.array([3783579.17465, 450178.835035, 5097830.807]),
        frequency_mhz=350 * 100.0 / 512,
        time_unix=float(calendar.timegm((2017, 6, 21, 7, 26, 34))),
    )


@pytest.fixture(scope="module")
def receivers(is_inner):
    """Two sets of receivers with parallel arms: inner even ones with outer odd ones, and the rest."""
    return EVEN + ~is_inner, EVEN + is_inner


def test_every_outer_antenna_has_its_letters_exchanged_by_parity_against_the_inner_ones(station, is_inner):
    share = station.same_parity_share(is_inner)
    assert station.works.sum() == 47
    assert np.nanmin(share[is_inner]) > 0.85  # 0.86 to 0.99: parallel arms share much more of the sky
    assert np.nanmax(share[~is_inner]) < 0.16  # 0.04 to 0.15
    assert np.nanmedian(share[is_inner]) == pytest.approx(0.924, abs=0.002)
    assert np.nanmedian(share[~is_inner]) == pytest.approx(0.053, abs=0.002)


def test_the_sky_of_four_sources_fits_with_the_exchange_and_not_by_parity(station, receivers):
    for one in receivers:
        assert station.fit_sources(one, SOURCES).explained == pytest.approx(0.70, abs=0.01)
    for one in (EVEN, EVEN + 1):
        assert station.fit_sources(one, SOURCES).explained < 0.37
    assert station.fit_sources(receivers[0], SOURCES).baselines == 806


def test_even_receivers_of_the_inner_field_are_the_arm_from_north_east_to_south_west(station, receivers):
    """(Cyg A / Cas A) of one set over that of the other: fluxes and gains cancel, the azimuths of the arms remain."""
    found, sigma = arm_ratio(station, *receivers, SOURCES)
    assert found == pytest.approx(1.71, abs=0.02)
    assert sigma == pytest.approx(0.10, abs=0.02)
    model = load_antenna("hamaker")
    as_named, reverse = (expected_arm_ratio(station, model, arms, SOURCES) for arms in ((45.0, 135.0), (135.0, 45.0)))
    assert as_named == pytest.approx(1.83, abs=0.01)
    assert reverse == pytest.approx(0.55, abs=0.01)
    assert abs(found - as_named) < 2 * sigma
    assert abs(found - reverse) > 8 * sigma


def test_the_sun_agrees_although_it_says_little(station, receivers):
    """It stands nearly where both arms receive alike: 1.10 expected, 0.91 for the reverse."""
    sources = ("cas-a", SUN, "cyg-a", "tau-a")
    found, sigma = arm_ratio(station, *receivers, sources)
    assert abs(found - expected_arm_ratio(station, load_antenna("hamaker"), (45.0, 135.0), sources)) < 2 * sigma


def test_the_letters_of_traces_and_the_arms_of_the_superterp_are_those_of_the_station(receivers):
    arms = load_instrument("lofar-superterp").dipole_azimuth_deg
    assert (arms["X"], arms["Y"]) == (45.0, 135.0)
    for letter, rcus in zip("XY", receivers, strict=True):
        assert {name_dipole(int(rcu), "LBA_SPARSE_EVEN") for rcu in rcus} == {letter}


def test_directions_agree_with_astropy_to_two_hundredths_of_a_degree(station):
    """AltAz of astropy 8 for the centre of the field; nutation and aberration are left out here."""
    expected = {"cas-a": (68.948, 299.970), "cyg-a": (32.649, 296.0), "tau-a": (37.727, 104.285), SUN: (35.164, 97.634)}
    for source, (altitude, azimuth) in expected.items():
        zenith, found = np.degrees(station.direction(source))
        assert 90 - zenith == pytest.approx(altitude, abs=0.02)
        assert found == pytest.approx(azimuth, abs=0.02)


def test_an_ideal_station_gives_back_the_powers_that_were_put_in(station):
    """Point sources without noise, and an outer field whose receivers are exchanged."""
    powers = {"cas-a": 3.0, "cyg-a": 1.5, "tau-a": 0.2, SUN: 0.5}
    phases = np.stack([station.phases(source) for source in powers])
    seen = np.einsum("s,si,sj->ij", np.array(list(powers.values())), phases, phases.conj()) + 10 * np.eye(48)
    matrix = np.kron(seen, np.eye(2))
    ideal = replace(station, matrix=matrix, gains=np.ones(96, dtype=complex))
    fit = ideal.fit_sources(EVEN, tuple(powers))
    assert fit.powers == pytest.approx(powers, rel=1e-9)
    assert fit.explained == pytest.approx(1.0)
    assert ideal.same_parity_share(np.ones(48, dtype=bool)) == pytest.approx(1.0)
    order = np.arange(96)
    order[[90, 91]] = order[[91, 90]]
    swapped = replace(ideal, matrix=matrix[np.ix_(order, order)])
    assert swapped.same_parity_share(np.arange(48) < 40)[45] == pytest.approx(0.0)


def test_a_matrix_of_another_size_is_refused(station):
    with pytest.raises(BadInputError, match="96 x 96"):
        replace(station, matrix=station.matrix[:4, :4])
