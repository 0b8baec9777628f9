"""An admin at a real browser: what the drift page and the page of alarms let one decide."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import Browser, Locator, Page, expect

from lbacal.instants import DAY_US, parse_instant
from service.config import Settings
from service.factory import Factory
from service.storage.drift import Cut

DATE = parse_instant("date", "2014-06-01")
CUT = Cut("CS002", 1, DATE, 2 * DAY_US)


@pytest.fixture
def cut(service: Any) -> Iterator[int]:
    """A cut as the watch writes one, which ends with the test."""
    made = Factory(Settings(database_url=service.environment["LBACAL_DATABASE_URL"]), lambda: DATE)
    with made.database.write() as stores:
        stores.cuts.add([CUT], DATE)
        (kept,) = stores.cuts.kept()
    yield kept.number
    with made.database.write() as stores:
        stores.cuts.end(CUT, DATE)
    made.database.close()


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    made = browser.new_page(viewport={"width": 1240, "height": 900})
    yield made
    made.close()


def decide(row: Locator, label: str, key: str, reason: str) -> None:
    row.locator("summary").click()
    row.get_by_label("Reason").fill(reason)
    row.get_by_label("Key").fill(key)
    row.get_by_role("button", name=label).click()


def test_an_admin_lifts_a_cut_with_a_reason_and_restores_it(page: Page, service: Any, cut: int) -> None:
    key = service.environment["LBACAL_API_KEY"]
    page.goto(service.url + "/drift")
    row = page.locator("#cuts tbody tr")
    expect(row).to_contain_text("2014-06-01 ± 2.0 d")
    decide(row, "Lift", "a wrong key", "snow")
    expect(page.locator("p.lead")).to_have_text("the key is unknown, expired or revoked")
    page.go_back()
    decide(row, "Lift", key, "snow lay on the antenna")
    expect(row).to_contain_text("snow lay on the antenna")
    expect(row.locator(".state")).to_have_text("lifted")
    assert page.url == service.url + "/drift#cuts"
    assert service.run("cuts").stdout.startswith(f"{cut} CS002 antenna 1 at 2014-06-01 ± 2.0 d (lifted")
    decide(row, "Restore", key, "it lay on the other one")
    expect(row.locator(".state")).to_have_text("found, not yet refitted")
    expect(row).to_contain_text("restored")
