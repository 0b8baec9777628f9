from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from lbacal.instants import DAY_US, format_instant
from lbacal_core.curves.validity import Scope
from service.factory import Factory
from service.storage.jobs import Order
from service.storage.versions import Version
from service.wire.answer_models import PromotionsAnswer, TagAnswer, TagsAnswer
from tests.service.conftest import promote

Stored = dict[str, Version]
YEAR = {"valid_from": "2014-01-01", "valid_to": "2015-01-01"}
OF_2014 = ("2014-01-01", "2015-01-01")
PATH = {"station": "CS001", "antenna": 0, "dipole": "X"}


def effective(client: TestClient, at: str = "2014-06-01", **params: Any) -> Any:
    answer = client.get("/v1/calibrations/effective", params={"at": at, **PATH, **params})
    return answer.json()["curves"][0]["calibration"] if answer.status_code == 200 else answer.status_code


def test_a_tag_is_made_once_and_asked_for_by_its_name(client: TestClient, stored: Stored) -> None:
    promote(client, stored["path"], *OF_2014)
    made = client.put("/v1/tags/paper-1.0", json={"reason": "the paper"})
    TagAnswer.model_validate(made.json())
    assert (made.status_code, made.json()["name"]) == (201, "paper-1.0")
    again = client.put("/v1/tags/paper-1.0", json={"reason": "the paper"})
    assert (again.status_code, again.json()) == (200, made.json())
    assert client.put("/v1/tags/paper-1.0", json={"reason": "another"}).status_code == 409
    promote(client, stored["other"], *OF_2014)
    assert effective(client, tag="paper-1.0") == stored["path"].id
    assert effective(client) == stored["other"].id
    answer = client.get("/v1/calibrations/effective", params={"at": "2014-06-01", **PATH, "tag": "paper-1.0"})
    assert answer.json()["as_of"] == made.json()["as_of"]
    assert "immutable" in answer.headers["cache-control"]
    listed = client.get("/v1/tags").json()
    TagsAnswer.model_validate(listed)
    assert listed == {"tags": [made.json()], "next": None}


@pytest.mark.parametrize(
    ("name", "body", "said"),
    [
        ("v1", {}, "reason"), ("v1", {"reason": " "}, "reason"), ("v1", {"reason": "x", "as_of": "2014"}, "as_of"),
        ("v1", {"reason": "x", "as_of": "2031-01-01"}, "not later than now"), ("v 1", {"reason": "x"}, "name"),
        ("-v1", {"reason": "x"}, "name"), ("v" * 81, {"reason": "x"}, "name"),
        ("v1", {"reason": "x", "name": "v2"}, "name"),
    ],
)  # fmt: skip
def test_a_bad_tag_is_refused(client: TestClient, name: str, body: dict[str, Any], said: str) -> None:
    refused = client.put(f"/v1/tags/{name}", json=body)
    assert (refused.status_code, said in refused.json()["detail"]) == (422, True), refused.text
    assert client.get("/v1/tags").json() == {"tags": [], "next": None}


def test_an_unknown_tag_is_404_and_a_tag_beside_as_of_422(client: TestClient, stored: Stored) -> None:
    promote(client, stored["path"], *OF_2014)
    client.put("/v1/tags/v1", json={"reason": "x"})
    for tag, as_of, status, said in (
        ("v2", {}, 404, "no tag 'v2'"),
        ("v1", {"as_of": "2019-01-01"}, 422, "either tag"),
    ):
        answer = client.get("/v1/calibrations/effective", params={"at": "2014-06-01", **PATH, "tag": tag, **as_of})
        assert (answer.status_code, said in answer.json()["detail"]) == (status, True)


def test_a_withdrawal_without_a_station_took_the_array_at_once(client: TestClient, stored: Stored) -> None:
    promote(client, stored["array"], *OF_2014)
    body = {"calibration": None, **YEAR, "reason": "x"}
    answer = client.post("/v1/promotions", json=body)
    assert (answer.status_code, effective(client)) == (422, stored["array"].id)
    assert '"scope": "array"' in answer.json()["detail"]
    for wrong in ({"scope": "array", "station": "CS001"}, {"scope": "station"}, {"scope": "array", **PATH}):
        assert client.post("/v1/promotions", json={**body, **wrong}).status_code == 422
    assert client.post("/v1/promotions", json={**body, "scope": "array"}).status_code == 201
    assert effective(client) == 404
    is_path = {"calibration": stored["path"].id, **YEAR, "reason": "x", "scope": "array"}
    assert client.post("/v1/promotions", json=is_path).status_code == 422


@pytest.fixture
def job(factory: Factory, stored: Stored) -> int:
    """A job that made the versions of array, station and path, and one that failed."""
    names = ("array", "station", "path", "failed")
    with factory.database.write() as stores:
        number = stores.jobs.add(Order("refit", {}, [{}], "test", "test"), factory.clock())
        part = stores.jobs.claim("worker", lease_us=60_000_000)
        assert part is not None
        assert number is not None
        stores.jobs.complete(part, "worker", {"calibrations": [stored[name].id for name in names]}, factory.clock())
    return number


@pytest.mark.long
def test_all_versions_of_a_job_are_promoted_as_one_act(client: TestClient, stored: Stored, job: int) -> None:
    tried = client.post(f"/v1/jobs/{job}/promotion?dry_run=true", json={"reason": "looked at"})
    assert (tried.status_code, effective(client)) == (200, 404)
    done = client.post(f"/v1/jobs/{job}/promotion", json={"reason": "looked at"})
    assert done.status_code == 201
    PromotionsAnswer.model_validate(done.json())
    assert done.json()["changes"] == tried.json()["changes"]
    assert len(done.json()["changes"]) == 12, "every path of the array"
    assert done.json()["left_out"] == {stored["failed"].id: "too_few_events"}
    made = done.json()["promotions"]
    assert [one["calibration"] for one in made] == [stored[name].id for name in ("array", "station", "path")]
    assert len({one["at"] for one in made}) == 1
    assert {(one["valid_from"], one["valid_to"]) for one in made} == {("2014-01-01T00:00:00Z", "2015-01-01T00:00:00Z")}
    assert effective(client) == stored["path"].id
    assert client.post("/v1/jobs/99/promotion", json={"reason": "x"}).status_code == 404


def test_a_job_that_runs_is_not_promoted(client: TestClient, factory: Factory) -> None:
    with factory.database.write() as stores:
        number = stores.jobs.add(Order("refit", {}, [{}], "test", "test"), factory.clock())
    answer = client.post(f"/v1/jobs/{number}/promotion", json={"reason": "x"})
    assert (answer.status_code, answer.json()["detail"]) == (409, f"job {number} is queued: wait until it has ended")


def test_rollback_puts_everything_back_that_was_one_act(client: TestClient, stored: Stored, job: int) -> None:
    promote(client, stored["other"], "2014-01-01", "2014-05-01")
    before = [effective(client, at) for at in ("2014-04-30", "2014-05-01", "2015-01-01")]
    act = client.post(f"/v1/jobs/{job}/promotion", json={"reason": "x"}).json()["promotions"]
    path = f"/v1/promotions/{act[1]['promotion']}/rollback"
    assert client.post(f"{path}?dry_run=true", json={"reason": "wrong"}).json()["promotions"] == []
    undone = client.post(path, json={"reason": "wrong"})
    assert undone.status_code == 201
    PromotionsAnswer.model_validate(undone.json())
    assert [effective(client, at) for at in ("2014-04-30", "2014-05-01", "2015-01-01")] == before
    assert client.post("/v1/promotions/999/rollback", json={"reason": "x"}).status_code == 404


def test_rolling_back_what_was_superseded_took_away_what_was_in_effect(client: TestClient, stored: Stored) -> None:
    first = promote(client, stored["path"], *OF_2014)["promotion"]
    promote(client, stored["other"], "2014-01-01", "2014-05-01")
    path = f"/v1/promotions/{first}/rollback"
    (undone,) = client.post(path, json={"reason": "wrong"}).json()["promotions"]
    assert [effective(client, at) for at in ("2014-04-30", "2014-05-01")] == [stored["other"].id, 404]
    refused = client.post(path, json={"reason": "wrong"})
    assert refused.status_code == 409
    assert refused.json()["detail"] == (
        f"promotion {first} decides nowhere any more: for CS001/0/X nothing is in effect since 2020-01-01, by "
        f"promotion {undone['promotion']}: roll that back"
    )


def test_an_act_whose_answer_was_lost_is_not_done_twice(client: TestClient, job: int) -> None:
    ask = {"url": f"/v1/jobs/{job}/promotion", "json": {"reason": "x"}, "headers": {"Idempotency-Key": "mine"}}
    first, second = client.post(**ask), client.post(**ask)
    assert first.content == second.content


def test_rollbacks_in_any_order_leave_what_the_other_acts_say(
    client: TestClient, factory: Factory, stored: Stored
) -> None:
    """The oracle asks the acts that are not undone at every day; intervals overlap, some nobody closed.

    A rollback of a promotion left what another rollback had brought back of it: a withdrawn week stayed withdrawn.
    """
    rng = np.random.default_rng(11)
    paths = [Scope("CS001", 0, "X"), Scope("CS001", 0, "Y"), Scope("CS002", 1, "X")]
    ids = {Scope("CS001", 0, "X"): ["path", "other"], Scope("CS001"): ["station"], Scope(): ["array"]}

    def ask() -> list[list[str | None]]:
        with factory.database.read() as stores:
            said = [stores.ledger.answers(paths, k * DAY_US, None) for k in range(30)]
        return [[one[path][-1].calibration if one[path] else None for path in paths] for one in said]

    acts: dict[int, tuple[Scope, int, int, str | None]] = {}
    undoing: dict[int, int] = {}

    def expect() -> list[list[str | None]]:
        undone = set[int]()
        for number in sorted(undoing, reverse=True):
            undone |= set() if number in undone else {undoing[number]}
        answers: list[list[str | None]] = [[None] * len(paths) for _ in range(30)]
        for (day, k), scope in product(np.ndindex(30, len(paths)), ids):
            covering = [n for n, (s, start, end, _) in acts.items() if s == scope and start <= day < end]
            said = acts[max(left)][3] if (left := [n for n in covering if n not in undone]) else None
            if answers[day][k] is None and scope in paths[k].widening:
                answers[day][k] = said
        return answers

    for _ in range(60):
        if acts and rng.random() < 0.5:
            number = int(rng.choice([*acts, *undoing]))
            answer = client.post(f"/v1/promotions/{number}/rollback", json={"reason": "x"})
            if answer.status_code == 201:
                undoing[answer.json()["promotions"][0]["promotion"]] = number
        else:
            scope = list(ids)[rng.integers(3)]
            start, end = sorted(rng.choice(30, 2, replace=False).tolist())
            version = None if rng.random() < 0.3 else stored[str(rng.choice(ids[scope]))]
            of: dict[str, Any] = {"scope": "array"} if scope == Scope() else {"station": scope.station}
            of |= {} if scope.antenna is None else {"antenna": scope.antenna, "dipole": scope.dipole}
            until, end = (None, 30) if rng.random() < 0.3 else (format_instant(end * DAY_US), end)
            number = promote(client, version, format_instant(start * DAY_US), until, **of)["promotion"]
            acts[number] = scope, start, end, None if version is None else version.id
        assert ask() == expect()
    assert len(undoing) > 10
