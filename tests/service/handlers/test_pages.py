from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator
from dataclasses import replace
from html import escape
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from lbacal.instants import DAY_US, format_instant, parse_instant
from lbacal_core.curves.validity import Promotion, Scope
from service.app import make_app
from service.factory import Factory
from service.storage.alarms import MISFIT, OPEN, AlarmsAsked, News
from service.storage.changes import DRIFT, Change, Evidence
from service.storage.versions import Version
from tests.service.conftest import add_spectra, flat_spectra, get_job, like

PAGES = ("/", "/jobs", "/drift", "/alarms", "/models", "/stations/CS001", "/paths/CS001/0/X")


@pytest.mark.parametrize("path", PAGES)
def test_a_page_of_an_empty_service_is_whole(client: TestClient, path: str) -> None:
    answer = client.get(path)
    assert (answer.status_code, answer.headers["content-type"]) == (200, "text/html; charset=utf-8")
    assert answer.text.rstrip().endswith("</html>")
    assert "two small stations" in answer.text
    assert not re.findall(r'(?:src|href)="(?![/?#])', answer.text), "a page loads nothing from elsewhere"
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "script-src 'self';" in policy
    assert "unsafe-inline" not in policy
    assert not re.search(r"<style|<script>|style=| on[a-z]+=", answer.text), "the policy forbids them"


@pytest.fixture
def promoted(factory: Factory, stored: dict[str, Version]) -> Version:
    version = stored["path"]
    with factory.database.write() as stores:
        since, until = (parse_instant("", f"{year}-01-01") for year in (2014, 2015))
        promotion = Promotion(0, version.scope, since, until, version.id, 0, "somebody", "it is <good>")
        stores.ledger.append([promotion], factory.clock)
    return version


def test_station_antenna_and_date_lead_to_c_on_that_date(client: TestClient, promoted: Version) -> None:
    asked = {"station": "CS001", "antenna": "0", "dipole": "X", "at": "2014-06-01", "since": "2014-02-01"}
    led = client.get("/paths", params=asked, follow_redirects=False)
    assert led.status_code == 303
    assert led.headers["location"] == "/paths/CS001/0/X?since=2014-02-01&at=2014-06-01"
    page = client.get(led.headers["location"]).text
    assert f'href="/calibrations/{promoted.id}?since=2014-02-01"' in page
    assert "it is &lt;good&gt;" in page
    assert "no calibration is in effect" in client.get("/paths/CS001/0/X?at=2015-06-01").text
    assert client.get("/paths/CS001/0/X?at=May").status_code == 422
    assert client.get("/paths/CS001/77/X").status_code == 422
    version = client.get(f"/calibrations/{promoted.id}").text
    assert "CS001 antenna 0 X" in version
    assert "it is &lt;good&gt;" in version


def test_the_page_of_a_path_tells_its_flags_and_what_speaks_against_its_changes(
    client: TestClient, promoted: Version, stored: dict[str, Version], factory: Factory
) -> None:
    """It showed C, band and version alone of what API and CLI said to be uncertain in every channel."""
    address, asked = "/paths/CS001/0/X?at=2014-06-01", {"at": "2014-06-01", "station": "CS001", "antenna": 0}
    assert f"Channels: {len(promoted.curves[0].flags)} ok." in client.get(address).text
    since, until = promoted.window
    mean = Promotion(0, stored["station"].scope, since, until, stored["station"].id, 0)
    with factory.database.write() as stores:
        stores.ledger.append([mean, replace(mean, scope=promoted.scope, calibration=None)], factory.clock)
    for size in (0.05, 0.2):
        body = {"station": "CS001", "kind": "ramp", "at": {"value": "2014-02-01"}, "reason": "seen"}
        client.post("/v1/changes", json=body | {"size": {"value": size, "sigma": 0.01}}).raise_for_status()
    told, page = client.get("/v1/calibrations/effective", params=asked).json()["curves"][0], client.get(address).text
    assert set(told["flag"]) == {"uncertain"}
    assert f"Channels: {len(told['flag'])} uncertain; uncertain: {escape(told['flag_reason'])}." in page
    doubted = next(one for one in client.get("/v1/changes").json()["changes"] if one["doubts"])
    assert f"Change {doubted['id']} of 2014-02-01, in force, but {doubted['doubts'][0]}." in page


def test_numbers_drawn_are_those_of_the_api(client: TestClient, promoted: Version) -> None:
    """C was drawn with its statistical error alone, a tenth of what is told."""
    rows = list(csv.DictReader(io.StringIO(client.get(f"/calibrations/{promoted.id}?csv=curve").text)))
    asked = {"station": "CS001", "antenna": 0, "dipole": "X", "at": "2014-06-01"}
    for (told,) in (
        client.get(f"/v1/calibrations/{promoted.id}").json()["curves"],
        client.get("/v1/calibrations/effective", params=asked).json()["curves"],
    ):
        c, stat = (1e6 * np.array(told[name], dtype=float) for name in ("c", "c_sigma_stat"))
        total = np.hypot(stat, np.nan_to_num(1e6 * np.array(told["c_sigma_sys"], dtype=float)))
        shown = [row for row in rows if row["series"] == "CS001 antenna 0 X"]
        bands = [row for row in rows if row["low"]]
        values = [float(row["C (µV per ADC unit)"]) for row in shown]
        np.testing.assert_allclose([float(row["frequency (MHz)"]) for row in shown], told["frequency_mhz"])
        np.testing.assert_allclose(values, c, rtol=1e-5)
        np.testing.assert_allclose([float(row["high"]) for row in bands], [*(c + total), *(c + stat)], rtol=1e-5)


def ticks_of(page: str, title: str) -> list[str]:
    """What is written along the axes of a figure."""
    (figure,) = re.findall(rf'aria-label="{title}".*?</svg>', page, re.DOTALL)
    return re.findall(r'<text class="end"[^>]*>([^<]+)</text>', figure)


def test_c_is_drawn_on_both_scales_without_script(client: TestClient, promoted: Version) -> None:
    address, title = f"/calibrations/{promoted.id}?since=2014-02-01", "C of CS001 antenna 0 X"
    linear = client.get(address).text
    (other,) = re.findall(r'<a href="([^"]+)" aria-label="[^"]+, log scale">log</a>', linear)
    logarithmic = client.get(f"/calibrations/{promoted.id}{other.replace('&amp;', '&')}").text
    (back,) = re.findall(r'<a href="([^"]+)" aria-label="[^"]+, linear scale">linear</a>', logarithmic)
    assert (other, back) == ("?since=2014-02-01&amp;scale=log", "?since=2014-02-01")
    steps = np.diff([float(text) for text in ticks_of(linear, title)])
    assert np.ptp(steps) == pytest.approx(0.0, abs=1e-9)
    assert np.ptp(np.diff([float(text) for text in ticks_of(logarithmic, title)])) > 0.0
    assert client.get(address, params={"scale": "square"}).status_code == 422


@pytest.mark.parametrize("path", [*PAGES, "/stations/CS001"])
def test_every_page_obeys_a_range_and_hands_it_on(client: TestClient, path: str) -> None:
    page = client.get(path, params={"since": "2014-02-01", "until": "2014-07-01"}).text
    assert 'name="since" value="2014-02-01"' in page
    links = re.findall(r'<a href="(/[a-z]*)[?"]', page)
    kept = re.findall(r'<a href="(/[a-z]*)\?since=2014-02-01&amp;until=2014-07-01"', page)
    assert set(links) - {"/docs"} == set(kept)
    assert client.get(path, params={"since": "2014-02-01", "until": "2014-01-01"}).status_code == 422
    assert client.get(path, params={"since": "yesterday"}).status_code == 422
    assert client.get(path, params={"sinse": "2014-02-01"}).status_code == 422


def test_an_unknown_figure_is_refused_with_those_that_there_are(client: TestClient) -> None:
    answered = client.get("/?csv=x")
    assert answered.status_code == 422
    assert "coverage, waiting" in answered.text
    shown = client.get("/?csv=coverage")
    assert shown.headers["content-type"] == "text/csv; charset=utf-8"


BROWSER = {"Accept": "text/html,application/xhtml+xml,*/*;q=0.8"}
REFUSED = "the key is unknown, expired or revoked"


@pytest.fixture
def closed(factory: Factory) -> Iterator[Factory]:
    with like(factory, open_reads=False) as made:
        yield made


def browse(factory: Factory, **more: Any) -> TestClient:
    app = make_app(factory)
    given = {"base_url": "http://127.0.0.1", **more}
    return TestClient(app, raise_server_exceptions=False, headers=BROWSER, follow_redirects=False, **given)


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
    word = word_of(browser.get("/log-in").text)
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
    cookie = answered.headers["set-cookie"]
    for part in ("HttpOnly", "SameSite=strict", "Path=/"):
        assert part in cookie
    assert key not in cookie, "the session does not hold the key"
    assert "Max-Age" not in cookie, "it ends with the browser"
    assert "Secure" not in cookie, "this one came from the machine itself"
    shown = browser.get("/jobs")
    assert shown.status_code == 200
    assert key not in shown.text
    assert browser.get("/v1/jobs").status_code == 200
    closed.keys.revoke(number)
    gone = browser.get("/jobs")
    assert gone.status_code == 401
    assert "log in again" in gone.text


@pytest.mark.parametrize("base_url", ["https://here", "https://127.0.0.1", "http://here"])
def test_a_session_travels_over_tls_alone_but_on_the_machine_itself(closed: Factory, base_url: str) -> None:
    _, key = closed.keys.create(("read",))
    with browse(closed, base_url=base_url) as browser:
        answered = log_in(browser, key)
        if base_url.startswith("https"):
            assert "Secure" in answered.headers["set-cookie"]
        else:
            assert answered.status_code == 403, "a browser does not send the cookie of the form back either"


def test_a_session_ends_with_its_key_with_a_log_out_and_after_half_a_day(
    browser: TestClient, closed: Factory, clock: Any
) -> None:
    number, key = closed.keys.create(("read",))
    log_in(browser, key)
    stolen = browser.cookies["lbacal_session"]
    assert browser.get("/jobs").status_code == 200
    assert browser.post("/log-out", data={"word": browser.cookies["lbacal_form"]}).status_code == 303
    browser.cookies.set("lbacal_session", stolen, domain="127.0.0.1")
    assert browser.get("/jobs").status_code == 401, "a session that was logged out answers nobody"
    log_in(browser, key)
    clock.now += DAY_US // 2
    assert browser.get("/jobs").status_code == 401
    log_in(browser, key)
    assert browser.get("/jobs").status_code == 200
    closed.keys.revoke(number)
    assert browser.get("/jobs").status_code == 401


@pytest.mark.parametrize("key", ["", "wrong", "lbacal_é", "x\r\nSet-Cookie: a=b"])
def test_a_wrong_key_is_told_so_on_the_page(browser: TestClient, key: str) -> None:
    refused = log_in(browser, key)
    assert refused.status_code == 401
    assert REFUSED in refused.text
    assert "lbacal_session" not in refused.headers.get("set-cookie", "")


def test_a_form_that_another_site_sends_is_refused(browser: TestClient, closed: Factory) -> None:
    _, key = closed.keys.create(("read",))
    other = browse(closed)
    stolen = word_of(other.get("/").text)
    browser.get("/")
    for data in ({"key": key}, {"key": key, "word": ""}, {"key": key, "word": stolen}, {"key": key, "word": "é"}):
        assert browser.post("/log-in", data=data).status_code == 403
    assert log_in(browser, key).status_code == 303
    assert browser.post("/log-out", data={"word": stolen}).status_code == 403
    page = browser.get("/").text
    assert browser.post("/log-out", data={"word": word_of(page)}).status_code == 303
    assert browser.get("/").status_code == 401


def test_the_session_of_an_admin_opens_reads_of_the_interface_and_changes_nothing(
    browser: TestClient, closed: Factory
) -> None:
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


def act(visitor: TestClient, name: str, **fields: str) -> Any:
    """Send a form of a page as its browser does."""
    word = visitor.cookies.get("lbacal_form", domain="127.0.0.1.local") or visitor.cookies.get("lbacal_form")
    return visitor.post(f"/acts/{name}", data={"word": word, "reason": "snow lay on it", **fields})


def admit(visitor: TestClient, factory: Factory, *scopes: str) -> int:
    number, key = factory.keys.create(scopes)
    assert log_in(visitor, key).status_code == 303
    return number


def test_an_admin_dismisses_a_change_on_the_page_and_takes_that_back(
    visitor: TestClient, factory: Factory, change: int
) -> None:
    page = visitor.get("/drift").text
    assert "2014-06-01 &plusmn; 2.0 d" in page
    assert "/acts/" not in page, "who is not logged in decides nothing"
    number = admit(visitor, factory, "calibrations:promote")
    assert 'name="decision" value="dismissed"' in visitor.get("/drift").text
    wanted = {"target": str(change), "decision": "dismissed"}
    looked = act(visitor, "decide", **wanted)
    assert looked.status_code == 200
    assert f"Change {change} of CS001 antenna 1 on 2014-06-01 is dismissed" in looked.text
    assert 'name="sure" value="yes"' in looked.text
    assert factory.changes.list_all()[0].said is None, "looking decides nothing"
    dismissed = act(visitor, "decide", **wanted, sure="yes")
    assert (dismissed.status_code, dismissed.headers["location"]) == (303, "/drift#changes")
    (kept,) = factory.changes.list_all()
    assert (kept.stands, kept.said is not None and kept.said.reason) == (False, "snow lay on it")
    page = visitor.get("/drift").text
    assert "snow lay on it" in page
    assert 'name="decision" value="in_force"' in page
    assert 'name="decision" value="dismissed"' not in page
    assert act(visitor, "decide", **wanted).status_code == 409
    assert act(visitor, "decide", target=str(change), decision="in_force", sure="yes").status_code == 303
    assert factory.changes.list_all()[0].stands
    factory.keys.revoke(number)
    assert act(visitor, "decide", **wanted).status_code == 401


def test_nothing_changes_without_a_session_that_may_and_a_form_of_ours(
    visitor: TestClient, factory: Factory, change: int
) -> None:
    wanted = {"target": str(change), "decision": "dismissed", "sure": "yes"}
    visitor.get("/log-in")
    assert act(visitor, "decide", **wanted).status_code == 401, "nobody is logged in"
    admit(visitor, factory, "read", "refits:run")
    assert act(visitor, "decide", **wanted).status_code == 403
    _, good = factory.keys.create(("admin",))
    assert log_in(visitor, good).status_code == 303
    for word in ("", "stolen"):
        assert act(visitor, "decide", **{**wanted, "word": word}).status_code == 403
    assert visitor.post("/acts/decide", json=wanted).status_code == 415
    assert act(visitor, "decide", **{**wanted, "reason": " "}).status_code == 422
    assert act(visitor, "decide", **wanted, more="x").status_code == 422
    assert act(visitor, "decide", **{**wanted, "target": "x"}).status_code == 422
    assert act(visitor, "nothing", **wanted).status_code == 404
    assert visitor.get("/acts/decide").status_code == 405
    assert factory.changes.list_all()[0].said is None


def test_a_problem_is_said_to_be_known_until_a_date(visitor: TestClient, factory: Factory, clock: Any) -> None:
    admit(visitor, factory, "refits:run")
    with factory.database.write() as stores:
        number = stores.alarms.raise_alarm(News(MISFIT, Scope("CS001"), "", "it misfits"), clock.now)
    wanted = {"target": str(number), "sure": "yes"}
    assert f'name="target" value="{number}"' in visitor.get("/alarms").text
    until = format_instant(clock.now + 40 * DAY_US)[:10]
    assert act(visitor, "acknowledge", **wanted, until="2001-01-01").status_code == 422
    assert act(visitor, "acknowledge", **wanted, until=until).headers["location"] == "/alarms"
    page = visitor.get("/alarms").text
    assert f"until {until}: snow lay on it" in page
    clock.now += 41 * DAY_US
    assert [one.number for one in lasting(factory)] == [number], "it is told again"
    admit(visitor, factory, "refits:run")
    assert act(visitor, "acknowledge", **wanted, until="").status_code == 303, "without a date it is for good"
    assert lasting(factory) == []


def lasting(factory: Factory) -> Any:
    return factory.alarms.newest(AlarmsAsked((OPEN,), 10))


def test_a_version_is_put_in_effect_and_rolled_back_each_after_a_look(
    visitor: TestClient, factory: Factory, stored: dict[str, Version]
) -> None:
    version = stored["path"]
    admit(visitor, factory, "calibrations:promote")
    assert f'name="calibration" value="{version.id}"' in visitor.get(f"/calibrations/{version.id}").text
    wanted = {"target": version.id, "calibration": version.id, "valid_from": "2014-01-01", "valid_to": "2015-01-01"}
    looked = act(visitor, "promote", **wanted)
    assert "CS001 antenna 0 X" in looked.text
    asked = {"station": "CS001", "antenna": 0, "dipole": "X", "at": "2014-06-01"}
    assert visitor.get("/v1/calibrations/effective", params=asked).status_code == 404
    assert act(visitor, "promote", **wanted, sure="yes").headers["location"] == f"/calibrations/{version.id}"
    assert visitor.get("/v1/calibrations/effective", params=asked).json()["curves"][0]["calibration"] == version.id
    page = visitor.get(f"/calibrations/{version.id}").text
    (number,) = re.findall(r'action="/acts/roll-back">.*?name="target" value="(\d+)"', page, re.DOTALL)
    assert "nothing" in act(visitor, "roll-back", target=number).text
    assert act(visitor, "roll-back", target=number, sure="yes").status_code == 303
    assert visitor.get("/v1/calibrations/effective", params=asked).status_code == 404


@pytest.mark.usefixtures("stored")
def test_tag_refit_stop_and_try_again_are_forms_too(visitor: TestClient, factory: Factory) -> None:
    admit(visitor, factory, "admin")
    assert "The tag paper names what the ledger says now, for good." in act(visitor, "tag", target="paper").text
    assert act(visitor, "tag", target="paper", sure="yes").status_code == 303
    assert [tag.name for tag in factory.database.look(lambda stores: stores.tags.after("", 10))] == ["paper"]
    assert act(visitor, "tag", target="no name").status_code == 422
    window = {"since": "2014-01-01", "until": "2015-01-01", "scope": "antenna", "station": "CS001"}
    asked = act(visitor, "refit", **window, antenna="1", dipole="X", promote="yes")
    assert "Scope antenna of CS001 antenna 1 X is fitted over 2014-01-01 to 2015-01-01" in asked.text
    assert factory.database.look(lambda stores: stores.jobs.newest()) == []
    done = act(visitor, "refit", **window, antenna="1", dipole="X", promote="yes", sure="yes")
    assert done.headers["location"] == "/jobs"
    (job,) = factory.database.look(lambda stores: stores.jobs.newest())
    assert {name: job.request[name] for name in ("antenna", "promote", "reason")} == {
        "antenna": 1, "promote": True, "reason": "snow lay on it",
    }  # fmt: skip
    assert act(visitor, "cancel", target=str(job.number), sure="yes").status_code == 303
    assert get_job(factory, job.number).state == "cancelled"
    log = visitor.get(f"/jobs/{job.number}").text
    assert "cancelled by" in log
    assert "snow lay on it" in log
    assert f'<a href="/jobs/{job.number}">job {job.number}</a>' in visitor.get("/jobs").text
    assert visitor.get("/jobs/99").status_code == 404
    assert act(visitor, "retry", target=str(job.number), sure="yes").status_code == 303
    again, _ = factory.database.look(lambda stores: stores.jobs.newest())
    assert again.request == {**job.request, "reason": "snow lay on it"}


@pytest.mark.parametrize("back", ["https://evil.example", "//evil.example", "/\\evil.example"])
def test_a_form_leads_back_to_no_other_site(visitor: TestClient, factory: Factory, change: int, back: str) -> None:
    admit(visitor, factory, "admin")
    looked = act(visitor, "decide", target=str(change), decision="dismissed", back=back)
    assert '<a href="/">Leave everything as it is</a>' in looked.text


def test_the_weather_at_the_events_stands_in_every_life(client: TestClient, factory: Factory) -> None:
    days = [parse_instant("", day) / 1e6 for day in ("2014-01-05", "2014-01-20", "2014-06-05")]
    rows = [(f"e{k}", at, "CS001", 0, "X") for k, at in enumerate(days)]
    weather = {"temperature_c": np.array([2.0, 6.0, 20.0]), "rain_mm_h": np.array([0.0, np.nan, 1.0])}
    add_spectra(factory, replace(flat_spectra(*rows), environment=weather))
    for address in ("/paths/CS001/0/X", "/stations/CS001", "/drift"):
        asked = {"since": "2014-01-01", "until": "2015-01-01", "csv": "env-temperature_c"}
        told = [row for row in csv.DictReader(io.StringIO(client.get(address, params=asked).text)) if not row["low"]]
        assert [(row["date (UTC)"][:7], float(row["temperature (°C)"])) for row in told] == [
            ("2014-01", 4.0),
            ("2014-06", 20.0),
        ]
    page = client.get("/paths/CS001/0/X", params={"since": "2014-03-01", "until": "2015-01-01"}).text
    assert "2014-06: 1, 1 events" in page
    assert "2014-01: " not in page


HOSTILE = "\"><script>alert(1)</script>'{{7*7}}"


def test_what_a_user_wrote_is_text_on_every_page(visitor: TestClient, factory: Factory, change: int) -> None:
    admit(visitor, factory, "admin")
    decided = act(visitor, "decide", target=str(change), decision="dismissed", reason=HOSTILE)
    shown = [decided.text]
    act(visitor, "decide", target=str(change), decision="dismissed", reason=HOSTILE, sure="yes")
    with factory.database.write() as stores:
        stores.alarms.raise_alarm(News(MISFIT, Scope("CS001"), "", HOSTILE), factory.clock())
    addresses = (*PAGES, f"/paths/CS001/0/X?at={HOSTILE}", f"/calibrations/{HOSTILE}", f"/?csv={HOSTILE}")
    addresses += (f"/?scale={HOSTILE}",)
    shown += [visitor.get(address).text for address in addresses]
    assert "alert(1)" in "".join(shown)
    for page in shown:
        assert "<script>" not in page
        assert "49" not in re.findall(r"alert\(1\).{0,60}", page)
