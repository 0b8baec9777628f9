"""Instruments that are not LOFAR, through the whole path: simulated by the twin, fitted, investigated."""

import json
from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.antenna.ideal import ShortDipole
from lbacal_core.antenna.model import zenith_gain
from lbacal_core.audit.audit import audit
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.curves.curves import CalibrationCurve, SkyOverModel, parse_curve
from lbacal_core.discovery.report import investigate
from lbacal_core.discovery.station import gather_stations
from lbacal_core.drift.events import measure_event_modes
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.antennas import AntennaRecord, Site, parse_sites
from lbacal_core.instrument.instrument import Instrument, load_instrument, parse_instrument
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.pipeline import calibrate
from lbacal_core.provenance import as_json, with_arrays
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.table import SkyPower, read_sky_power, write_sky_power
from lbacal_core.spectra.blocks import split_into_blocks
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import Campaign, simulate_campaign
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.hardware import GainStep
from lbacal_twin.settings import TwinSettings
from tests import short_dipole
from validation.anywhere import draw_instrument

SETTINGS = TwinSettings(events_per_year=300)
TABLES = ("gain", "noise_k")


def make_instrument(arms, frequency_mhz, latitude_deg, *, antennas, tilts=None, receiver_gain=None) -> Instrument:
    flat = np.ones(frequency_mhz.size)
    return Instrument(
        name="somewhere",
        latitude_deg=latitude_deg,
        longitude_deg=21.4,
        height_m=1000.0,
        frequency_mhz=frequency_mhz,
        dipole_azimuth_deg=arms,
        antenna_gain=flat,
        receiver_gain=flat if receiver_gain is None else receiver_gain,
        cables={"long": 0.5 * flat},
        antennas=tuple(AntennaRecord("S1", number, "long") for number in range(antennas)),
        antenna="short-dipole",
        dipole_tilt_deg=tilts or {},
    )


ONE_ARM = make_instrument({"A": -6.0}, np.arange(50.0, 90.0), -26.7, antennas=1)
THREE_ARMS = make_instrument(
    {"EW": 90.0, "NS": 0.0, "UP": 0.0}, np.arange(50.0, 84.0, 1.0), 40.9, antennas=4, tilts={"UP": 90.0}
)


def pulls_of(report, truth):
    of_curves = ((curve, truth.curve(curve.dipole, curve.station, curve.antenna)) for curve in report.curves)
    return np.array([(curve.c - c) / curve.c_sigma_stat for curve, c in of_curves])


@pytest.fixture(scope="module")
def one_arm():
    sky = compute_sky_power(ONE_ARM)
    return sky, simulate_campaign(SETTINGS, ONE_ARM, sky, np.random.default_rng(1))


def test_one_arm_in_the_south_is_calibrated_and_found_consistent(one_arm):
    """EDGES and MIST have one dipole: an instrument had to have X and Y."""
    sky, campaign = one_arm
    report = calibrate(campaign.spectra, Simulation(ONE_ARM))
    assert [(curve.dipole, curve.status) for curve in report.curves] == [("A", "converged")]
    # one curve, whose channels move together
    assert np.sqrt(np.nanmean(pulls_of(report, campaign.truth) ** 2)) < 3.0
    found, _ = investigate(campaign.spectra, Simulation(ONE_ARM, sky))
    assert found["verdict"] == "consistent"
    why = {one["cause"]: one["why"] for one in found["unidentifiable"]}
    assert why["dipole_swap"] == "the instrument has one dipole"
    json.dumps(found, allow_nan=False)


@pytest.mark.long
def test_three_arms_one_upright_are_calibrated_and_a_step_of_one_is_named():
    """GRAND has three: two level arms and one upright."""
    sky = compute_sky_power(THREE_ARMS)
    step = GainStep(size=0.1, where=Where(antennas=(2,), dipoles=("UP",)), date="2014-08-07")
    clean = simulate_campaign(SETTINGS, THREE_ARMS, sky, np.random.default_rng(2))
    report = calibrate(clean.spectra, Simulation(THREE_ARMS))
    assert [curve.dipole for curve in report.curves[:3]] == ["EW", "NS", "UP"]
    assert {curve.status for curve in report.curves} == {"converged"}
    # 12 curves of one station, which share its gain of events
    assert np.sqrt(np.nanmean(pulls_of(report, clean.truth) ** 2)) < 1.8
    spoiled = simulate_campaign(SETTINGS, THREE_ARMS, sky, np.random.default_rng(2), [step])
    found, _ = investigate(spoiled.spectra, Simulation(THREE_ARMS, sky))
    assert [one["cause"] for one in found["findings"]] == ["gain_step"]
    assert found["findings"][0]["where"]["dipoles"] == ["UP"]
    assert found["findings"][0]["where"]["antennas"] == [2]
    json.dumps(found, allow_nan=False)


def test_a_letter_that_the_instrument_does_not_have_is_named(one_arm):
    sky, campaign = one_arm
    other = replace(campaign.spectra, dipole=np.full(len(campaign.spectra), "B"))
    with pytest.raises(BadInputError, match=r"row 0: expected a dipole of instrument somewhere \(A\), found 'B'"):
        calibrate(other, Simulation(ONE_ARM))
    with pytest.raises(BadInputError, match=r"P_sky of each dipole of instrument somewhere .*found no EW, NS, UP"):
        sky.require_made_for(THREE_ARMS)


@pytest.mark.parametrize("seed", [1, 7])
def test_an_instrument_drawn_anywhere_is_investigated_and_found_consistent(seed):
    rng = np.random.default_rng([17, seed])
    drawn = draw_instrument(rng)
    few = np.linspace(0, drawn.frequency_mhz.size - 1, 16).astype(int)  # minutes with 200 channels
    drawn = replace(
        drawn,
        frequency_mhz=drawn.frequency_mhz[few],
        antenna_gain=drawn.antenna_gain[few],
        receiver_gain=drawn.receiver_gain[few],
        cables={name: loss[few] for name, loss in drawn.cables.items()},
        stages=tuple(
            replace(stage, **{name: None if (table := getattr(stage, name)) is None else table[few] for name in TABLES})
            for stage in drawn.stages
        ),
    )
    sky = compute_sky_power(drawn)
    spectra = simulate_campaign(TwinSettings(events_per_year=200), drawn, sky, rng).spectra
    report, _ = investigate(spectra, Simulation(drawn, sky))
    assert report["verdict"] == "consistent"
    json.dumps(report, allow_nan=False)


def test_daily_means_at_one_sidereal_time_are_not_identifiable_and_no_traceback():
    """82 days of one dipole ended in `cannot reshape array of size 0`: no table and no report."""
    instrument = short_dipole.make_instrument(79.4, -90.8)
    report = calibrate(short_dipole.daily_means(instrument, np.random.default_rng(1)), Simulation(instrument))
    (curve,) = report.curves
    assert (curve.status, curve.events, curve.lst_coverage) == ("not_identifiable", 82, 4 / 96)
    assert '"status": "not_identifiable"' in json.dumps(report.as_dict(), allow_nan=False)


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


def test_a_station_sees_the_sky_of_its_own_latitude_at_its_own_sidereal_time(instrument, sky):
    there = replace(instrument, latitude_deg=36.0, longitude_deg=22.5, height_m=100.0, sites={})
    assert instrument.at_station(FAR) == there
    assert instrument.at_station(WEST) is instrument
    assert instrument.at_station(None) is instrument
    assert np.array_equal(sky.of_station(FAR).power["E"], compute_sky_power(there).power["E"])
    assert sky.of_station(WEST) is sky
    assert not np.allclose(sky.of_station(FAR).power["E"], sky.power["E"], rtol=0.02, atol=0.0)


@pytest.mark.parametrize("scope", ["antenna", "station", "array"])
def test_a_fit_of_two_places_finds_the_truth_of_both(scope, instrument, sky, campaign):
    report = fit_calibration(campaign.spectra, Simulation(instrument, sky), scope)
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


def test_a_fit_that_forgets_the_sites_is_refused_by_the_chain_test_of_the_far_station_alone(instrument, spectra):
    forgetful = replace(instrument, sites={})
    curves = fit_calibration(spectra, Simulation(forgetful, compute_sky_power(forgetful)), "station").curves
    assert {curve.station for curve in curves if curve.status == "converged"} == {WEST}


@pytest.mark.long
def test_an_investigation_of_two_places_finds_nothing_and_one_that_forgets_them_does(instrument, sky, spectra):
    stations = {station.name: station for station in gather_stations(spectra, Simulation(instrument, sky))}
    time_unix = stations[FAR].conditions.time_unix
    assert np.array_equal(stations[FAR].conditions.lst_hours, local_sidereal_time(time_unix, 22.5))
    assert np.array_equal(stations[WEST].conditions.lst_hours, local_sidereal_time(time_unix, 0.0))
    told, _ = investigate(spectra, Simulation(instrument, sky))
    assert [(one["station"], one["verdict"]) for one in told["stations"]] == [(FAR, "consistent"), (WEST, "consistent")]


def test_drift_of_a_far_station_is_measured_against_its_own_sky(instrument, sky, spectra):
    curves = fit_calibration(spectra, Simulation(instrument, sky)).curves
    blocks = [block for block in split_into_blocks(spectra) if (block.station, block.dipole) == (FAR, "E")]
    own = {int(c.antenna or 0): c for c in curves if (c.station, c.dipole) == (FAR, "E")}
    with_site, without = (
        np.nanstd(measure_event_modes(blocks[0], own, Simulation(one)).ln_c[..., 0])
        for one in (instrument, replace(instrument, sites={}))
    )
    assert with_site < 0.8 * without


@pytest.mark.long
def test_the_audit_takes_each_station_where_it_stands(instrument, spectra):
    assert [(line.station, line.sentence) for line in audit(spectra, instrument).lines if line.verdict == "wrong"] == []
    forgetful = audit(spectra, replace(instrument, sites={}))
    assert {line.station for line in forgetful.lines if line.verdict == "wrong"} == {FAR}


def test_files_of_instrument_and_sky_power_keep_the_sites(instrument, sky, tmp_path):
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


def test_a_refit_of_a_station_hashes_its_own_site_and_no_other(instrument, sky):
    moved = replace(instrument, sites={FAR: Site(36.0, 23.0, 100.0)})
    assert moved.digest_of(0.0, 1.0, WEST) == instrument.digest_of(0.0, 1.0, WEST)
    assert moved.digest_of(0.0, 1.0, FAR) != instrument.digest_of(0.0, 1.0, FAR)
    assert moved.digest_of(0.0, 1.0) != instrument.digest_of(0.0, 1.0)
    # the sky power of the other station is not what a station's curves are made from
    assert sky.of_station(WEST).digest() == sky.digest() != compute_sky_power(replace(instrument, sites={})).digest()


def test_a_sky_power_without_the_latitude_of_a_station_is_told(instrument, sky):
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
def test_a_site_that_is_none_is_refused_by_name(instrument, sites, words):
    with pytest.raises(BadInputError, match=words):
        parse_instrument(instrument.as_dict() | {"sites": sites}, "I.json")
    no_height = parse_sites({FAR: {"latitude_deg": 1, "longitude_deg": 2}}, "I.json", 40.0)
    assert no_height[FAR].height_m == 40.0, "it is as high as the instrument"


NU = np.arange(50.0, 90.0, 2.0)


def make_content():
    return {
        "name": "in kelvin", "latitude_deg": -26.7, "longitude_deg": 116.6, "height_m": 300,
        "frequency_mhz": NU.tolist(), "dipoles": {"A": {"azimuth_deg": 85}}, "antenna": "short-dipole",
        "antenna_gain": zenith_gain(ShortDipole(1.5), NU).tolist(),
        "antenna_gain_provenance": {"kind": "absolute", "source": "analytic"}, "calibrated_in_kelvin": {"error": 0.01},
        "receiver_gain": [1.0] * NU.size, "cables": {"none": [1.0] * NU.size},
        "antennas": [{"station": "S1", "antenna": number, "cable": "none"} for number in range(4)],
    }  # fmt: skip


def test_a_sky_that_is_brighter_than_the_model_is_measured_and_c_is_known():
    instrument = parse_instrument(make_content(), "in kelvin")
    sky = compute_sky_power(instrument)
    brighter = SkyPower(NU, sky.lst_hours, {"A": 1.1 * sky.power["A"]}, "brighter")
    campaign = simulate_campaign(TwinSettings(events_per_year=300), instrument, brighter, np.random.default_rng(8))
    kelvin = campaign.spectra.power
    assert 300 < np.median(kelvin[:, 0]) < 50_000, "temperatures, at 50 MHz"
    report = fit_calibration(campaign.spectra, Simulation(instrument, sky))
    levels = [curve.sky_over_model for curve in report.curves]
    pulls = [(one.mean / 1.1 - 1.0) / np.hypot(one.mean_sigma_stat / one.mean, one.sigma_laboratory) for one in levels]
    assert np.sqrt(np.mean(np.square(pulls))) < 2.0
    assert all(one.mean_sigma_stat < 0.03 for one in levels)
    truth = [campaign.truth.curve("A", "S1", number) for number in range(4)]
    assert all(abs(one.c / c - 1.0).max() < 4 * one.c_sigma / one.c for one, c in zip(levels, truth, strict=True))
    content = json.loads(json.dumps(report.curves[0].as_dict(), allow_nan=False))
    assert parse_curve(content).as_dict() == report.curves[0].as_dict()
    assert "of the model" in str(levels[0])


def test_the_error_of_the_mean_takes_correlations_along_frequency_whole():
    alone = SkyOverModel.of(np.full(4, 3.7157e-9), 1e-4 * np.eye(4), 0.01)
    together = SkyOverModel.of(np.full(4, 3.7157e-9), np.full((4, 4), 1e-4), 0.01)
    assert together.mean == pytest.approx(1.0, rel=1e-4)
    assert together.mean_sigma_stat == pytest.approx(0.02, rel=1e-3)
    assert alone.mean_sigma_stat == pytest.approx(0.01, rel=1e-3)


def test_a_channel_without_c_counts_for_nothing_and_is_null():
    level = SkyOverModel.of(np.array([np.nan, 3.7157e-9]), 1e-4 * np.eye(2), 0.01)
    content = json.loads(json.dumps(as_json(level), allow_nan=False))
    assert content["ratio"][0] is None
    assert level.mean == pytest.approx(1.0, rel=1e-4)
    assert as_json(SkyOverModel(**with_arrays(content))) == content


def test_the_doubt_about_an_antenna_is_a_probability_that_is_kept():
    given = parse_instrument(make_content() | {"antenna_doubt": 0.001}, "measured")
    assert given.antenna_doubt == 0.001
    assert parse_instrument(given.as_dict(), "again").digest() == given.digest()
    for wrong in (1.0, -0.1):
        with pytest.raises(BadInputError, match=r"antenna_doubt: expected a probability, 0 to below 1, found"):
            parse_instrument(make_content() | {"antenna_doubt": wrong}, "measured")


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("calibrated_in_kelvin", {"error": 0}, "a fraction of the power, 0 to 1, found 0.0"),
        ("calibrated_in_kelvin", True, "an object with error, found bool"),
        ("antenna_gain_provenance", None, "to refer kelvin to the sky, found kelvin beside one that is not said to be"),
    ],
)
def test_kelvin_need_an_error_and_square_metres(field, value, message):
    with pytest.raises(BadInputError, match=message):
        parse_instrument(make_content() | {field: value}, "in kelvin")
