from __future__ import annotations

import pytest
from fastapi.testclient import TestClient


@pytest.mark.long
@pytest.mark.parametrize(
    "path", ["/healthz", "/v1/events", "/", "/v1/calibrations/effective?at=2014-05-01", "/openapi.json"]
)
def test_head_answers_what_get_answers_without_the_body(client: TestClient, path: str) -> None:
    get, head = client.get(path), client.head(path)
    assert (head.status_code, head.content) == (get.status_code, b"")
    for name in ("content-type", "content-length", "etag", "cache-control", "content-security-policy"):
        assert head.headers.get(name) == get.headers.get(name)


def test_head_of_what_the_client_holds_is_not_modified(client: TestClient) -> None:
    held = {"If-None-Match": client.head("/v1/events").headers["etag"]}
    assert client.head("/v1/events", headers=held).status_code == 304


def test_head_of_a_route_that_only_writes_is_not_allowed(client: TestClient) -> None:
    assert client.head("/v1/spectra").status_code == 405
