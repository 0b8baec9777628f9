from __future__ import annotations

import re
from typing import Any

import pytest
from fastapi.testclient import TestClient

from service.app import _list_routes

PATH = {"station": "CS001", "antenna": "0", "dipole": "X"}
WRONG = {
    "station": ("cs001", "(is CS001 meant?)"),
    "dipole": ("x", "(is X meant?)"),
    "tag": ("papr", "is paper meant?"),
}
CHANGE = {"at": {"value": "2014-06-01"}, "reason": "test"}
YEAR = {"since": "2014-01-01", "until": "2015-01-01", "reason": "test"}
WITHDRAWN = {"calibration": None, "valid_from": "2014-01-01", "reason": "test"}


def test_every_route_that_reads_offers_the_name_that_is_near(client: TestClient) -> None:
    """Alarms, changes, events, versions and investigations of "cs001" were none, as if all were well."""
    client.put("/v1/tags/paper", json={"reason": "test"})
    asked = set()
    for route, methods in client.get("/openapi.json").json()["paths"].items():
        known = {one["name"]: one for one in methods.get("get", {}).get("parameters", ())}
        whole = {
            name for name in known if name in PATH and (known[name]["in"] == "path" or known[name].get("required"))
        }
        for name, (wrong, meant) in WRONG.items():
            if name not in known:
                continue
            # a dipole is that of a path
            with_path = {**PATH, name: wrong} if name == "dipole" else {n: PATH[n] for n in whole} | {name: wrong}
            query = {one: value for one, value in with_path.items() if known.get(one, {}).get("in") == "query"}
            at = {"at": "2014-06-01"} if "at" in known else {}
            answer = client.get(re.sub(r"{(\w+)}", lambda m: with_path[m[1]], route), params=query | at)  # noqa: B023
            is_refused = answer.status_code in (404, 422) and meant in answer.json()["detail"]
            asked.add((route, name, is_refused or answer.text))
    assert {route for route, *_ in asked} >= {"/v1/alarms", "/v1/changes", "/v1/events", "/v1/stations/{station}/life"}
    assert [one for one in asked if one[-1] is not True] == []


@pytest.mark.parametrize(
    ("route", "body"),
    [
        ("/v1/promotions", {**WITHDRAWN, "station": "cs001"}),
        ("/v1/refits", {**YEAR, "scope": "station", "station": "cs001"}),
        ("/v1/investigations", {**YEAR, "station": "cs001"}),
        ("/v1/changes", {**CHANGE, "station": "cs001"}),
        ("/v1/changes", {**CHANGE, "paths": [{"station": "cs001", "antenna": 0}]}),
    ],
)  # fmt: skip
def test_every_route_that_acts_offers_the_station_that_is_near(
    client: TestClient, route: str, body: dict[str, Any]
) -> None:
    answer = client.post(route, json=body)
    assert (answer.status_code, "(is CS001 meant?)" in answer.json()["detail"]) == (422, True), answer.text


def test_every_route_refuses_a_parameter_that_it_does_not_have_and_whoever_takes_nothing_that_it_answers(
    client: TestClient,
) -> None:
    """A misspelt filter would answer about everything."""
    answered = []
    for router in _list_routes():
        for k, route in enumerate(router.original_router.routes):
            address = re.sub(r"{(\w+)(:path)?}", lambda m: PATH.get(m[1], "1"), route.path)
            (method,) = route.methods
            is_file = route.path.startswith("/static")  # which has the type that it has
            asked: list[tuple[dict[str, Any], int]] = [({"params": {"statoin": "CS001"}}, 422)]
            asked += [({"headers": {"Accept": "application/x-none"}}, 406)] * (k == 0 and not is_file)
            for how, status in asked:
                answer = client.request(method, address, **how)
                answered.append((method, route.path, answer.status_code, status))
    assert len(answered) > 60
    assert [one for one in answered if one[2] != one[3]] == []
