"""A real browser at a server whose reads need a key."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest
from playwright.sync_api import Browser, expect

from validation.running.processes import Process, find_free_port, running, wait_until


@pytest.fixture(scope="module")
def closed(service: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of another server on the same database, which answers nobody without a key."""
    port, log = find_free_port(), Path(tmp_path_factory.mktemp("closed")) / "log"
    environment = service.environment | {"LBACAL_OPEN_READS": "false"}
    address = f"http://127.0.0.1:{port}"

    def answers() -> bool:
        try:
            return httpx2.get(f"{address}/healthz").is_success
        except httpx2.TransportError:
            return False

    with running(Process(environment, log, "serve", "--port", str(port), "--api-only")):
        wait_until(answers, "the server")
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
