from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest
from fastapi.testclient import TestClient
from typer.testing import CliRunner

import lbacal
from lbacal.analysis import life as analysis_life
from lbacal.cli import life as cli_life
from lbacal.cli.main import app
from lbacal.instants import DAY_US, parse_instant
from lbacal_core.curves.validity import Promotion, Scope
from lbacal_core.errors import BadInputError
from service.factory import Factory
from service.storage.alarms import News
from service.storage.changes import DRIFT, INVESTIGATION, Change, Evidence
from service.storage.models import Investigation
from service.storage.processes import SCHEDULER
from service.storage.versions import Version
from service.usecases.watch import settle_changes, tell_news
from tests.service.conftest import promote


def raise_alarm(factory: Factory, station: str, kind: str = "misfit") -> int:
    with factory.database.write() as stores:
        return stores.alarms.raise_alarm(News(kind, Scope(station), "", f"{station} is wrong"), factory.clock())


def test_alarms_of_a_station_and_of_a_kind_are_those_alone(factory: Factory, client: TestClient) -> None:
    one, other = raise_alarm(factory, "CS001"), raise_alarm(factory, "CS002", "lost_path")
    third = raise_alarm(factory, "CS002")

    def numbers(**asked: str) -> list[int]:
        return [alarm["alarm"] for alarm in client.get("/v1/alarms", params=asked).json()["alarms"]]

    assert numbers() == [third, other, one]
    assert numbers(station="CS002") == [third, other]
    assert numbers(station="CS001") == [one]
    assert numbers(kind="misfit") == [third, one]
    assert numbers(kind="misfit", station="CS002") == [third]
    page = client.get("/v1/alarms", params={"limit": 2}).json()
    rest = client.get("/v1/alarms", params={"cursor": page["next"]}).json()
    assert ([a["alarm"] for a in rest["alarms"]], rest["next"]) == ([one], None)
    assert client.get("/v1/alarms?kind=none").status_code == 422


def test_an_acknowledged_alarm_lasts_and_is_not_open(factory: Factory, client: TestClient) -> None:
    number = raise_alarm(factory, "CS001")
    route = f"/v1/alarms/{number}/acknowledgement"
    for body in ({"reason": "known", "until": "2019-01-01"}, {"reason": " "}):
        assert client.post(route, json=body).status_code == 422
    known = client.post(route, json={"reason": "the cable is ordered", "until": "2021-01-01"})
    assert known.status_code == 201
    told = known.json()["acknowledgement"]
    assert (told["reason"], told["until"]) == ("the cable is ordered", "2021-01-01T00:00:00Z")
    assert client.get("/v1/status").json()["alarms"]["line"] == "none open, 1 acknowledged; 1 new since yesterday"
    for state, count in (("open", 0), ("acknowledged", 1), ("lasting", 1), ("ended", 0), ("all", 1)):
        assert len(client.get("/v1/alarms", params={"state": state}).json()["alarms"]) == count
    assert client.post("/v1/alarms/99/acknowledgement", json={"reason": "x"}).status_code == 404


DATE = parse_instant("", "2014-05-01")


def find_change(factory: Factory, station: str, antenna: int, source: str = DRIFT, days: int = 0) -> None:
    change = Change(station, ((antenna, "X"),), "step", DATE + days * DAY_US, 2 * DAY_US, 0.08, 0.01)
    with factory.database.write() as stores:
        stores.changes.note(change, Evidence(source, "", 9.0, factory.clock()))


def test_a_change_is_dismissed_and_put_in_force_again_once_each(factory: Factory, client: TestClient) -> None:
    find_change(factory, "CS001", 0)
    find_change(factory, "CS002", 1)
    (one,) = client.get("/v1/changes", params={"station": "CS002"}).json()["changes"]
    assert one["at"] == {"value": "2014-05-01T00:00:00Z", "sigma_days": 2.0}
    assert one["paths"] == [{"station": "CS002", "antenna": 1, "dipole": "X"}]
    assert one["size"] == {"value": 0.08, "sigma": 0.01, "unit": "fraction of C"}
    assert (one["decision"], one["by"], one["cuts_windows"], one["refitted"]) == ("in_force", "drift", True, True)
    assert len(client.get("/v1/changes").json()["changes"]) == 2
    route = f"/v1/changes/{one['id']}/decision"
    for decision, cuts in (("dismissed", False), ("in_force", True)):
        body = {"decision": decision, "reason": "snow"}
        dry = client.post(route, json=body, params={"dry_run": True})
        assert (dry.status_code, dry.json()["decision"], dry.json()["changes"]) == (200, decision, [])
        done = client.post(route, json=body)
        assert (done.status_code, done.json()["decision"], done.json()["reason"]) == (201, decision, "snow")
        assert done.json()["cuts_windows"] == cuts
        assert client.post(route, json=body).status_code == 409
    assert client.post("/v1/changes/99/decision", json=body).status_code == 404
    for query, count in (
        ({"antenna": 1}, 1), ({"antenna": 1, "dipole": "Y"}, 0), ({"since": "2014-05-02"}, 0),
        ({"until": "2014-05-02"}, 2), ({"decision": "proposed"}, 0), ({"decision": "in_force"}, 2),
    ):  # fmt: skip
        assert len(client.get("/v1/changes", params=query).json()["changes"]) == count, query


def test_one_change_is_one_row_whoever_found_it(factory: Factory, client: TestClient) -> None:
    """A step was a change of drift, a cut of windows and a cause to adopt, and the three contradicted each other."""
    find_change(factory, "CS002", 1, INVESTIGATION)
    (one,) = client.get("/v1/changes").json()["changes"]
    assert (one["decision"], one["cuts_windows"]) == ("proposed", False)
    find_change(factory, "CS002", 1, DRIFT, days=4)
    (one,) = client.get("/v1/changes").json()["changes"]
    assert (one["decision"], one["cuts_windows"], one["at"]["value"][:10]) == ("in_force", True, "2014-05-01")
    body = {"paths": [{"station": "CS002", "antenna": 1}], "at": {"value": "2014-05-02"}, "reason": "a new amplifier"}
    entered = client.post("/v1/changes", json=body)
    assert (entered.status_code, entered.json()["id"]) == (201, one["id"])
    assert [by["from"] for by in entered.json()["evidence"]] == ["investigation", "drift", "person"]
    far = client.post(
        "/v1/changes", json={"station": "CS001", "at": {"value": "2014-09-02"}, "reason": "a storm"}
    ).json()
    assert (far["paths"], far["station"], far["decision"], far["cuts_windows"]) == (None, "CS001", "in_force", True)
    for wrong in ({"station": "CS002", "array": True}, {}, {"paths": [{"station": "CS002", "antenna": 99}]}):
        assert (
            client.post("/v1/changes", json={"at": {"value": "2014-05-02"}, "reason": "x", **wrong}).status_code == 422
        )
    for date in ("2034-05-01T12:00", "1914-05-01"):  # spectra of these are refused, too
        refused = client.post("/v1/changes", json={"station": "CS002", "at": {"value": date}, "reason": "a typo"})
        assert (refused.status_code, "from 2009 until now" in refused.json()["detail"]) == (422, True)


def test_an_alarm_of_a_step_that_was_dismissed_said_unless_it_was(factory: Factory, client: TestClient) -> None:
    content = {
        "station": "CS002", "is_known": False, "date_unix": DATE / 1e6, "date_sigma_days": 1.0, "size": 0.1,
        "sigma": 0.01, "shape": {}, "significance": 9.0,
        "members": [{"antenna": 1, "dipole": "X", "size": 0.1, "sigma": 0.01, "significance": 9.0}],
    }  # fmt: skip
    report = {"changes": [content], "slopes": [], "trends": {}}
    with factory.database.write() as stores:
        (news,) = tell_news(report, factory.instrument.frequency_mhz, cuts_windows=True)
        stores.alarms.settle(["step"], [news], factory.clock())
    told = []
    for decision in (None, "found", "dismissed", "in_force"):
        if decision == "found":
            find_change(factory, "CS002", 1)
        elif decision:
            client.post("/v1/changes/1/decision", json={"decision": decision, "reason": "test"})
        told.append(client.get("/v1/alarms").json()["alarms"][0]["sentence"].rpartition("; ")[2])
    cut = "its windows are cut there"
    assert told == [f"{cut} unless a person dismissed the change", cut, "a person dismissed the change", cut]


def test_what_a_person_enters_is_told_with_what_drift_measures(factory: Factory, client: TestClient) -> None:
    month_s = 30 * DAY_US / 1e6
    step = {
        "station": "CS002", "is_known": False, "date_unix": DATE / 1e6, "date_sigma_days": 1.0, "size": 0.12,
        "sigma": 0.002, "shape": {}, "significance": 30.0,
        "members": [
            {"antenna": 1, "dipole": dipole, "size": 0.12, "sigma": 0.002, "significance": 30.0} for dipole in "XY"
        ],
    }  # fmt: skip
    slope = {
        "station": "CS002", "antenna": 2, "dipole": "X", "slope": 0.04, "sigma": 0.002, "shape": {}, "is_found": True,
        "significance": 20.0, "season": 0.03, "season_sigma": 0.003, "season_phase": 0.05, "season_is_found": False,
        "season_significance": 9.0, "season_shape": {},
    }  # fmt: skip
    report = {"changes": [step], "slopes": [slope], "trends": {}, "first_unix": DATE / 1e6 - 6 * month_s}
    with factory.database.write() as stores:
        stores.drift.keep_report("all", report, factory.clock())
        settle_changes(stores, report, {}, factory.clock())

    def enter(antenna: int, date: str, size: float | None, kind: str = "step", dipole: str | None = None) -> list[str]:
        path = {"station": "CS002", "antenna": antenna} | ({} if dipole is None else {"dipole": dipole})
        body = {"paths": [path], "kind": kind, "at": {"value": date, "sigma_days": 1.0}, "reason": "from memory"}
        body |= {} if size is None else {"size": {"value": size, "sigma": 0.004}}
        answer = client.post("/v1/changes", json=body)
        assert answer.status_code == 201, answer.json()
        return list(answer.json()["doubts"])

    at = "2014-05-01T00:00:00Z"
    assert enter(1, "2014-05-16", None) == ["drift finds it on 2014-05-01 ± 1.0 d (change 1), and none here"]
    assert enter(1, "2014-07-16", None) == []
    assert enter(1, at, 0.121) == []
    assert enter(1, at, -0.107) == ["drift measures +12.00 ± 0.20 %"]
    assert enter(2, at, -0.04, "ramp") == ["drift measures +4.00 ± 0.20 % a year in CS002 antenna 2 X"]
    assert enter(2, at, 0.041, "ramp", "X") == []
    assert enter(2, "2014-01-19", 0.03, "season") == []
    said = "drift measures +3.00 ± 0.30 %, largest on 01-19 (month, day) in CS002 antenna 2 X"
    assert enter(2, "2014-07-19", 0.03, "season") == [said]
    assert enter(0, at, 0.06, "ramp") == []  # nothing is measured there
    found = client.get("/v1/changes").json()["changes"]
    replaced = {one["id"]: one["doubts"][0] for one in found if any("in its place" in doubt for doubt in one["doubts"])}
    assert replaced == {2: "C follows change 6 in its place", 7: "C follows change 8 in its place"}
    assert enter(0, at, 0.05, "ramp", "X") == enter(0, at, -0.08, "ramp") == []
    with factory.database.read() as stores:
        ramps = [one.slow.size for one in stores.changes.of_fits("CS002")[0] if one.slow and one.antenna == 0]
    assert np.exp(ramps[-1]) == pytest.approx(0.92), "the last entered is the last taken out"
    told = {one["id"]: one["doubts"] for one in client.get("/v1/changes").json()["changes"]}
    assert told[9] == told[10] == ["C follows change 11 in its place"]


def test_a_change_ends_when_nobody_finds_it_any_longer(factory: Factory, client: TestClient) -> None:
    find_change(factory, "CS002", 1)
    with factory.database.write() as stores:
        stores.changes.end(1, DRIFT, factory.clock())
    (one,) = client.get("/v1/changes").json()["changes"]
    assert (one["ended_at"] is not None, one["cuts_windows"]) == (True, False)
    assert client.post("/v1/changes/1/decision", json={"decision": "dismissed", "reason": "x"}).status_code == 409
    find_change(factory, "CS002", 1)
    (one,) = client.get("/v1/changes").json()["changes"]
    assert (one["ended_at"], one["cuts_windows"], len(one["evidence"])) == (None, True, 2)


def test_a_change_is_refitted_once_no_version_answers_on_both_sides(
    factory: Factory, client: TestClient, stored: dict[str, Version]
) -> None:
    find_change(factory, "CS001", 0)
    path, (start, end) = Scope("CS001", 0, "X"), (parse_instant("", f"{year}-01-01") for year in (2014, 2015))

    def is_refitted(name: str, since: int, until: int | None) -> bool:
        with factory.database.write() as stores:
            stores.ledger.append([Promotion(0, path, since, until, stored[name].id, 0, SCHEDULER)], factory.clock)
        question = {"at": "2014-06-01", "station": "CS001", "antenna": 0, "dipole": "X"}
        (curve,) = client.get("/v1/calibrations/effective", params=question).json()["curves"]
        is_told = bool(client.get("/v1/changes").json()["changes"][0]["refitted"])
        assert is_told == (curve["flag_reason"] is None)
        return is_told

    assert not is_refitted("path", start, end)
    assert not is_refitted("path", start, None)
    assert not is_refitted("path", DATE, end), "in two acts the same version"
    assert not is_refitted("path", start, DATE), "in two acts the same version"
    assert is_refitted("other", start, DATE)


def test_the_mean_over_a_change_that_a_person_put_back_into_effect_read_for_ever_as_not_yet_refitted(
    factory: Factory, client: TestClient, stored: dict[str, Version]
) -> None:
    promote(client, stored["path"], "2014-01-01", "2015-01-01")
    find_change(factory, "CS001", 0)

    def tell() -> tuple[bool, str]:
        question = {"at": "2014-06-01", "station": "CS001", "antenna": 0, "dipole": "X"}
        (curve,) = client.get("/v1/calibrations/effective", params=question).json()["curves"]
        return client.get("/v1/changes").json()["changes"][0]["refitted"], str(curve["flag_reason"])

    said = "CS001 antenna 0 changed on 2014-05-01"
    assert tell() == (False, f"{said} (found, not yet refitted): C in effect is the mean over the change")
    piece = Promotion(0, Scope("CS001", 0, "X"), DATE, DATE + DAY_US, stored["other"].id, 0, SCHEDULER)
    with factory.database.write() as stores:
        (made,) = stores.ledger.append([piece], factory.clock)
    assert client.post(f"/v1/promotions/{made.number}/rollback", json={"reason": "too few events"}).status_code == 201
    assert tell() == (True, f"{said}: key 1 put the mean over it into effect (too few events)")


def test_a_change_whose_date_moved_with_no_event_between_was_not_refitted_for_ever(
    factory: Factory, client: TestClient, stored: dict[str, Version]
) -> None:
    """The version after it kept the bounds of the old date: it was said to be the mean over the change."""
    find_change(factory, "CS001", 0)
    path, (start, end) = Scope("CS001", 0, "X"), (parse_instant("", f"{year}-01-01") for year in (2014, 2015))
    pieces = [("other", start, DATE - DAY_US), ("path", DATE - DAY_US, end), ("other", start, DATE)]
    for name, since, until in pieces:
        with factory.database.write() as stores:
            stores.ledger.append([Promotion(0, path, since, until, stored[name].id, 0)], factory.clock)
    assert client.get("/v1/changes").json()["changes"][0]["refitted"]
    for at, name in (("2014-04-30T12:00", "other"), ("2014-05-01", "path")):
        question = {"at": at, "station": "CS001", "antenna": 0, "dipole": "X"}
        (curve,) = client.get("/v1/calibrations/effective", params=question).json()["curves"]
        near = "CS001 antenna 0 changed on 2014-05-01 ± 2.0 days (change 1): C may still be that of the other side"
        assert (curve["calibration"], curve["flag_reason"]) == (stored[name].id, near)


def test_the_life_of_a_path_says_what_was_in_effect_when_and_what_happened(
    factory: Factory, client: TestClient, stored: dict[str, Version]
) -> None:
    path = Scope("CS001", 0, "X")
    start, end = (parse_instant("", f"{year}-01-01") for year in (2014, 2015))
    name = stored["path"].id
    with factory.database.write() as stores:
        intervals = (start, DATE), (DATE, end)
        stores.ledger.append([Promotion(0, path, *both, name, 0) for both in intervals], factory.clock)
    find_change(factory, "CS001", 0)
    find_change(factory, "CS001", 1)
    raise_alarm(factory, "CS001")
    life = client.get("/v1/paths/CS001/0/X/life").json()
    (first, second) = life["epochs"]
    assert (first["from"], first["to"], second["because"]) == (None, "2014-05-01T00:00:00Z", life["changes"][0]["id"])
    assert [(one["from"][:10], one["to"][:10]) for one in life["in_effect"]] == [
        ("2014-01-01", "2014-05-01"), ("2014-05-01", "2015-01-01"),
    ]  # fmt: skip
    assert name in [one["id"] for one in life["versions"]]
    assert [len(life[part]) for part in ("changes", "alarms", "causes", "investigations")] == [1, 1, 0, 0]
    assert len(client.get("/v1/stations/CS001/life").json()["changes"]) == 2
    assert client.get("/v1/life").json()["epochs"] == [{"from": None, "to": None, "because": None}]
    assert client.get("/v1/paths/CS001/99/X/life").status_code == 422


def test_the_life_of_a_path_has_the_steps_of_its_antenna_and_no_alarm_of_another(
    factory: Factory, client: TestClient, stored: dict[str, Version]
) -> None:
    """It told every step of the station, and no change and one epoch where the other dipole cut its windows."""
    promote(client, stored["station"], "2014-01-01", "2015-01-01")
    find_change(factory, "CS001", 0)
    lost = News("lost_path", Scope("CS001"), "", "two are silent", {"paths": ["CS001/1/Y", "CS001/2/Y"]})
    with factory.database.write() as stores:
        for news in (News("step", Scope("CS001"), "", "C of antenna 1 changed", STEP), lost):
            stores.alarms.raise_alarm(news, factory.clock())
    told = {
        where: client.get(f"/v1/{where}/life").json()
        for where in ("paths/CS001/0/X", "paths/CS001/0/Y", "paths/CS001/1/X", "paths/CS001/1/Y", "stations/CS001")
    }
    assert [len(life["alarms"]) for life in told.values()] == [0, 0, 1, 1, 2]
    assert [len(life["changes"]) for life in told.values()] == [1, 1, 0, 0, 1]
    assert [len(life["epochs"]) for life in told.values()] == [2, 2, 1, 1, 1]
    asked = {"at": "2014-06-01", "station": "CS001", "antenna": 0}
    curves = client.get("/v1/calibrations/effective", params=asked).json()["curves"]
    assert [one["epoch"]["because"] for one in curves] == [1, 1]


class _Asking:
    """A client of a server in this process."""

    def __init__(self, http: TestClient) -> None:
        self._http = http

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...

    def get(self, path: str, **params: object) -> Any:
        return self._http.get(path, params={name: one for name, one in params.items() if one is not None}).json()

    def send(self, method: str, path: str, body: object, **params: object) -> Any:
        answer = self._http.request(method, path, json=body, params={k: v for k, v in params.items() if v is not None})
        assert answer.is_success, answer.text
        return answer.json()


def test_a_change_is_entered_decided_and_stands_in_the_life_of_its_path(
    client: TestClient, stored: dict[str, Version], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    promote(client, stored["path"], "2014-01-01", "2015-01-01")
    for module in (cli_life, analysis_life):
        monkeypatch.setattr(module, "Client", lambda: _Asking(client))

    def run(*arguments: str) -> str:
        done = CliRunner().invoke(app, list(arguments))
        assert done.exit_code == 0, done.output
        return "".join(line for line in done.output.splitlines(keepends=True) if "[info " not in line)

    assert run("changes") == "no changes\n"
    where = ("--station", "CS001", "--antenna", "0")
    ramp = ("--kind", "ramp", "--size", "0.04", "--reason", "it ages")
    refused = CliRunner().invoke(app, ["changes", "enter", "2014-05-01", *where, *ramp])
    assert (type(refused.exception), "--size-sigma" in str(refused.exception)) == (BadInputError, True)
    run("changes", "enter", "2014-05-01", *where, "--sigma-days", "2", "--reason", "an amplifier")
    assert run("changes", *where).startswith(
        "1 CS001 antenna 0, step at 2014-05-01 ± 2.0 d (in force, not yet refitted"
    )
    assert json.loads(run("changes", "--json")) == client.get("/v1/changes").json()["changes"]
    assert json.loads(run("life", "CS001/0/X", "--json")) == client.get("/v1/paths/CS001/0/X/life").json()
    tried = run("changes", "decide", "1", "--dismiss", "--reason", "it was none", "--dry-run")
    assert "(dry run: nothing was written)" in tried
    told = run("life", "CS001/0/X")
    assert "2014-05-01 change 1, in force, not yet refitted\n" in told
    assert told.endswith("versions: 3, epochs: 2\n"), "of which one was promoted"
    found = lbacal.life("CS001", antenna=0, dipole="X")
    assert [row[1] for row in found.rows if row[0] == "2014-05-01"] == ["change 1, in force, not yet refitted"]
    found.save(tmp_path / "life.json")
    found.save(tmp_path / "life.png")
    assert json.loads((tmp_path / "life.json").read_text()) == found.content
    run("changes", "decide", "1", "--dismiss", "--reason", "it was none")
    assert "change 1, dismissed" in run("life", "CS001/0/X")
    assert run("life").endswith("versions: 1, epochs: 1\n")
    for wrong in ({"antenna": 0}, {"dipole": "X"}):
        with pytest.raises(BadInputError, match="a part of a path"):
            lbacal.life("CS001", **wrong)
    for arguments in (["life", "CS001/0"], ["changes", "decide", "1", "--reason", "x"]):
        assert isinstance(CliRunner().invoke(app, arguments).exception, BadInputError)


STEP: dict[str, Any] = {
    "station": "CS001", "is_known": False, "date_unix": 1.4e9, "date_sigma_days": 1.0, "earliest_unix": 1.39e9,
    "latest_unix": 1.41e9, "size": 0.05, "sigma": 0.01, "shape": {}, "significance": 5.0,
    "members": [{"antenna": 1, "dipole": "X"}],
}  # fmt: skip


def test_a_change_along_frequency_was_told_by_its_mean_alone_and_one_that_ended_as_in_force(
    factory: Factory, client: TestClient, stored: dict[str, Version], monkeypatch: pytest.MonkeyPatch
) -> None:
    promote(client, stored["path"], "2014-01-01")
    monkeypatch.setattr(cli_life, "Client", lambda: _Asking(client))

    def run(*arguments: str) -> str:
        return CliRunner().invoke(app, list(arguments)).output

    tilt = Change("CS001", ((0, "X"),), "step", DATE, DAY_US, -0.009, 0.002, tilt=-0.149)
    with factory.database.write() as stores:
        kept = stores.changes.note(tilt, Evidence(DRIFT, "", 444.0, factory.clock()))
    words = "C by a tilt (-13.84 % at 80 MHz, +16.07 % at 30 MHz) and by -0.90 ± 0.20 % in the mean over the band"
    assert words in run("changes"), "as its alarm says, and not only the mean"
    page = client.get("/paths/CS001/0/X").text
    assert words in page
    assert words.removeprefix("C by ") in client.get("/").text
    with factory.database.write() as stores:
        stores.changes.end(kept.number, DRIFT, factory.clock())
    assert "change 1, ended\n" in run("life", "CS001/0/X"), "it was said to be in force"
    assert "change 1, ended" in client.get("/paths/CS001/0/X").text


def test_a_step_is_told_of_its_path_its_station_and_the_array_alone(factory: Factory, client: TestClient) -> None:
    with factory.database.write() as stores:
        report = {"changes": [STEP], "slopes": [], "trends": {}, "threshold_sigma": 4.5}
        stores.drift.keep_report("x", report, factory.clock())

    def steps(**asked: Any) -> int:
        told = client.get("/v1/drift", params=asked).json()
        assert told["threshold_sigma"] == 4.5
        assert (told["versions"], told["months"], told["slope"]) == ([], [], None)
        return len(told["steps"])

    assert [steps(), steps(station="CS001"), steps(station="CS002")] == [1, 1, 0]
    assert steps(station="CS001", antenna=1, dipole="X") == 1
    assert steps(station="CS001", antenna=1, dipole="Y") == steps(station="CS001", antenna=2, dipole="X") == 0
    (step,) = client.get("/v1/drift").json()["steps"]
    assert (step["station"], step["antenna"], step["dipole"], step["date"]) == ("CS001", 1, "X", "2014-05-13")
    assert (step["known"], step["calibration"], step["size"]) == (False, None, 0.05)


@pytest.mark.parametrize(
    ("asked", "sentence"),
    [
        ({"station": "CS999"}, "CS001, CS002"),
        ({"antenna": 1}, "a station beside it"),
        ({"station": "CS001", "antenna": 1}, "antenna and dipole together, or neither"),
        ({"station": "CS001", "antenna": 1, "dipole": "Z"}, "one of X, Y"),
        ({"stations": "CS001"}, "stations"),
    ],
)
def test_who_is_not_there_has_no_drift(client: TestClient, asked: dict[str, Any], sentence: str) -> None:
    answer = client.get("/v1/drift", params=asked)
    assert (answer.status_code, sentence in answer.json()["detail"]) == (422, True)


def test_antennas_not_to_be_used_are_silent_insensitive_or_weak(factory: Factory, client: TestClient) -> None:
    def bad(**asked: str) -> list[tuple[str, int, str, str, str]]:
        answer = client.get("/v1/antennas/bad", params=asked)
        assert answer.status_code == 200, answer.text
        return [
            tuple(one[part] for part in ("station", "antenna", "dipole", "kind", "since"))
            for one in answer.json()["bad"]
        ]

    assert bad(at="2014-06-01") == []
    assert client.get("/v1/antennas/bad?at=2014-06-01").json()["calibrated"] == 0, "nothing bad: nothing is known"
    weak, half = Change("CS001", ((0, "X"),), "step", DATE, DAY_US, 0.5, 0.01), 10 * DAY_US
    lost = News("lost_path", Scope("CS002"), "", "2 paths", {"paths": ["CS002/1/X", "CS002/1/Y"]}, since=DATE + half)
    begin, end = (parse_instant("", f"{year}-01-01") for year in (2014, 2015))
    report = {"verdict": "consistent", "findings": [], "stations": [{"station": "CS002", "deaf": ["antenna 1 Y"]}]}
    newer = report | {"stations": [{"station": "CS002", "deaf": []}]}
    with factory.database.write() as stores:
        stores.changes.note(weak, Evidence(DRIFT, "", 9.0, factory.clock()))
        stores.alarms.raise_alarm(lost, factory.clock())
        stores.investigations.add(Investigation("a" * 64, "CS002", begin, end, {}, report, 5, "x", "x"))
    day, later = "2014-05-01T00:00:00Z", "2014-05-11T00:00:00Z"
    deaf, silent = (
        ("CS002", 1, "Y", "insensitive", "2014-01-01T00:00:00Z"),
        [("CS002", 1, d, "silent", later) for d in "XY"],
    )
    assert bad(at="2014-04-30") == [deaf]
    assert bad(at="2014-05-02") == [("CS001", 0, "X", "weak", day), deaf]
    assert bad(at="2014-05-12") == [("CS001", 0, "X", "weak", day), silent[0], deaf, silent[1]]
    assert bad(at="2014-05-12", station="CS001") == [("CS001", 0, "X", "weak", day)]
    assert bad(at="2015-05-12", station="CS002") == silent, "no investigation holds that year"
    (told,) = client.get("/v1/antennas/bad", params={"at": "2014-05-12", "station": "CS001"}).json()["bad"]
    assert (told["reason"], told["source"]) == ("its power fell to 44% on 2014-05-01", "/v1/changes#1")
    mended = Change("CS001", ((0, "X"),), "step", DATE + half, DAY_US, -0.33, 0.01)
    with factory.database.write() as stores:
        stores.changes.note(mended, Evidence(DRIFT, "", 9.0, factory.clock()))
        stores.investigations.add(Investigation("b" * 64, "CS002", begin, end, {}, newer, 6, "x", "x"))
        stores.alarms.settle(["lost_path"], [], DATE + 2 * half)
    assert bad(at="2014-05-02") == [("CS001", 0, "X", "weak", day)]
    assert bad(at="2014-05-12") == silent
    assert bad(at="2014-05-22") == []
    assert client.get("/v1/antennas/bad?station=CS009").status_code == 422
    assert client.get("/v1/antennas/bad?at=soon").status_code == 422
