from __future__ import annotations

import pytest
from fastapi.testclient import TestClient

from service.app import make_app
from service.errors import TooManyError
from service.factory import Factory
from service.handlers.edge import BAD_KEYS_AT_ONCE, Buckets, KeyGuard


def test_a_tenth_wrong_key_is_told_to_wait_and_a_good_one_is_not(client: TestClient) -> None:
    assert client.get("/v1/jobs").status_code == 200
    wrong = [client.get("/v1/jobs", headers={"Authorization": f"Bearer no{k}"}) for k in range(BAD_KEYS_AT_ONCE + 1)]
    assert [answer.status_code for answer in wrong] == [401] * BAD_KEYS_AT_ONCE + [429]
    assert int(wrong[-1].headers["retry-after"]) > 0
    assert client.get("/v1/jobs").status_code == 200


def test_a_flood_is_told_to_wait(factory: Factory) -> None:
    settings = factory.settings.model_copy(update={"max_rate": 0.001})
    with TestClient(make_app(Factory(settings, factory.clock))) as client:
        answer = client.get("/healthz")
    assert (answer.status_code, answer.json()["type"]) == (429, "urn:lbacal:too_many")


def test_a_bucket_fills_with_time() -> None:
    now = [0.0]
    buckets = Buckets(rate=2.0, size=3.0, clock=lambda: now[0])
    assert [buckets.take("a") for _ in range(4)] == [0, 0, 0, 0.5]
    assert buckets.take("b") == 0, "one address does not take from another"
    now[0] = 0.5
    assert [buckets.take("a"), buckets.take("a")] == [0, 0.5]


def test_a_good_key_of_many_at_once_is_not_a_flood_of_wrong_ones_and_a_revoked_one_counts() -> None:
    guard = KeyGuard(clock=lambda: 0.0)
    for _ in range(3 * BAD_KEYS_AT_ONCE):
        guard.require_patience("a", "key")  # all ask before the first is known to be good
    guard.note_good("key")
    for _ in range(BAD_KEYS_AT_ONCE):
        guard.note_refused("a", "other")
    guard.require_patience("a", "key")
    guard.note_refused("a", "key")
    with pytest.raises(TooManyError):
        guard.require_patience("a", "key")
    guard.require_patience("b", "key")
