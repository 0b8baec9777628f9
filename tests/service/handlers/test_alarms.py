from __future__ import annotations

from typing import Any

import pytest
from fastapi.testclient import TestClient

from lbacal.instants import DAY_US, parse_instant
from lbacal_core.curves.validity import Promotion, Scope
from service.factory import Factory
from service.storage.alarms import News
from service.storage.drift import Cut
from service.storage.versions import Version


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
    assert numbers(station="CS003") == []
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


def cut(factory: Factory, station: str, antenna: int) -> None:
    with factory.database.write() as stores:
        stores.cuts.add([Cut(station, antenna, DATE, 2 * DAY_US)], factory.clock())


def test_a_cut_is_lifted_and_restored_once_each(factory: Factory, client: TestClient) -> None:
    cut(factory, "CS001", 0)
    cut(factory, "CS002", 1)
    (one,) = client.get("/v1/cuts", params={"station": "CS002"}).json()["cuts"]
    assert (one["station"], one["antenna"], one["date"], one["date_sigma_days"]) == (
        "CS002", 1, "2014-05-01T00:00:00Z", 2.0,
    )  # fmt: skip
    assert (one["stands"], one["refitted"], one["ended_at"], one["decision"]) == (True, True, None, None)
    assert len(client.get("/v1/cuts").json()["cuts"]) == 2
    for act, stands in (("lift", False), ("restoration", True)):
        route = f"/v1/cuts/{one['cut']}/{act}"
        done = client.post(route, json={"reason": "snow"})
        assert (done.status_code, done.json()["stands"], done.json()["decision"]["reason"]) == (201, stands, "snow")
        assert client.post(route, json={"reason": "snow"}).status_code == 409
    assert client.post("/v1/cuts/99/lift", json={"reason": "x"}).status_code == 404


def test_a_cut_is_refitted_once_no_version_answers_on_both_sides(
    factory: Factory, client: TestClient, stored: dict[str, Version]
) -> None:
    cut(factory, "CS001", 0)
    path, (start, end) = Scope("CS001", 0, "X"), (parse_instant("", f"{year}-01-01") for year in (2014, 2015))

    def is_refitted(*intervals: tuple[int, int | None]) -> bool:
        with factory.database.write() as stores:
            wanted = [Promotion(0, path, since, until, stored["path"].id, 0) for since, until in intervals]
            stores.ledger.append(wanted, factory.clock)
        return bool(client.get("/v1/cuts").json()["cuts"][0]["refitted"])

    assert not is_refitted((start, end))
    assert not is_refitted((start, None))
    assert not is_refitted((DATE, end)), "one side of it only"
    assert is_refitted((start, DATE))


STEP: dict[str, Any] = {
    "station": "CS001", "is_known": False, "date_unix": 1.4e9, "date_sigma_days": 1.0, "earliest_unix": 1.39e9,
    "latest_unix": 1.41e9, "size": 0.05, "sigma": 0.01, "shape": {}, "significance": 5.0,
    "members": [{"antenna": 1, "dipole": "X"}],
}  # fmt: skip


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
