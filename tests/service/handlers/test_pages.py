from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest
from fastapi.testclient import TestClient

from lbacal.instants import DAY_US, format_instant, parse_instant
from lbacal_core.curves.validity import Promotion, Scope
from service.app import make_app
from service.factory import Factory
from service.storage.alarms import MISFIT, OPEN, AlarmsAsked, News
from service.storage.changes import DRIFT, Change, Evidence
from service.storage.versions import Version
from tests.service.conftest import like

PAGES = ("/", "/jobs", "/drift", "/alarms", "/models", "/stations/CS001")


@pytest.mark.parametrize("path", PAGES)
def test_a_page_of_an_empty_service_is_whole(client: TestClient, path: str) -> None:
    answer = client.get(path)
    assert (answer.status_code, answer.headers["content-type"]) == (200, "text/html; charset=utf-8")
    assert answer.text.rstrip().endswith("</html>")
    assert "two small stations" in answer.text
    assert not re.findall(r'(?:src|href)="(?!/)', answer.text), "a page loads nothing from elsewhere"
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "script-src 'self';" in policy


def test_a_version_has_a_page_and_a_month_leads_to_it(
    factory: Factory, client: TestClient, stored: dict[str, Version]
) -> None:
    version, month = stored["path"], "/stations/CS001/0/X/2014-06"
    assert client.get(month).status_code == 404
    with factory.database.write() as stores:
        since, until = (parse_instant("", f"{year}-01-01") for year in (2014, 2015))
        promotion = Promotion(0, version.scope, since, until, version.id, 0, "somebody", "it is <good>")
        stores.ledger.append([promotion], factory.clock)
    led = client.get(month, follow_redirects=False)
    assert (led.status_code, led.headers["location"]) == (303, f"/calibrations/{version.id}")
    page = client.get(led.headers["location"]).text
    assert "it is &lt;good&gt;" in page
    assert "CS001 antenna 0 X" in page
    assert client.get("/stations/CS001/0/X/2015-06").status_code == 404
    assert client.get("/stations/CS001/0/X/May").status_code == 422
    assert client.get("/stations/CS001/77/X/2014-05").status_code in (404, 422)


BROWSER = {"Accept": "text/html,application/xhtml+xml,*/*;q=0.8"}
REFUSED = "the key is unknown, expired or revoked"


@pytest.fixture
def closed(factory: Factory) -> Iterator[Factory]:
    with like(factory, open_reads=False) as made:
        yield made


def browse(factory: Factory, **more: Any) -> TestClient:
    app = make_app(factory)
    return TestClient(app, raise_server_exceptions=False, headers=BROWSER, follow_redirects=False, **more)


@pytest.fixture
def browser(closed: Factory) -> Iterator[TestClient]:
    with browse(closed) as made:
        yield made


def test_the_pages_are_closed_where_reads_are(closed: Factory) -> None:
    with TestClient(make_app(closed)) as stranger:
        assert {stranger.get(path, headers={"Accept": "*/*"}).status_code for path in PAGES} == {401}


def word_of(page: str) -> str:
    found = re.search(r'name="word" value="([^"]+)"', page)
    assert found is not None, page
    return found[1]


def log_in(browser: TestClient, key: str, address: str = "/jobs") -> Any:
    word = word_of(browser.get("/jobs").text)
    return browser.post("/log-in", data={"word": word, "key": key, "address": address})


def test_a_page_asks_for_a_key_and_shows_itself_to_whoever_has_one(browser: TestClient, closed: Factory) -> None:
    """With `LBACAL_OPEN_READS=false` the pages served nobody: a browser cannot send the header Authorization."""
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
    with browse(closed, base_url="https://here") as browser:
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
    for path, status in (("/changes", 404), ("/calibrations/none", 404), ("/stations/CS999", 422)):
        shown = client.get(path, headers=BROWSER)
        assert (shown.status_code, shown.headers["content-type"]) == (status, "text/html; charset=utf-8")
        assert shown.text.rstrip().endswith("</html>")
        assert client.get(path).headers["content-type"] == "application/problem+json"
    assert client.get("/v1/nothing", headers=BROWSER).headers["content-type"] == "application/problem+json"


DATE = parse_instant("date", "2014-06-01")


@pytest.fixture
def visitor(factory: Factory) -> Iterator[TestClient]:
    with browse(factory) as made:
        yield made


@pytest.fixture
def change(factory: Factory) -> int:
    with factory.database.write() as stores:
        found = Change("CS001", ((1, None),), "step", DATE, 2 * DAY_US)
        return stores.changes.note(found, Evidence(DRIFT, "", 9.0, DATE)).number


def send(visitor: TestClient, address: str, key: str, **fields: str) -> Any:
    return visitor.post(address, data={"reason": "snow lay on it", "key": key, **fields})


def test_an_admin_dismisses_a_change_on_the_page_and_takes_that_back(
    visitor: TestClient, factory: Factory, change: int
) -> None:
    number, key = factory.keys.create(("calibrations:promote",))
    page = visitor.get("/drift").text
    assert "2014-06-01 &plusmn; 2.0 d" in page
    assert f'action="/changes/{change}/dismissed"' in page
    dismissed = send(visitor, f"/changes/{change}/dismissed", key)
    assert (dismissed.status_code, dismissed.headers["location"]) == (303, "/drift#changes")
    (kept,) = factory.changes.list_all()
    assert (kept.stands, kept.said is not None and kept.said.reason) == (False, "snow lay on it")
    page = visitor.get("/drift").text
    assert "snow lay on it" in page
    assert f'action="/changes/{change}/in_force"' in page
    assert f'action="/changes/{change}/dismissed"' not in page
    assert send(visitor, f"/changes/{change}/dismissed", key).status_code == 409
    assert send(visitor, f"/changes/{change}/in_force", key).status_code == 303
    assert factory.changes.list_all()[0].stands
    factory.keys.revoke(number)
    assert send(visitor, f"/changes/{change}/dismissed", key).status_code == 403


@pytest.mark.parametrize("address", ["/changes/{}/dismissed", "/changes/{}/in_force"])
def test_nothing_changes_without_a_key_that_may(
    visitor: TestClient, factory: Factory, change: int, address: str
) -> None:
    _, reads = factory.keys.create(("read", "refits:run"))
    _, good = factory.keys.create(("admin",))
    visitor.cookies.set("lbacal_key", good)
    where = address.format(change)
    refused = send(visitor, where, "wrong")
    assert (refused.status_code, "the key is unknown, expired or revoked" in refused.text) == (403, True)
    assert "<h1>Forbidden</h1>" in refused.text, "a page, and not a log-in that leads nowhere"
    assert [send(visitor, where, key).status_code for key in ("", reads)] == [403, 403]
    assert visitor.post(where, data={"reason": "x"}).status_code == 403, "the kept key opens reads only"
    assert visitor.post(where, json={"reason": "x", "key": good}).status_code == 415
    assert send(visitor, where, good, reason=" ").status_code == 422
    assert send(visitor, where, good, more="x").status_code == 422
    assert visitor.get(where).status_code == 405
    assert factory.changes.list_all()[0].said is None


def test_a_problem_is_said_to_be_known_until_a_date(visitor: TestClient, factory: Factory, clock: Any) -> None:
    _, key = factory.keys.create(("refits:run",))
    with factory.database.write() as stores:
        number = stores.alarms.raise_alarm(News(MISFIT, Scope("CS001"), "", "it misfits"), clock.now)
    address = f"/alarms/{number}/acknowledgement"
    assert f'action="{address}"' in visitor.get("/alarms").text
    until = format_instant(clock.now + 40 * DAY_US)[:10]
    assert send(visitor, address, key, until="2001-01-01").status_code == 422
    assert send(visitor, address, key, until=until).headers["location"] == "/alarms"
    page = visitor.get("/alarms").text
    assert f"until {until}: snow lay on it" in page
    clock.now += 41 * DAY_US
    assert [one.number for one in lasting(factory)] == [number], "it is told again"
    assert send(visitor, address, key, until="").status_code == 303, "without a date it is for good"
    assert lasting(factory) == []


def lasting(factory: Factory) -> Any:
    return factory.alarms.newest(AlarmsAsked((OPEN,), 10))
