from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Locator, Page, expect

from lbacal.instants import DAY_US, parse_instant
from lbacal_core.grids import Floats
from service.config import Settings
from service.factory import Factory
from service.storage.changes import DRIFT, Change, Evidence
from tests.e2e.conftest import STEP, TRUTH
from validation.running.processes import Process, find_free_port, get, is_ready, post, running, wait_until


def watch(page: Page, url: str) -> list[str]:
    """Whatever a user should never see, as it comes: console output, script errors, refusals, requests off the host."""
    noted: list[str] = []
    page.on("console", lambda message: noted.append(f"console {message.type}: {message.text}"))
    page.on("pageerror", lambda error: noted.append(f"script: {error}"))
    page.on("request", lambda request: None if request.url.startswith(url) else noted.append(request.url))
    page.on("response", lambda answer: noted.append(f"{answer.status} {answer.url}") if answer.status >= 400 else None)
    return noted


@pytest.fixture
def page(browser: Browser, service: Any) -> Any:
    """A page on which nothing may be noted."""
    made = browser.new_page(viewport={"width": 1240, "height": 900})
    noted = watch(made, service.url)
    yield made
    assert noted == []
    made.close()


def test_the_documentation_shows_without_complaint(page: Page, service: Any) -> None:
    page.goto(service.url + "/docs", wait_until="networkidle")
    expect(page.locator("h1, h2").first).to_be_visible()


def test_the_first_screen_answers_five_questions_each_with_a_picture(page: Page, service: Any) -> None:
    page.goto(service.url + "/")
    for question in ("right", "effect", "known", "waits"):
        expect(page.locator(f"#{question} .figure svg").first).to_be_visible()
    asked = ("Is everything all right?", "What changed?", "What is in effect on 2015-", "How well do we know it?")
    for heading, words in zip(page.locator("h2").all(), (*asked, "What waits for me?"), strict=True):
        expect(heading).to_contain_text(words)
    sent = page.evaluate("performance.getEntriesByType('resource').reduce((sum, one) => sum + one.transferSize, 0)")
    whole = page.evaluate("performance.getEntriesByType('navigation')[0].transferSize")
    assert sent + whole < 300_000


def test_station_antenna_and_date_lead_to_c_with_both_errors(page: Page, service: Any) -> None:
    page.goto(service.url + "/")
    page.get_by_label("antenna").fill("1")
    page.get_by_label("dipole").select_option("Y")
    page.get_by_label("date").fill("2014-05-20")
    page.get_by_role("button", name="C on that date").click()
    expect(page.locator("h1")).to_have_text("CS002 antenna 1 Y")
    drawn = page.locator("#date figure svg")
    name = "CS002 antenna 1 Y"
    for title in (
        f"C of {name} on 2014-05-20",
        f"fit of {name} over",
        f"measured / predicted power of {name}",
        "noise of",
    ):
        expect(page.locator(f"#date svg[aria-label^='{title}']")).to_be_visible()
    for error in ("total error", "statistical"):
        expect(drawn.first.locator("text").filter(has_text=error)).to_have_count(1)
    assert drawn.first.locator("path.band").count() == 4, "two bands, and each beside its name"
    asked = {"station": "CS002", "antenna": 1, "dipole": "Y", "at": "2014-05-20"}
    (told,) = get(f"{service.url}/v1/calibrations/effective", params=asked).json()["curves"]
    k = told["frequency_mhz"].index(50.0)
    total = math.hypot(told["c_sigma_stat"][k], told["c_sigma_sys"][k]) / told["c"][k]
    assert total > 3 * told["c_sigma_stat"][k] / told["c"][k], "the systematic error is the larger one"
    said = drawn.first.locator("title", has_text=" 50 MHz: ").text_content()
    assert f"50 MHz: {1e6 * told['c'][k]:.2f} µV" in said
    assert f"± {100 * total:.1f} % in all" in said


def test_the_drift_is_drawn_and_a_point_leads_to_its_version(page: Page, service: Any) -> None:
    page.goto(service.url + "/drift")
    version = page.locator("svg a[href^='/calibrations/']").first
    expect(version).to_be_visible()
    version.locator("circle").click()
    expect(page.locator("h1")).to_contain_text("CS002")
    assert page.locator("figure svg path.band").count() >= 4


def test_a_month_of_a_path_leads_to_c_on_that_date(page: Page, service: Any) -> None:
    page.goto(service.url + "/stations/CS002")
    page.locator("svg a[href='/paths/CS002/1/Y']").click()
    expect(page.locator("h1")).to_have_text("CS002 antenna 1 Y")
    page.locator("svg a[href*='at=2014-05-15'] circle").click()
    expect(page.locator("#date h2")).to_have_text("C on 2014-05-15")


def test_the_first_screen_is_used_by_keyboard_alone(page: Page, service: Any) -> None:
    page.goto(service.url + "/")
    page.get_by_label("dipole").focus()
    page.keyboard.press("Y")
    for _ in range(20):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.innerText") == "C on that date":
            break
    page.keyboard.press("Enter")
    expect(page.locator("h1")).to_have_text("CS002 antenna 0 Y")
    page.locator("#life svg a").first.focus()
    with page.expect_navigation():
        page.keyboard.press("Enter")
    assert page.locator("#life, h1").first.is_visible()


def test_a_range_drawn_with_the_pointer_is_that_of_every_page_then(page: Page, service: Any) -> None:
    page.goto(service.url + "/drift")
    box = page.locator("svg[data-time]").first.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 0.5 * box["height"])
    page.mouse.down()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 0.5 * box["height"], steps=4)
    with page.expect_navigation():
        page.mouse.up()
    since, until = (page.locator(f"form.span input[name={name}]").input_value() for name in ("since", "until"))
    assert "2014-06-01" < since < "2014-12-31" < until < "2015-07-01"
    page.get_by_role("link", name="Overview").click()
    assert page.locator("form.span input[name=since]").input_value() == since


def test_an_investigation_is_drawn_as_in_the_report_of_a_file(page: Page, service: Any) -> None:
    (made, *_) = get(f"{service.url}/v1/investigations").json()["investigations"]
    page.goto(f"{service.url}/investigations/{made['id']}")
    expect(page.locator("svg[aria-label^='residuals of the mean over all paths before']").first).to_be_visible()
    assert page.locator("svg image").count() >= 2 * 3 * 2


def test_a_station_shows_its_paths_month_by_month(page: Page, service: Any) -> None:
    page.goto(service.url + "/stations/CS002")
    expect(page.locator("svg[aria-label='change of C of every path'] image").first).to_be_visible()
    assert page.locator("svg[aria-label='change of C of every path'] a").count() == 4


PAGES = ("/", "/drift", "/alarms", "/models", "/jobs", "/stations/CS002", "/paths/CS002/1/Y")


def list_pages(service: Any) -> list[str]:
    """An address of every page."""
    (made, *_) = get(f"{service.url}/v1/investigations").json()["investigations"]
    (version, other, *_) = get(f"{service.url}/v1/calibrations").json()["calibrations"]
    (job, *_) = get(f"{service.url}/v1/jobs").json()["jobs"]
    of_version = f"/calibrations/{version['id']}?against={other['id']}&scale=log"
    return [*PAGES, f"/investigations/{made['id']}", of_version, f"/jobs/{job['job']}", "/log-in"]


@pytest.mark.parametrize(("width", "scheme", "has_script"), [(1400, "light", True), (390, "dark", False)])
def test_every_page_is_whole_and_has_no_barrier(
    browser: Browser, service: Any, width: int, scheme: Any, has_script: bool
) -> None:
    context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
    if not has_script:  # axe needs an engine that runs scripts: the page's own is taken away
        context.route("**/*.js", lambda route: route.fulfill(body="", content_type="text/javascript"))
    page = context.new_page()
    log_in(page, service, "/")
    noted, found = watch(page, service.url), {}
    for address in list_pages(service):
        page.goto(service.url + address)
        expect(page.locator("h1")).to_be_visible()
        found[address] = [
            *find_barriers(page),
            *find_cut_off(page, width),
            *(find_unreachable(page) if has_script else ()),
        ]
    assert {address: told for address, told in found.items() if told} == {}
    assert noted == []
    context.close()


def find_barriers(page: Page) -> list[Any]:
    """What axe-core takes for serious: names of controls, contrast, order of headings, what a keyboard reaches."""
    told = Axe().run(page).response["violations"]
    return [(one["id"], one["nodes"][0]["html"][:120]) for one in told if one["impact"] in ("serious", "critical")]


def find_cut_off(page: Page, width: int) -> list[str]:
    """What the edge of the window cuts off; on a telephone also a figure whose left end, its axis, is not shown."""
    if not page.evaluate("document.documentElement.scrollWidth <= window.innerWidth"):
        return ["the page"]
    outside = "sections => sections.filter(s => s.scrollWidth > s.clientWidth + 1).map(s => s.innerText.slice(0, 80))"
    hidden = page.locator("main section").evaluate_all(outside)
    for figure in page.locator(".figure.wide").all() if width == 390 else ():
        shown = figure.evaluate("f => f.getBoundingClientRect().left - f.firstChild.getBoundingClientRect().left")
        hidden += [f"the axis of a figure by {shown}"] if abs(shown) >= 2 else []
    return hidden


REACHABLE = "a[href], button, input:not([type=hidden]), select, summary"


def find_unreachable(page: Page) -> list[str]:
    """What may be clicked and the key Tab does not reach, or does without showing it."""
    page.evaluate(
        """selector => {
          const seen = window.seen = new Set([document.activeElement]);
          document.addEventListener("focusin", (event) => {
            if (getComputedStyle(event.target).outlineStyle !== "none") seen.add(event.target);
          });
          window.wanted = [...document.querySelectorAll(selector)].filter((one) => one.checkVisibility());
        }""",
        REACHABLE,
    )
    more = "document.querySelectorAll('[tabindex]').length + 4 * document.querySelectorAll('input[type=date]').length"
    for _ in range(page.evaluate(f"wanted.length + {more}")):  # a field of a date has a stop for each of its parts
        page.keyboard.press("Tab")
    missed: list[str] = page.evaluate(
        "wanted.filter((one) => !seen.has(one)).map((one) => one.outerHTML.slice(0, 120))"
    )
    return missed


def test_without_script_everything_can_be_read(browser: Browser, service: Any) -> None:
    context = browser.new_context(java_script_enabled=False, viewport={"width": 390, "height": 800})
    page = context.new_page()
    for address in PAGES:
        page.goto(service.url + address)
        expect(page.locator("h1")).to_be_visible()
        for figure in page.locator("figure").all():
            expect(figure.locator("svg").first).to_be_visible()
        for numbers in page.locator("figure a", has_text="CSV").all()[:1]:
            told = page.request.get(f"{service.url}{address}{numbers.get_attribute('href')}")
            assert told.text().startswith('"series","')
    context.close()


QUESTIONS = re.compile(r"^(?:On the first screen|After (.+)):\n\n((?:\d+\. .+\n)+)", re.MULTILINE)


def test_fifteen_questions_are_answered_in_at_most_three_clicks(page: Page, service: Any, repository: Path) -> None:
    groups = QUESTIONS.findall((repository / "docs/how-to/run-the-service.md").read_text())
    walks = {
        tuple(re.findall(r"`(.+?)`", clicks)): re.findall(r"`(.+?)`$", asked, re.MULTILINE) for clicks, asked in groups
    }
    assert sum(map(len, walks.values())) == 15
    assert max(map(len, walks)) == 3
    for steps, answers in walks.items():
        page.goto(service.url + "/")
        for step in steps:
            here = page.locator("main").get_by_role("link", name=step)
            here = here.or_(page.locator("main").get_by_role("button", name=step))
            (here if here.count() else page.get_by_role("link", name=step)).first.click()
        for answered in answers:
            expect(page.locator("main")).to_contain_text(answered)


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
    expect(page.locator("figure svg").first).to_be_visible()
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


def log_in(page: Page, service: Any, address: str) -> None:
    page.goto(f"{service.url}{address}")
    page.get_by_role("link", name="Log in").click()
    page.get_by_label("Key").fill(service.environment["LBACAL_API_KEY"])
    page.get_by_role("button", name="Log in").click()
    expect(page.get_by_role("button", name="Log out")).to_be_visible()


def decide(page: Page, row: Locator, label: str, reason: str) -> None:
    """Open the form of a row, look at what it would change, and do it."""
    row.locator("summary", has_text=label).click()
    row.get_by_label("Reason").fill(reason)
    row.get_by_role("button", name=label).click()
    expect(page.locator("h1")).to_have_text("Decide about a change")
    expect(page.get_by_text(f"Reason: {reason}")).to_be_visible()
    page.get_by_role("button", name="Do it").click()


def test_an_admin_dismisses_a_change_without_script_and_takes_that_back(
    browser: Browser, service: Any, change: int
) -> None:
    context = browser.new_context(java_script_enabled=False, viewport={"width": 390, "height": 800})
    page = context.new_page()
    log_in(page, service, "/drift")
    assert page.url == service.url + "/drift"
    row = page.locator("#changes tbody tr", has_text="2014-06-01")
    expect(row).to_contain_text("2014-06-01 ± 2.0 d")
    decide(page, row, "Dismiss", "snow lay on the antenna")
    expect(row).to_contain_text("snow lay on the antenna")
    expect(row.locator(".state")).to_have_text("dismissed")
    assert page.url == service.url + "/drift#changes"
    assert service.run("changes").stdout.startswith(f"{change} CS002 antenna 1, step at 2014-06-01 ± 2.0 d (dismissed")
    decide(page, row, "Put in force", "it lay on the other one")
    expect(row.locator(".state")).to_have_text("found, not yet refitted")
    expect(row).to_contain_text("it lay on the other one")
    context.close()


WHERE = {"station": "CS002", "antenna": 1, "dipole": "Y"}
BEFORE, AFTER = "2015-02-15", "2015-09-15"


def read_c(page: Page, service: Any, at: str) -> tuple[str, Floats, Floats]:
    """Ask for C on a date on the first screen; the version, C and its error that the page and the API tell alike."""
    page.get_by_role("link", name="Overview").click()
    page.get_by_label("antenna").fill("1")
    page.get_by_label("dipole").select_option("Y")
    page.get_by_label("date").fill(at)
    page.get_by_role("button", name="C on that date").click()
    (told,) = get(f"{service.url}/v1/calibrations/effective", params={**WHERE, "at": at}).json()["curves"]
    version = page.locator("#date a[href^='/calibrations/']").first
    expect(version).to_have_attribute("href", f"/calibrations/{told['calibration']}")
    c, *errors = (np.array(told[name], dtype=float) for name in ("c", "c_sigma_stat", "c_sigma_sys"))
    drawn = [one.text_content() for one in page.locator("#date figure").first.locator("svg circle.hover title").all()]
    assert [float(str(one).split(": ")[1].split(" ")[0]) for one in drawn] == pytest.approx(1e6 * c, abs=0.006)
    return told["calibration"], c, np.hypot(*errors)


def test_a_planted_step_is_put_in_force_by_clicks_c_is_right_on_both_sides_and_it_is_undone(
    browser: Browser, service: Any, fitted: Path
) -> None:
    page = browser.new_page(viewport={"width": 1400, "height": 900})
    log_in(page, service, "/")
    whole = {at: read_c(page, service, at)[0] for at in (BEFORE, AFTER)}
    assert len(set(whole.values())) == 1, "one version over the step"
    page.get_by_role("link", name="Overview").click()
    proposed = page.locator("#changed tbody tr", has_text="CS002 antenna 1")
    expect(proposed).to_contain_text("proposed")
    page.locator("#waits tr", has_text="gain_step").get_by_role("link").click()
    found = page.locator("section", has_text="the gain stepped at a date")
    (name,) = re.findall(r"/investigations/([0-9a-f]+)", page.url)
    (finding,) = get(f"{service.url}/v1/investigations/{name}").json()["report"]["findings"]
    size = finding["size"]
    expect(found).to_contain_text(f"{size['value']:.4g} ± {size['sigma']:.2g} fraction")
    assert size["value"] == pytest.approx(STEP.size, abs=3.0 * size["sigma"])

    found.locator("summary", has_text="Put in force").click()
    found.get_by_label("Reason").first.fill("the record of that day has it")
    found.get_by_role("button", name="Put in force").click()
    expect(page.locator("h1")).to_have_text("Decide about a change")
    assert find_barriers(page) == []
    (change,) = (one for one in get(f"{service.url}/v1/changes").json()["changes"] if one["decision"] == "proposed")
    wanted = {"decision": "in_force", "reason": "x"}
    key = {"Authorization": f"Bearer {service.environment['LBACAL_API_KEY']}"}
    address = f"{service.url}/v1/changes/{change['id']}/decision?dry_run=true"
    foreseen = post(address, json=wanted, headers=key, timeout=60).json()["changes"]
    shown = [row.inner_text().split("\t") for row in page.locator("tbody tr").all()]
    assert [row[-2] for row in shown] == [f"{100 * one['max_fraction']:.2f} %" for one in foreseen]
    assert {row[0] for row in shown} == {"CS002 antenna 1 X", "CS002 antenna 1 Y"}
    page.get_by_role("button", name="Do it").click()
    row = page.locator("#changes tbody tr", has_text=change["at"]["value"][:10])
    expect(row.locator(".state")).to_have_text("found, not yet refitted")
    service.pass_night()

    truth, after_it = np.load(fitted / TRUTH), (1.0 + STEP.size) ** -0.5
    told = {at: read_c(page, service, at) for at in (BEFORE, AFTER)}
    for (version, c, error), expected in zip(told.values(), (truth, after_it * truth), strict=True):
        assert version not in whole.values()
        assert np.abs(c - expected).max() < 3.0 * error.max()
    (_, before, _), (_, after, _) = told.values()
    assert np.median(after / before) == pytest.approx(after_it, abs=0.02)

    page.get_by_role("link", name="Drift").click()
    expect(row.locator(".state")).to_have_text("in force")
    decide(page, row, "Dismiss", "it was another antenna")
    expect(row.locator(".state")).to_have_text("dismissed")
    service.pass_night()
    assert {at: read_c(page, service, at)[0] for at in (BEFORE, AFTER)} == whole
    page.close()
