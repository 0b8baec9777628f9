from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Locator, Page, expect

from lbacal.instants import DAY_US, parse_instant
from service.config import Settings
from service.factory import Factory
from service.storage.changes import DRIFT, Change, Evidence
from validation.running.processes import Process, find_free_port, is_ready, running, wait_until


@pytest.fixture
def page(browser: Browser, service: Any) -> Any:
    """A page that notes whatever a user should never see: console output, script errors, requests off the host."""
    made = browser.new_page(viewport={"width": 1240, "height": 900})
    noted: list[str] = []
    made.on("console", lambda message: noted.append(f"console {message.type}: {message.text}"))
    made.on("pageerror", lambda error: noted.append(f"script: {error}"))
    made.on("request", lambda request: None if request.url.startswith(service.url) else noted.append(request.url))
    made.on("response", lambda answer: noted.append(f"{answer.status} {answer.url}") if answer.status >= 400 else None)
    yield made
    assert noted == []
    made.close()


@pytest.mark.parametrize("address", ["/", "/alarms", "/jobs", "/docs"])
def test_a_page_shows_without_complaint(page: Page, service: Any, address: str) -> None:
    page.goto(service.url + address, wait_until="networkidle")
    expect(page.locator("h1, h2").first).to_be_visible()


def test_the_drift_is_plotted_and_leads_to_a_version(page: Page, service: Any) -> None:
    page.goto(service.url + "/drift")
    expect(page.locator(".plot[data-ready=yes] .main-svg").first).to_be_visible()
    assert page.locator(".plot .scatterlayer .trace").count() >= 2
    page.locator("table a[href^='/calibrations/']").first.click()
    expect(page.locator(".plot[data-ready=yes] .main-svg").first).to_be_visible()
    expect(page.locator("h1")).to_contain_text("CS002")


def test_a_click_on_a_point_leads_to_its_version(page: Page, service: Any) -> None:
    page.goto(service.url + "/drift")
    expect(page.locator(".plot[data-ready=yes]")).to_be_visible()
    point = page.locator(".scatterlayer .points path.point").first
    box = point.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2, steps=4)
    expect(page.locator(".hoverlayer .hovertext").first).to_be_visible()
    with page.expect_navigation():
        page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    assert "/calibrations/" in page.url


def test_a_station_shows_its_paths_month_by_month(page: Page, service: Any) -> None:
    page.goto(service.url + "/stations/CS002")
    expect(page.locator(".plot[data-ready=yes] .heatmaplayer")).to_be_attached()
    assert page.locator("table").count() == 2


def test_without_script_the_tables_say_it_all(browser: Browser, service: Any) -> None:
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(service.url + "/drift")
    expect(page.get_by_text("CS002 Y").first).to_be_visible()
    expect(page.get_by_text("Fewer than three years tell no slope.")).to_be_visible()
    expect(page.locator("noscript p")).to_be_visible()
    context.close()


@pytest.mark.parametrize(
    ("width", "address"), [(1240, "/jobs"), (1240, "/"), (800, "/"), (800, "/drift"), (800, "/stations/CS002")]
)
def test_columns_were_cut_off_at_the_edge_of_a_window(browser: Browser, service: Any, width: int, address: str) -> None:
    page = browser.new_page(viewport={"width": width, "height": 900})
    page.goto(service.url + address, wait_until="networkidle")
    outside = "sections => sections.filter(s => s.scrollWidth > s.clientWidth + 1).map(s => s.innerText.slice(0, 80))"
    assert page.locator("main section").evaluate_all(outside) == []
    page.close()


def test_pages_told_c_in_volts_and_reports_in_microvolts(page: Page, service: Any) -> None:
    page.goto(service.url + "/stations/CS002")
    expect(page.locator("th", has_text="mean C, µV per ADC unit")).to_be_visible()
    told = page.locator("section", has_text="mean C").locator("tbody tr").first.locator("td.number").nth(1)
    assert 5.0 < float(told.inner_text()) < 100.0


@pytest.fixture(scope="module")
def closed(service: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of another server on the same database, which answers nobody without a key."""
    port, log = find_free_port(), Path(tmp_path_factory.mktemp("closed")) / "log"
    environment = service.environment | {"LBACAL_OPEN_READS": "false"}
    address = f"http://127.0.0.1:{port}"

    with running(Process(environment, log, "serve", "--port", str(port), "--api-only")):
        wait_until(lambda: is_ready(address, "healthz"), "the server")
        yield address
    assert service.environment["LBACAL_API_KEY"] not in log.read_text()


@pytest.mark.parametrize("width", [1240, 390])
def test_a_human_logs_in_reads_and_logs_out(browser: Browser, service: Any, closed: str, width: int) -> None:
    context = browser.new_context(viewport={"width": width, "height": 800})
    page = context.new_page()
    noted: list[str] = []
    page.on("pageerror", lambda error: noted.append(str(error)))
    page.goto(f"{closed}/drift")
    expect(page.locator("h1")).to_have_text("Log in")
    page.get_by_label("Key").fill("wrong")
    page.get_by_role("button", name="Log in").click()
    expect(page.locator(".warn")).to_have_text("the key is unknown, expired or revoked")
    page.get_by_label("Key").fill(service.environment["LBACAL_API_KEY"])
    page.get_by_role("button", name="Log in").click()
    expect(page.locator(".plot[data-ready=yes] .main-svg").first).to_be_visible()
    assert page.url == f"{closed}/drift"
    assert page.evaluate("document.cookie") == "", "no script reads the key"
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    page.goto(f"{closed}/jobs")
    expect(page.locator("h1")).to_have_text("Jobs")
    page.get_by_role("button", name="Log out").click()
    expect(page.locator("h1")).to_have_text("Log in")
    assert noted == []
    context.close()


def test_the_documentation_takes_a_key(browser: Browser, service: Any, closed: str) -> None:
    context = browser.new_context(viewport={"width": 1240, "height": 900})
    page = context.new_page()
    page.goto(f"{closed}/docs", wait_until="networkidle")
    page.get_by_role("button", name="Authorize").click()
    page.locator(".auth-container input").fill(service.environment["LBACAL_API_KEY"])
    page.locator(".auth-container button.authorize").click()
    page.locator(".auth-container button.btn-done").click()
    page.locator("#operations-health-get_status_v1_status_get").get_by_role("button").first.click()
    page.get_by_role("button", name="Try it out").click()
    page.get_by_role("button", name="Execute").click()
    expect(page.locator(".live-responses-table tr.response .response-col_status").first).to_contain_text("200")
    context.close()


DATE = parse_instant("date", "2014-06-01")
CHANGE = Change("CS002", ((1, None),), "step", DATE, 2 * DAY_US)


@pytest.fixture
def change(service: Any) -> Iterator[int]:
    """A change as the watch writes one, which ends with the test."""
    made = Factory(Settings(database_url=service.environment["LBACAL_DATABASE_URL"]), lambda: DATE)
    with made.database.write() as stores:
        kept = stores.changes.note(CHANGE, Evidence(DRIFT, "", 9.0, DATE))
    yield kept.number
    with made.database.write() as stores:
        stores.changes.end(kept.number, DRIFT, DATE)
    made.database.close()


@pytest.fixture
def plain_page(browser: Browser) -> Iterator[Page]:
    made = browser.new_page(viewport={"width": 1240, "height": 900})
    yield made
    made.close()


def decide(row: Locator, label: str, key: str, reason: str) -> None:
    row.locator("summary").click()
    row.get_by_label("Reason").fill(reason)
    row.get_by_label("Key").fill(key)
    row.get_by_role("button", name=label).click()


def test_an_admin_dismisses_a_change_with_a_reason_and_takes_that_back(
    plain_page: Page, service: Any, change: int
) -> None:
    key = service.environment["LBACAL_API_KEY"]
    plain_page.goto(service.url + "/drift")
    row = plain_page.locator("#changes tbody tr")
    expect(row).to_contain_text("2014-06-01 ± 2.0 d")
    decide(row, "Dismiss", "a wrong key", "snow")
    expect(plain_page.locator("p.lead")).to_have_text("the key is unknown, expired or revoked")
    plain_page.go_back()
    decide(row, "Dismiss", key, "snow lay on the antenna")
    expect(row).to_contain_text("snow lay on the antenna")
    expect(row.locator(".state")).to_have_text("dismissed")
    assert plain_page.url == service.url + "/drift#changes"
    assert service.run("changes").stdout.startswith(f"{change} CS002 antenna 1, step at 2014-06-01 ± 2.0 d (dismissed")
    decide(row, "Put in force", key, "it lay on the other one")
    expect(row.locator(".state")).to_have_text("found, not yet refitted")
    expect(row).to_contain_text("it lay on the other one")
