"""C that goes on changing is right on every date of a year: a ramp and a season that the night finds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from lbacal.instants import format_instant, parse_instant
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.sky.table import read_sky_power
from lbacal_twin.campaign import Campaign, simulate_campaign
from lbacal_twin.faults.fault import Where
from lbacal_twin.settings import START_2014, TwinSettings
from service.factory import Factory
from service.storage.changes import Change, Cut, Evidence, KeptChange
from service.storage.models import Investigation
from service.usecases.changes import propose
from service.usecases.watch import read_slow
from tests.service.conftest import night, served
from validation.moving import Moved, ask_mean

pytestmark = pytest.mark.long

RAMP = Moved(
    size=1.0, where=Where(antennas=(2,), dipoles=("Y",)), kind="ramp", date=float(START_2014), shape=(0.12, 0.03)
)
SEASON = Moved(
    size=1.0, where=Where(antennas=(5,), dipoles=("X",)), kind="season", date=float(START_2014) + 9e6, shape=(0.08,)
)
MOVED, STEADY = {RAMP: (2, "Y"), SEASON: (5, "X")}, (4, "Y")
DATES = ("2014-01-10", "2014-04-01", "2014-07-02", "2014-10-10", "2014-12-30", "2015-01-03", "2015-05-01", "2015-08-01")


@pytest.fixture(scope="module")
def campaign(superterp: Instrument, sky_power_file: Path) -> Campaign:
    """Eight antennas from 2014 to August 2015: the fit of the second year is that of its first months."""
    settings = TwinSettings(stations=("CS002",), antennas=8, years=1.6, events_per_year=400)
    sky = read_sky_power(sky_power_file)
    return simulate_campaign(settings, superterp, sky, np.random.default_rng(35), [RAMP, SEASON])


def ask(http: TestClient, path: tuple[int, str], at: str) -> dict[str, Any]:
    asked = {"station": "CS002", "antenna": path[0], "dipole": path[1], "at": at}
    (curve,) = http.get("/v1/calibrations/effective", params=asked).json()["curves"]
    return dict(curve)


def find_pull(http: TestClient, campaign: Campaign, move: Moved | None, path: tuple[int, str], at: str) -> float:
    """C in effect less the true C of a date, over its error, r.m.s. of the channels."""
    curve, truth = ask(http, path, at), campaign.truth
    c, when = np.array(curve["c"]), np.array([parse_instant("", at) / 1e6])
    gain = 0.0 if move is None else move.log_gain(when, truth.frequency_mhz)[0]
    true = truth.stations[0].c[path[0], "XY".index(path[1])] * np.exp(-0.5 * gain)
    sigma = np.hypot(np.array(curve["c_sigma_stat"]) / c, curve["factor_sigma"])
    return float(np.sqrt(np.mean((np.log(c / true) / sigma) ** 2)))


@pytest.mark.parametrize("database_url", ["sqlite", "postgresql"], indirect=True)
def test_c_follows_a_ramp_and_a_season_through_the_year(
    make_service: Callable[..., Factory], campaign: Campaign
) -> None:
    """One C was told for all of a year: 3 % off at its ends by the ramp, 4 % by the season."""
    factory = make_service(campaign.spectra, lease_s=60.0, gate_change=0.9)
    with served(factory) as http:
        night(factory)
        night(factory)
        changes = {(one["kind"], *map(path_of, one["paths"])): one for one in http.get("/v1/changes").json()["changes"]}
        found = {(move.kind, path): changes[move.kind, path] for move, path in MOVED.items()}
        assert found.keys() == {key for key in changes if key[0] != "step"}, "nothing else goes on changing"
        assert found["ramp", (2, "Y")]["size"]["value"] == pytest.approx(-0.06, abs=0.006)
        assert found["season", (5, "X")]["size"]["value"] == pytest.approx(0.04, abs=0.006)
        for move, path in (*MOVED.items(), (None, STEADY)):
            for at in DATES:
                assert find_pull(http, campaign, move, path, at) < 2.0, (move, at)
        means = [ask_mean(factory, "Y", parse_instant("", at) / 1e6) for at in ("2014-07-02", "2015-05-01")]
        (c, sigma), (later, _) = (one for one in means if one is not None)
        assert np.max(np.abs(later - c) / sigma) < 0.5, "the station's mean has no eighth of the ramp: 1.8 sigma"

        ramp, path = found["ramp", (2, "Y")], (2, "Y")
        early, late = (ask(http, path, at) for at in (DATES[0], DATES[4]))
        assert early["calibration"] == late["calibration"]
        assert f"follows change {ramp['id']} (ramp)" in early["why"]
        asked = {"station": "CS002", "antenna": 2, "dipole": "Y", "at": DATES[0], "format": "csv"}
        rows = http.get("/v1/calibrations/effective", params=asked).text
        assert f",{early['c'][0]}," in rows, "files carry the same C"
        (of_2014, _) = http.get("/v1/paths/CS002/2/Y/life").json()["in_effect"]
        told = [one["value"] for one in of_2014["factor"]]
        assert len(told) == 13
        assert told[0] / told[-1] == pytest.approx(np.exp(0.06 * 360 / 365.25), rel=0.01)
        assert "C in effect" in http.get("/paths/CS002/2/Y").text
        edges = http.get("/v1/calibrations/edges", params={"as_of": format_instant(factory.clock())}).json()["stations"]
        (of_station,) = [one["edges"] for one in edges if one["station"] == "CS002"]
        k = next(k for k, edge in enumerate(of_station) if edge > "2014-05")
        first, same, later = (
            ask(http, path, at) for at in (of_station[k], of_station[k][:10] + "T23:00", of_station[k + 1])
        )
        assert first["c"] == same["c"] != later["c"], "what is cached between two edges is what the server tells"

        for decision, is_followed in (("dismissed", False), ("in_force", True)):
            body = {"decision": decision, "reason": "test"}
            decided = http.post(f"/v1/changes/{ramp['id']}/decision", json=body)
            assert decided.status_code == 201
            of_c, of_2015 = decided.json()["changes"]
            assert (of_c["antenna"], of_c["before"], of_2015["from"][:4]) == (2, early["calibration"], "2015")
            assert of_c["max_fraction"] == pytest.approx(0.03, abs=0.01), "half a year of the ramp, and its tilt"
            curve = ask(http, path, DATES[0])
            assert curve["calibration"] == early["calibration"], "no version is made for it"
            assert (curve["c"] == early["c"]) is is_followed


def test_c_follows_what_a_person_enters(make_service: Callable[..., Factory], campaign: Campaign) -> None:
    factory = make_service(campaign.spectra.select(campaign.spectra.antenna < 4), lease_s=60.0, gate_change=0.9)
    with served(factory) as http:
        night(factory)
        body = {
            "at": {"value": "2014-02-01", "sigma_days": 5},
            "kind": "season",
            "reason": "no shade",
            "station": "CS002",
        }
        refused = http.post("/v1/changes", json=body)
        assert refused.status_code == 422
        assert "size" in refused.json()["detail"]
        before = ask(http, (1, "X"), "2014-02-01")
        assert before["factor_sigma"] == 0.0
        assert not http.post("/v1/changes", json={**body, "size": {"value": 0.1, "sigma": 0.02}}).json()["cuts_windows"]
        for at, size in (("2014-02-01", 1.1), ("2014-08-02", 1 / 1.1)):
            curve = ask(http, (1, "X"), at)
            assert curve["factor"] == pytest.approx([size] * len(curve["c"]), rel=0.005)
            assert curve["c"][0] == pytest.approx(before["c"][0] * size, rel=0.005)
            assert curve["factor_sigma"] == pytest.approx(0.02, rel=0.1)
        assert "season" in ask(http, (1, "X"), "2014-02-01")["why"]


def path_of(one: dict[str, Any]) -> tuple[int, str]:
    return one["antenna"], one["dipole"]


def test_a_season_of_the_tilt_alone_is_no_change_with_a_date() -> None:
    shape = {"tilt": {"value": 0.02, "sigma": 0.001}}
    told = {
        "station": "CS002", "antenna": 1, "dipole": "X", "is_found": False, "season_is_found": True, "season": 0.0,
        "season_sigma": 0.001, "season_shape": shape, "season_phase": 0.5, "season_significance": 9.0,
    }  # fmt: skip
    assert list(read_slow(told, 0.0)) == []
    ((change, _),) = read_slow({**told, "season": 0.01}, 0.0)
    assert (change.kind, change.tilt, change.sigma_days) == ("season", 0.02, pytest.approx(36.525 / (2.0 * np.pi)))


def test_the_drift_that_an_investigation_finds_is_proposed_as_a_ramp(instrument: Instrument) -> None:
    """It was no cause that could be adopted, and no change either."""
    where, size = {"antennas": [1], "dipoles": ["X"]}, {"value": 0.05, "sigma": 0.01}
    finding = {"cause": "gain_drift", "parameters": {}, "where": where, "size": size, "significance_sigma": 8.0}
    made = Investigation("id", "CS001", 0, 1, {}, {"findings": [finding]}, 1, "", "")
    ((change, evidence),) = propose(made, instrument)
    assert (change.kind, change.paths, change.date, evidence.source) == ("ramp", ((1, "X"),), 0, "investigation")
    assert change.size == pytest.approx(1.05**-0.5 - 1.0), "C^2 is proportional to 1 / gain"


def test_what_follows_the_season_and_is_no_gain_is_proposed_as_a_course(instrument: Instrument) -> None:
    """It is refused as a cause, since it acts along the date, and stood in no list of changes either."""
    where, size = {"antennas": [1], "dipoles": ["X"]}, {"value": 0.4, "sigma": 0.05}
    finding = {
        "cause": "resonance_shift", "parameters": {"follows": "season"}, "where": where, "size": size,
        "significance_sigma": 8.0,
    }  # fmt: skip
    made = Investigation("id", "CS001", 5, 10, {}, {"findings": [finding]}, 1, "", "")
    ((change, evidence),) = propose(made, instrument)
    assert (change.kind, change.paths, change.date, change.size) == ("course", ((1, "X"),), 5, None)
    assert evidence.source == "investigation"


def test_what_goes_on_changing_is_taken_out_of_the_means_that_it_is_in() -> None:
    """Of a station's mean what its antennas do, of the array's what whole stations do as well."""
    at, modes = START_2014 * 1_000_000, np.array([[-1.0, 0.0, 1.0], [1.0, -0.5, 1.0]])
    ramp = Change("CS002", ((2, "Y"),), "ramp", at, 0, 0.05, 0.01, 0.02, 0.0)
    season = replace(ramp, paths=(), kind="season")
    (of_path,), (of_station,) = (_in_force(one).follows for one in (ramp, season))
    assert (of_path.antenna, of_path.dipoles, of_station.antenna) == (2, ("Y",), None)
    assert _in_force(replace(ramp, size=None)).follows == _in_force(replace(ramp, station=None)).follows == []
    times = START_2014 + 365.25 * 86_400.0 * np.array([-1.0, 0.0, 2.0])
    size = np.log(1.05) + 0.02 * modes[0]
    assert of_path.log_power(times, modes, "X") == pytest.approx(np.outer([0.0, 0.0, 2.0], -2.0 * size))
    assert of_station.log_power(times, modes, "X") == pytest.approx(np.outer([1.0, 1.0, 1.0], -2.0 * size))
    assert [one.begins_before(at - 1) for one in (of_path, of_station)] == [False, True], "a season has no beginning"
    step = Cut("CS002", 2, at, ("Y",), 0.9, (0.01, 0.0))
    expected = np.outer([0.0, 1.0, 1.0], np.log(0.9) + 0.01 * modes[0])
    assert step.log_power(times, modes, "X") == pytest.approx(expected)


def _in_force(change: Change) -> KeptChange:
    return KeptChange(1, change, 0, (Evidence("drift", "", 9.0, 0),))
