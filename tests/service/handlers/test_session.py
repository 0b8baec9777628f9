"""With `LBACAL_OPEN_READS=false` the pages served nobody: a browser cannot send the header Authorization."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest
from fastapi.testclient import TestClient

from service.app import make_app
from service.config import Settings
from service.factory import Factory

BROWSER = {"Accept": "text/html,application/xhtml+xml,*/*;q=0.8"}
REFUSED = "the key is unknown, expired or revoked"


@pytest.fixture
def closed(database_url: str, instrument_file: Any, clock: Any) -> Iterator[Factory]:
    settings = Settings(database_url=database_url, instrument=str(instrument_file), open_reads=False)
    made = Factory(settings, clock)
    yield made
    made.database.close()


@pytest.fixture
def browser(closed: Factory) -> Iterator[TestClient]:
    with TestClient(make_app(closed), raise_server_exceptions=False, headers=BROWSER, follow_redirects=False) as made:
        yield made


def word_of(page: str) -> str:
    found = re.search(r'name="word" value="([^"]+)"', page)
    assert found is not None, page
    return found[1]


def log_in(browser: TestClient, key: str, address: str = "/jobs") -> Any:
    word = word_of(browser.get("/jobs").text)
    return browser.post("/log-in", data={"word": word, "key": key, "address": address})


def test_a_page_asks_for_a_key_and_shows_itself_to_whoever_has_one(browser: TestClient, closed: Factory) -> None:
    number, key = closed.keys.create(("read",))
    asked = browser.get("/jobs")
    assert (asked.status_code, asked.headers["cache-control"]) == (401, "no-store")
    assert "<h1>Log in</h1>" in asked.text
    assert REFUSED not in asked.text
    answered = log_in(browser, key)
    assert (answered.status_code, answered.headers["location"]) == (303, "/jobs")
    for part in ("HttpOnly", "SameSite=lax", "Path=/", "Max-Age=43200"):
        assert part in answered.headers["set-cookie"]
    assert "Secure" not in answered.headers["set-cookie"], "this one came without TLS"
    shown = browser.get("/jobs")
    assert shown.status_code == 200
    assert key not in shown.text
    assert browser.get("/v1/jobs").status_code == 200
    closed.keys.revoke(number)
    gone = browser.get("/jobs")
    assert gone.status_code == 401
    assert REFUSED in gone.text


def test_a_log_in_over_tls_is_kept_from_other_connections(closed: Factory) -> None:
    _, key = closed.keys.create(("read",))
    with TestClient(make_app(closed), base_url="https://here", headers=BROWSER, follow_redirects=False) as browser:
        assert "Secure" in log_in(browser, key).headers["set-cookie"]


@pytest.mark.parametrize("key", ["", "wrong", "lbacal_é", "x\r\nSet-Cookie: a=b"])
def test_a_wrong_key_is_told_so_on_the_page(browser: TestClient, key: str) -> None:
    refused = log_in(browser, key)
    assert refused.status_code == 401
    assert REFUSED in refused.text
    assert "lbacal_key" not in refused.headers.get("set-cookie", "")


def test_a_form_that_another_site_sends_is_refused(browser: TestClient, closed: Factory) -> None:
    _, key = closed.keys.create(("read",))
    other = TestClient(browser.app, headers=BROWSER, follow_redirects=False)
    stolen = word_of(other.get("/").text)
    browser.get("/")
    for data in ({"key": key}, {"key": key, "word": ""}, {"key": key, "word": stolen}, {"key": key, "word": "é"}):
        assert browser.post("/log-in", data=data).status_code == 403
    assert log_in(browser, key).status_code == 303
    assert browser.post("/log-out", data={"word": stolen}).status_code == 403
    page = browser.get("/").text
    assert browser.post("/log-out", data={"word": word_of(page)}).status_code == 303
    assert browser.get("/").status_code == 401


def test_the_kept_key_of_an_admin_opens_reads_and_changes_nothing(browser: TestClient, closed: Factory) -> None:
    _, key = closed.keys.create(("admin",))
    assert log_in(browser, key).status_code == 303
    assert browser.get("/v1/events").status_code == 200
    body = {"scope": "station", "since": "2014-01-01", "until": "2015-01-01", "reason": "forged"}
    assert browser.post("/v1/refits", json=body, headers={"Accept": "*/*"}).status_code == 401
    assert browser.post("/v1/jobs/1/cancel", headers={"Accept": "*/*"}).status_code == 401
    assert browser.get("/v1/jobs").json()["jobs"] == []


@pytest.mark.parametrize("address", ["//evil.example", "/\\evil.example", "https://evil.example", "", "/\r\nx: y"])
def test_a_log_in_leads_to_no_other_site(browser: TestClient, closed: Factory, address: str) -> None:
    _, key = closed.keys.create(("read",))
    assert log_in(browser, key, address).headers["location"] == "/"


def test_guessing_keys_through_the_form_is_slowed_down(browser: TestClient) -> None:
    codes = [log_in(browser, f"guess{k}").status_code for k in range(12)]
    assert codes == [401] * 10 + [429] * 2


@pytest.mark.parametrize("body", [b"\xff\xfe", b"a=1&" * 50, b"x" * 70_000])
def test_a_form_that_is_none_is_refused(browser: TestClient, body: bytes) -> None:
    sent = browser.post("/log-in", content=body, headers={"Content-Type": "application/x-www-form-urlencoded"})
    assert sent.status_code in (403, 413, 422)
    assert sent.headers["content-type"].startswith("text/html")


def test_a_wrong_address_gave_a_browser_raw_json_and_is_a_page_now(client: TestClient) -> None:
    for path, status in (("/nowhere", 404), ("/calibrations/none", 404), ("/stations/CS999", 422)):
        shown = client.get(path, headers=BROWSER)
        assert (shown.status_code, shown.headers["content-type"]) == (status, "text/html; charset=utf-8")
        assert client.get(path).headers["content-type"] == "application/problem+json"
    assert client.get("/v1/nothing", headers=BROWSER).headers["content-type"] == "application/problem+json"
