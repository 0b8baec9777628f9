from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from lbacal.instants import format_instant
from lbacal_core.curves.validity import Scope
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.sky.table import read_sky_power
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.sky import LstOffset
from lbacal_twin.settings import TwinSettings
from service.factory import Factory
from service.scheduler import look_for_due_work
from service.storage.alarms import AlarmsAsked
from service.storage.models import Investigation
from service.storage.versions import Version
from service.usecases.alarms import find_named
from service.wire.bodies import ChangeBody
from tests.service.conftest import (
    Clock,
    add_spectra,
    flat_spectra,
    instant,
    like,
    new_version,
    night,
    promote,
    served,
    work,
)

DAY_S = 86_400.0

FIRST = 1_388_534_400.0
"""2014-01-01, s UTC."""
PATHS = [(station, antenna, dipole) for station in ("CS001", "CS002") for antenna in range(3) for dipole in "XY"]


def store(factory: Factory, days: range, silent: Mapping[tuple[str, int, str], int] | None = None) -> None:
    """Store an event a day of all paths, but for those that fall silent on a day."""
    ends = silent or {}
    rows = [(f"e{day}", FIRST + DAY_S * day, *path) for day in days for path in PATHS if day < ends.get(path, 10**6)]
    add_spectra(factory, flat_spectra(*rows))


def alarms(client: TestClient, **query: Any) -> list[dict[str, Any]]:
    answer = client.get("/v1/alarms", params=query)
    assert answer.status_code == 200, answer.text
    found: list[dict[str, Any]] = answer.json()["alarms"]
    return found


def test_a_path_that_falls_silent_is_an_alarm_until_it_returns(
    factory: Factory, client: TestClient, clock: Clock
) -> None:
    clock.now = instant("2014-02-10")
    store(factory, range(40), {("CS001", 1, "X"): 12})
    assert len(factory.alarms.look()) == 1
    assert factory.alarms.look() == [], "another night is no news"
    (lost,) = alarms(client)
    assert (lost["kind"], lost["scope"], lost["station"], lost["antenna"]) == ("lost_path", "antenna", "CS001", 1)
    assert lost["since"].startswith("2014-01-12")
    assert "28 more events" in lost["sentence"]
    store(factory, range(40, 42))
    factory.alarms.look()
    assert alarms(client) == []
    assert [one["state"] for one in alarms(client, state="ended")] == ["ended"]


def test_an_antenna_whose_record_has_ended_is_not_lost(
    factory: Factory, client: TestClient, instrument: Instrument, tmp_path: Path
) -> None:
    """The alarm stayed open after the instrument file said that the antenna was taken away."""
    store(factory, range(60), {("CS002", antenna, dipole): 10 for antenna in range(3) for dipole in "XY"})
    factory.alarms.look()
    assert len(alarms(client, kind="lost_path")) == 1
    content = instrument.as_dict()
    for one in content["antennas"]:
        one.update({"until": "2014-01-20T00:00:00Z"} if one["station"] == "CS002" else {})
    (tmp_path / "ended.json").write_text(json.dumps(content))
    with like(factory, instrument=str(tmp_path / "ended.json")) as other:
        other.alarms.look()
    assert alarms(client, kind="lost_path") == []


def test_paths_lost_together_are_one_alarm_and_few_missed_events_none(
    factory: Factory, client: TestClient, clock: Clock
) -> None:
    clock.now = instant("2014-02-10")
    store(factory, range(40), {("CS002", 1, "X"): 12, ("CS002", 1, "Y"): 12, ("CS001", 2, "Y"): 30})
    factory.alarms.look()
    (lost,) = alarms(client)
    assert (lost["station"], lost["antenna"]) == ("CS002", None)
    assert lost["content"]["paths"] == ["CS002/1/X", "CS002/1/Y"]


def test_the_alarm_of_a_lost_path_counted_events_that_were_flagged_and_sent_again(factory: Factory) -> None:
    store(factory, range(40), {("CS001", 1, "X"): 12})
    for day in range(20, 40):
        factory.intake.set_flag(f"e{day}", "bad", reason="corrected", by="test")
    again = [(f"new{day}", FIRST + DAY_S * day, *path) for day in range(20, 40) for path in PATHS]
    add_spectra(factory, flat_spectra(*(row for row in again if row[2:] != ("CS001", 1, "X"))))
    factory.alarms.look()
    with factory.database.read() as stores:
        (lost,) = stores.alarms.newest(AlarmsAsked(("open",), 10, kind="lost_path"), 0)
    assert lost.news.content["events_missed"] == 28


def test_data_that_stopped_coming_are_stale_unless_nobody_expects_any(
    factory: Factory, client: TestClient, clock: Clock
) -> None:
    clock.now = instant("2014-03-31")
    store(factory, range(40))
    factory.alarms.look()
    assert [one["kind"] for one in alarms(client)] == ["stale_data"]
    store(factory, range(90, 91))
    factory.alarms.look()
    assert [one["kind"] for one in alarms(client)] == ["stale_data"], "an event dated after now ended it"
    with like(factory, stale_days=0.0) as archive:
        archive.alarms.look()
    assert alarms(client) == []


def test_due_work_that_fails_is_an_alarm_at_once_and_what_somebody_asked_for_is_none(
    factory: Factory, client: TestClient
) -> None:
    store(factory, range(3))
    assert factory.due.enqueue()
    for event in client.get("/v1/events").json()["events"]:
        flag = {"flag": "bad", "reason": "test"}
        assert client.post(f"/v1/events/{event['event_id']}/flag", json=flag).status_code == 200
    work(factory)
    failed = alarms(client, kind="failed_job")
    sentences = [one["sentence"] for one in failed]
    assert any(one.startswith("refit antenna CS001 failed: no usable spectra of CS001") for one in sentences)
    body = {"scope": "antenna", "since": "2012-01-01", "until": "2013-01-01", "station": "CS001", "reason": "test"}
    assert client.post("/v1/refits", json=body).status_code == 202
    work(factory)
    factory.alarms.look()
    assert [one["sentence"] for one in alarms(client, kind="failed_job")] == sentences
    factory.due.enqueue()
    factory.alarms.look()
    assert alarms(client, kind="failed_job") == [], "nothing is left that calls for it"


def test_a_window_whose_newest_version_misfits_is_an_alarm_until_one_fits(
    factory: Factory, client: TestClient, clock: Clock
) -> None:
    path, station = Scope("CS001", 0, "X"), Scope("CS001")
    fits, misfits = (new_version(scope, "fits") for scope in (path, station)), new_version(path, "misfits")
    misfits = replace(misfits, made=clock.now, curves=tuple(one.as_misfit() for one in misfits.curves))
    with factory.database.write() as stores:
        stores.versions.add([*fits, misfits])
    factory.alarms.look()
    (told,) = alarms(client, kind="misfit")
    window = "2014-01-01 to 2015-01-01: the chain does not describe the spectra within noise and priors (misfit)"
    assert told["sentence"] == f"CS001 antenna 0 X, {window}"
    with factory.database.write() as stores:
        stores.versions.add([replace(new_version(path, "fits again"), made=clock.now + 1)])
    factory.alarms.look()
    assert alarms(client, kind="misfit") == []


def test_alarms_stand_in_metrics_in_the_status_and_on_top_of_the_overview(
    factory: Factory, client: TestClient, clock: Clock
) -> None:
    clock.now = instant("2014-02-10")
    store(factory, range(40), {("CS001", 1, "X"): 12})
    factory.alarms.look()
    metrics = client.get("/metrics").text
    assert 'lbacal_alarms{kind="lost_path",state="open"} 1.0' in metrics
    assert 'lbacal_alarms{kind="step",state="open"} 0.0' in metrics
    line = "1 open (1 lost path), 0 acknowledged; 1 new since yesterday"
    assert client.get("/v1/status").json()["alarms"]["line"] == line
    assert line in client.get("/").text
    assert "no spectrum since 2014-01-12" in client.get("/alarms").text


def test_a_step_is_raised_once_and_a_season_not_at_all(after_night: Factory) -> None:
    with served(after_night) as client:
        (step,) = alarms(client, kind="step")
        assert step["sentence"].startswith("CS002 antenna 2 Y: C changed by -6.")
        assert abs(np.datetime64(step["since"][:10]) - np.datetime64("2015-04-11")) <= np.timedelta64(3, "D")
        (proposed,) = step["content"]["proposal"]
        assert (proposed["station"], proposed["antenna"], proposed["since"]) == ("CS002", 2, step["since"])
        assert alarms(client, kind="slope") == []
        assert look_for_due_work(after_night) == []
        assert len(alarms(client, kind="step", state="all")) == 1
        assert "CS002 antenna 2 Y" in client.get("/alarms").text
        page = client.get("/stations/CS002").text
        told = re.findall(r' class="number">[+-]\d+\.\d\d ± \d+\.\d\d %</td>', page)
        assert len(told) == len(re.findall(r">antenna \d+ [XY]</a>", page)) > 0, (
            "every path has its slope and the error of it"
        )


@pytest.mark.long
def test_a_step_in_the_newest_days_was_thrown_away_and_c_of_before_served_as_ok(
    station: Factory, campaign: Spectra
) -> None:
    """Fewer events than a state has are anomalous: C was 18 % off, its flag ok, and nobody was told."""
    times = np.unique(campaign.time_unix)
    power = campaign.power.copy()
    for antenna, events in ((0, 4), (1, 7)):
        power[(campaign.antenna == antenna) & (campaign.time_unix >= times[-events])] *= 0.6
    with station.database.write() as stores:
        for table in ("spectrum", "event_station"):
            stores.spectra._connection.exec_driver_sql(f"DELETE FROM {table}")  # noqa: S608 - names from here
    add_spectra(station, replace(campaign, power=power))
    night(station)

    def tell() -> list[str]:
        station.alarms.look()
        return [one.news.sentence for one in station.alarms.newest(AlarmsAsked(("open",), 10, kind="left_out"))]

    (told,) = tell()
    assert told.startswith("CS002 (antenna 1 X, antenna 1 Y): all 7 spectra since 20"), "four may be exceptions"
    last, path = round(times[-1] * 1e6), {"station": "CS002", "antenna": 1, "dipole": "X"}
    with served(station) as client:

        def flag(at: int, **asked: Any) -> tuple[set[str], str]:
            query = {"at": format_instant(at), **path, **asked}
            (curve,) = client.get("/v1/calibrations/effective", params=query).json()["curves"]
            return set(curve["flag"]), str(curve["flag_reason"])

        assert "ok" in flag(round(times[-9] * 1e6))[0], "before"
        flags, reason = flag(last)
        assert "ok" not in flags
        assert reason.startswith("all 7 spectra since 20")
        assert "ok" in flag(last, antenna=0)[0]
        body = {"paths": [path], "at": {"value": format_instant(round(times[-7] * 1e6))}, "reason": "test"}
        station.changes.enter(ChangeBody.model_validate(body), "test")
        assert [one.startswith("CS002 antenna 1 Y") for one in tell()] == [True], "the change explains the other"
        assert "left out" not in flag(last)[1]


ONE_YEAR = TwinSettings(stations=("CS002",), antennas=4, events_per_year=300, years=0.99)


@pytest.mark.long
@pytest.mark.parametrize("database_url", ["sqlite"], indirect=True)
def test_a_clock_that_is_off_passed_the_gate_and_only_a_report_said_so(
    make_service: Callable[..., Factory], sky_power_file: Path, superterp: Instrument
) -> None:
    sky, fault = read_sky_power(sky_power_file), LstOffset(size=0.4)
    spectra = simulate_campaign(ONE_YEAR, superterp, sky, np.random.default_rng(15), [fault]).spectra
    factory = make_service(spectra, nightly_investigations=True)
    with served(factory) as http:
        night(factory)
        assert {one["gate"] for one in http.get("/v1/calibrations").json()["calibrations"]} == {None}
        factory.alarms.look()
        (alarm,) = http.get("/v1/alarms", params={"kind": "named_cause"}).json()["alarms"]
        (year,) = alarm["content"]["years"]
        assert (alarm["station"], alarm["content"]["cause"]) == ("CS002", "lst_offset")
        assert year["fraction"] > year["statistical_error"] > 0.005
        assert alarm["sentence"].startswith("CS002 in 2014: In station CS002, ")
        assert "of its statistical errors: adopt it" in alarm["sentence"]
        assert "1 cause named and not adopted" in http.get("/v1/status").json()["alarms"]["line"]
        body = {"finding": year["finding"], "reason": "the clock is off", "promote": True}
        answer = http.post(f"/v1/investigations/{year['investigation']}/adoption", json=body)
        assert answer.status_code == 202, answer.text
        factory.alarms.look()
        assert http.get("/v1/alarms", params={"kind": "named_cause"}).json()["alarms"] == []


def named(cause: str, moved: float, antennas: tuple[int, ...] = (0, 1, 2), **parameters: float) -> dict[str, Any]:
    """A finding of an investigation that moves C by so much."""
    where = {"station": "CS001", "antennas": list(antennas), "dipoles": ["X"], "dates": ["2014-01-01T00:00:00Z"]}
    return {
        "cause": cause, "sentence": f"C moves by {moved}.", "significance_sigma": 9.0, "parameters": parameters,
        "size": {"value": 0.05, "sigma": 0.01, "unit": "fraction"}, "where": where, "evidence": {"target": "station"},
        "calibration_change": {"median_fraction": moved},
    }  # fmt: skip


def test_a_named_cause_is_an_alarm_where_it_moves_c_in_effect_by_more_than_its_error(
    factory: Factory, client: TestClient, stored: dict[str, Version]
) -> None:
    promote(client, stored["station"], "2013-01-01", "2016-01-01")
    small, large = (named("gain_temperature", moved, delay_h=0.0) for moved in (0.1, 0.2))
    within, dated = named("compression", 0.0037), named("gain_step", 0.5, date_unix=1.4e9)
    made = [
        ("a", "CS001", 2013, "2014-01-01", [small]),
        ("b", "CS001", 2014, "2015-01-01", [within, dated, large]),
        ("c", "CS001", 2015, "2015-06-01", [named("gain_temperature", 0.7, delay_h=0.0)]),
        ("d", "CS002", 2014, "2015-01-01", [large]),
    ]
    with factory.database.write() as stores:
        for k, (name, station, year, until, findings) in enumerate(made):
            window = instant(f"{year}-01-01"), instant(until)
            report = {"verdict": "explained", "findings": findings, "unexplained": None}
            inputs = {"model": None}
            stores.investigations.add(Investigation(name * 64, station, *window, inputs, report, k, "x", "x"))
        (news,) = find_named(stores)
    error = 0.01 * (1 / 2.2 + 1 / 3.3) / 2  # of the channels of a curve the median
    assert news.sentence == (
        "CS001 in 2013, 2014: C moves by 0.2. C in effect was made without it and is off by 20.0%, "
        f"{0.2 / error:.1f} of its statistical errors: adopt it (investigation bbbbbbbbbb, finding 2), or put right "
        "what is wrong"
    )
    assert (news.scope, news.subject, news.since) == (Scope("CS001"), "gain_temperature station", instant("2013-01-01"))
    years = [(one["since"][:4], one["finding"], one["fraction"]) for one in news.content["years"]]
    assert years == [("2013", 0, 0.1), ("2014", 2, 0.2)]
    assert news.content["years"][0]["statistical_error"] == pytest.approx(error)


def test_a_path_lost_its_c_as_its_version_waits_and_no_alarm_said_so(factory: Factory, client: TestClient) -> None:
    path = Scope("CS001", 0, "X")
    before = new_version(path, "before", since=instant("2013-01-01"), until=instant("2014-01-01"))
    gated = new_version(path, "gated", gate="a jump")
    empty = new_version(Scope("CS001", 1, "X"), "empty", status="too_few_events", gate="too_few_events with 0 events")
    with factory.database.write() as stores:
        stores.versions.add([before, gated, empty])
        assert [one.is_to_decide for one in stores.versions.waiting()] == [True, False]
    assert factory.status.look().gated == 1, "nobody can decide on a version without a C"
    factory.alarms.look()
    assert alarms(client) == [], "it never had one"
    promote(client, before, "2013-01-01", "2014-01-01")
    factory.alarms.look()
    (told,) = alarms(client, kind="lost_c")
    who = "CS001 antenna 0 X"
    waits = f"version {gated.id[:12]} of {who} waits for a person to promote it (a jump)"
    assert told["sentence"] == f"{who}, 2014-01-01 to 2015-01-01: no C is in effect; {who}: {waits}"
    promote(client, gated, "2014-01-01", "2015-01-01")
    factory.alarms.look()
    assert alarms(client) == []
