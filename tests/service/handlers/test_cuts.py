from __future__ import annotations

from fastapi.testclient import TestClient

from lbacal.instants import DAY_US, parse_instant
from lbacal_core.curves.validity import Promotion, Scope
from service.factory import Factory
from service.storage.drift import Cut
from service.storage.versions import Version

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
    _, runner = factory.keys.create(("refits:run",))
    headers = {"Authorization": f"Bearer {runner}"}
    assert client.post(f"/v1/cuts/{one['cut']}/lift", json={"reason": "x"}, headers=headers).status_code == 403


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
