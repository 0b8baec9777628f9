"""Stations that do not stand where their instrument does."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lbacal_core.audit.audit import audit
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.discovery.report import investigate
from lbacal_core.discovery.station import gather_stations
from lbacal_core.drift.events import measure_event_modes
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.antennas import AntennaRecord, Site, parse_sites
from lbacal_core.instrument.instrument import Instrument, load_instrument, parse_instrument
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.skypower.table import SkyPower, read_sky_power, write_sky_power
from lbacal_core.spectra.blocks import split_into_blocks
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import Campaign, simulate_campaign
from lbacal_twin.settings import TwinSettings

WEST, FAR = "WEST", "FAR"
EVENTS, ANTENNAS = 160, 4


@pytest.fixture(scope="module")
def instrument() -> Instrument:
    """A station where the instrument stands and one an hour and a half east of it and 16 degrees further north."""
    nu = np.linspace(30.0, 80.0, 11)
    return Instrument(
        name="two places",
        latitude_deg=20.0,
        longitude_deg=0.0,
        height_m=0.0,
        frequency_mhz=nu,
        dipole_azimuth_deg={"E": 90.0, "N": 0.0},
        antenna_gain=np.exp(-(((nu - 58.0) / 20.0) ** 2)),
        receiver_gain=1.0 + 0.3 * np.sin(nu / 9.0),
        cables={"all": np.full(nu.size, 0.5)},
        antennas=[AntennaRecord(station, number, "all") for station in (WEST, FAR) for number in range(ANTENNAS)],
        antenna="inverted-v",
        sites={FAR: Site(36.0, 22.5, 100.0)},
    )


@pytest.fixture(scope="module")
def sky(instrument: Instrument) -> SkyPower:
    return compute_sky_power(instrument)


@pytest.fixture(scope="module")
def campaign(instrument: Instrument, sky: SkyPower) -> Campaign:
    settings = TwinSettings(events_per_year=EVENTS)
    return simulate_campaign(settings, instrument, sky, np.random.default_rng(3))


@pytest.fixture(scope="module")
def spectra(campaign: Campaign) -> Spectra:
    return campaign.spectra


def test_a_station_sees_the_sky_of_its_own_latitude_at_its_own_sidereal_time(
    instrument: Instrument, sky: SkyPower
) -> None:
    there = replace(instrument, latitude_deg=36.0, longitude_deg=22.5, height_m=100.0, sites={})
    assert instrument.at_station(FAR) == there
    assert instrument.at_station(WEST) is instrument
    assert instrument.at_station(None) is instrument
    assert np.array_equal(sky.of_station(FAR).power["E"], compute_sky_power(there).power["E"])
    assert sky.of_station(WEST) is sky
    assert not np.allclose(sky.of_station(FAR).power["E"], sky.power["E"], rtol=0.02, atol=0.0)


@pytest.mark.parametrize("scope", ["antenna", "station", "array"])
def test_a_fit_of_two_places_finds_the_truth_of_both(
    scope: str, instrument: Instrument, sky: SkyPower, campaign: Campaign
) -> None:
    report = fit_calibration(campaign.spectra, instrument, sky, scope)
    assert {curve.status for curve in report.curves} == {"converged"}
    for curve in report.curves:
        assert curve.c is not None
        assert curve.c_sigma_stat is not None
        truth = [campaign.truth.curve(str(curve.dipole), station, antenna) for station, antenna in _members(curve)]
        # C of a mean path is that of the mean power gain
        expected = np.mean([one**-2.0 for one in truth], axis=0) ** -0.5
        assert np.abs(np.median((curve.c - expected) / curve.c_sigma_stat)) < 4.0
        assert np.abs(np.median(curve.c / expected - 1.0)) < 0.06


def _members(curve: CalibrationCurve) -> list[tuple[str, int]]:
    stations = [WEST, FAR] if curve.station is None else [curve.station]
    antennas = range(ANTENNAS) if curve.antenna is None else [curve.antenna]
    return [(station, antenna) for station in stations for antenna in antennas]


def test_a_fit_that_forgets_the_sites_is_refused_by_the_chain_test_of_the_far_station_alone(
    instrument: Instrument, spectra: Spectra
) -> None:
    forgetful = replace(instrument, sites={})
    curves = fit_calibration(spectra, forgetful, compute_sky_power(forgetful), "station").curves
    assert {curve.station for curve in curves if curve.status == "converged"} == {WEST}


@pytest.mark.long
def test_an_investigation_of_two_places_finds_nothing_and_one_that_forgets_them_does(
    instrument: Instrument, sky: SkyPower, spectra: Spectra
) -> None:
    stations = {station.name: station for station in gather_stations(spectra, instrument, sky)}
    time_unix = stations[FAR].conditions.time_unix
    assert np.array_equal(stations[FAR].conditions.lst_hours, local_sidereal_time(time_unix, 22.5))
    assert np.array_equal(stations[WEST].conditions.lst_hours, local_sidereal_time(time_unix, 0.0))
    told, _ = investigate(spectra, instrument, sky)
    assert [(one["station"], one["verdict"]) for one in told["stations"]] == [(FAR, "consistent"), (WEST, "consistent")]


def test_drift_of_a_far_station_is_measured_against_its_own_sky(
    instrument: Instrument, sky: SkyPower, spectra: Spectra
) -> None:
    curves = fit_calibration(spectra, instrument, sky).curves
    blocks = [block for block in split_into_blocks(spectra) if (block.station, block.dipole) == (FAR, "E")]
    own = {int(c.antenna or 0): c for c in curves if (c.station, c.dipole) == (FAR, "E")}
    with_site, without = (
        np.nanstd(measure_event_modes(blocks[0], own, one, sky).ln_c[..., 0])
        for one in (instrument, replace(instrument, sites={}))
    )
    assert with_site < 0.8 * without


@pytest.mark.long
def test_the_audit_takes_each_station_where_it_stands(instrument: Instrument, spectra: Spectra) -> None:
    assert [(line.station, line.sentence) for line in audit(spectra, instrument).lines if line.verdict == "wrong"] == []
    forgetful = audit(spectra, replace(instrument, sites={}))
    assert {line.station for line in forgetful.lines if line.verdict == "wrong"} == {FAR}


def test_files_of_instrument_and_sky_power_keep_the_sites(
    instrument: Instrument, sky: SkyPower, tmp_path: Path
) -> None:
    (tmp_path / "I.json").write_text(json.dumps(instrument.as_dict()))
    read = load_instrument(str(tmp_path / "I.json"))
    assert read.sites == instrument.sites
    assert read.digest() == instrument.digest()
    write_sky_power(sky, tmp_path / "P.json")
    again = read_sky_power(tmp_path / "P.json")
    again.require_made_for(instrument)
    assert np.array_equal(again.of_station(FAR).power["N"], sky.of_station(FAR).power["N"])
    moved = replace(instrument, sites={FAR: Site(37.0, 22.5, 100.0)})
    with pytest.raises(BadInputError, match="compute the sky power again"):
        again.require_made_for(moved)


def test_a_refit_of_a_station_hashes_its_own_site_and_no_other(instrument: Instrument, sky: SkyPower) -> None:
    moved = replace(instrument, sites={FAR: Site(36.0, 23.0, 100.0)})
    assert moved.digest_of(0.0, 1.0, WEST) == instrument.digest_of(0.0, 1.0, WEST)
    assert moved.digest_of(0.0, 1.0, FAR) != instrument.digest_of(0.0, 1.0, FAR)
    assert moved.digest_of(0.0, 1.0) != instrument.digest_of(0.0, 1.0)
    # the sky power of the other station is not what a station's curves are made from
    assert sky.of_station(WEST).digest() == sky.digest() != compute_sky_power(replace(instrument, sites={})).digest()


def test_a_sky_power_without_the_latitude_of_a_station_is_told(instrument: Instrument, sky: SkyPower) -> None:
    assert "stands for that of FAR" in replace(sky, stations={}, made_for=None).note_for(instrument)
    assert "stands for" not in sky.note_for(instrument)
    near = replace(instrument, sites={FAR: Site(20.0, 22.5, 0.0)})
    assert "stands for" not in compute_sky_power(near).note_for(near)
    assert compute_sky_power(near).stations == {}


@pytest.mark.parametrize(
    ("sites", "words"),
    [
        ({"NOWHERE": {"latitude_deg": 1.0, "longitude_deg": 2.0}}, "a station"),
        ({FAR: {"latitude_deg": 91.0, "longitude_deg": 2.0}}, "sites.FAR: latitude_deg: expected -90 to 90"),
        ({FAR: {"latitude_deg": 1.0}}, "sites.FAR.longitude_deg"),
        ([1.0, 2.0], "an object of latitude_deg and longitude_deg by station"),
    ],
)
def test_a_site_that_is_none_is_refused_by_name(instrument: Instrument, sites: object, words: str) -> None:
    with pytest.raises(BadInputError, match=words):
        parse_instrument(instrument.as_dict() | {"sites": sites}, "I.json")


def test_a_site_without_height_is_as_high_as_the_instrument() -> None:
    assert parse_sites({FAR: {"latitude_deg": 1, "longitude_deg": 2}}, "I.json", 40.0)[FAR].height_m == 40.0
