"""What the first look at the service costs after seven years, in a browser and in a server that have just begun.

Run: .venv/bin/python -m validation.benchmarks.page [VERSIONS]  (needs Chromium)

A store of the whole Superterp, seven years of nights each of which left VERSIONS versions of every path
(`validation.growth` writes them; what is in effect in the last year carries all that a fit gives), is served on SQLite.
Each page is asked of a new server by a new browser: until its largest paint (`PerformanceObserver` of the browser),
until its answer has come, the server's processor time for it, and the bytes moved, styles and script among them. The
least of three.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Playwright, sync_playwright

from lbacal_core.curves.validity import Promotion, Scope
from service.cli.opening import configure_logs
from validation.benchmarks.reads import enrich
from validation.growth import FIRST, PATHS, STATIONS, fill, make_version
from validation.running.ledger import open_factory, write_promotions
from validation.running.processes import Process, find_free_port, is_ready, running, wait_until

YEARS, TURNS = 7, 3
PAGES = {
    "first screen": "/",
    "station": "/stations/CS002",
    "life of a path and C on a date": "/paths/CS002/0/X",
    "drift": "/drift",
}
LARGEST_PAINT = """() => new Promise((tell) => {
  const observer = new PerformanceObserver((list) => tell(list.getEntries().at(-1).startTime));
  observer.observe({type: "largest-contentful-paint", buffered: true});
})"""
COSTS = """() => {
  const [page] = performance.getEntriesByType("navigation"), parts = performance.getEntriesByType("resource");
  return [page.responseEnd, parts.reduce((sum, one) => sum + one.transferSize, page.transferSize)];
}"""
BROWSER = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update"]


def fill_years(url: str, kept: int) -> None:
    """Seven years, the last of them in effect with parameters, covariances and budgets as fits give them."""
    rng = np.random.default_rng(1)
    with open_factory(url) as factory:
        fill(factory, YEARS, kept)
        scopes = [*PATHS, *map(Scope, STATIONS), Scope()]
        budget, versions = enrich([make_version(scope, FIRST + YEARS - 1, kept, rng) for scope in scopes], rng)
        with factory.database.write() as stores:
            stores.budgets.add({budget.digest: budget})
            stores.versions.add(versions)
        made = (Promotion(0, v.scope, *v.window, v.id, v.window[1], "benchmark", "night") for v in versions)
        write_promotions(factory, made)


def processor_s(process: int) -> float:
    """Processor time of a process, s."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def look(playwright: Playwright, environment: dict[str, str], log: Path, address: str) -> tuple[float, ...]:
    """One page of a new server in a new browser: largest paint and answer, s; processor time, s; kilobytes."""
    port = find_free_port()
    url, server = f"http://127.0.0.1:{port}", Process(environment, log, "serve", "--port", str(port), "--api-only")
    with running(server):
        wait_until(lambda: is_ready(url, "healthz"), "the server")
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=BROWSER)
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        before = processor_s(server.number)
        answer = page.goto(url + address, wait_until="load")
        if answer is None or not answer.ok:
            raise RuntimeError(f"{address}: {answer and answer.status}")
        used = processor_s(server.number) - before
        answered, moved = page.evaluate(COSTS)
        painted: Any = page.evaluate(LARGEST_PAINT)
        browser.close()
    return painted / 1e3, answered / 1e3, used, moved / 1e3


def main(kept: int = 10) -> None:
    configure_logs("warning")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        file = Path(folder) / "lbacal.sqlite"
        fill_years(str(file), kept)
        print(f"{YEARS} years, {len(PATHS)} paths, {kept} versions of each a year: {file.stat().st_size / 1e6:.0f} MB")
        environment = {"LBACAL_DATABASE_URL": str(file)}
        for name, address in PAGES.items():
            turns = [look(playwright, environment, Path(folder) / "log", address) for _ in range(TURNS)]
            painted, answered, used, moved = np.min(turns, axis=0)
            told = f"largest paint {painted:.2f} s, answered after {answered:.2f} s, {used:.2f} s of processor"
            print(f"  {name}: {told}, {moved:.0f} kB")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
