from __future__ import annotations

from fastapi.testclient import TestClient

from lbacal_core.curves.validity import Scope
from service.factory import Factory
from service.storage.alarms import News


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
    assert client.post(route, json={"reason": "known", "until": "2019-01-01"}).status_code == 422
    known = client.post(route, json={"reason": "the cable is ordered", "until": "2021-01-01"})
    assert (known.status_code, known.json()["acknowledgement"]["reason"]) == (201, "the cable is ordered")
    for state, count in (("open", 0), ("acknowledged", 1), ("lasting", 1), ("ended", 0), ("all", 1)):
        assert len(client.get("/v1/alarms", params={"state": state}).json()["alarms"]) == count
    assert client.post("/v1/alarms/99/acknowledgement", json={"reason": "x"}).status_code == 404
    _, reader = factory.keys.create(("read",))
    headers = {"Authorization": f"Bearer {reader}"}
    assert client.post(route, json={"reason": "x"}, headers=headers).status_code == 403
