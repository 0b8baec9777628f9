"""Draw docs/images/page-*.png: each page of a running service, as Chromium shows it.

    ./dev demo --serve
    .venv/bin/python -m validation.scripts.draw_pages http://127.0.0.1:PORT

The station, path and date are those of the gain step of the demonstration.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import httpx2
from playwright.sync_api import sync_playwright

from validation.demo.service_run import AFTER, ANTENNA, DIPOLE, STATION

IMAGES = Path(__file__).parents[2] / "docs/images"
WIDTH, HEIGHT = 1100, 1400


def list_pages(url: str) -> dict[str, str]:
    """Addresses by the names of their pictures."""
    with httpx2.Client(base_url=url) as client:
        made = client.get("/v1/investigations").json()["investigations"]
        version, *_ = client.get("/v1/calibrations").json()["calibrations"]
    found = next((one for one in made if one["verdict"] != "consistent"), made[0])
    return {
        "overview": "/",
        "station": f"/stations/{STATION}",
        "path": f"/paths/{STATION}/{ANTENNA}/{DIPOLE}?at={AFTER}",
        "drift": "/drift",
        "finding": f"/investigations/{found['id']}",
        "calibration": f"/calibrations/{version['id']}",
        "alarms": "/alarms",
        "models": "/models",
        "jobs": "/jobs",
    }


def main(url: str) -> None:
    with sync_playwright() as tools:
        browser = tools.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
        for name, address in list_pages(url).items():
            page.goto(url + address)
            page.screenshot(path=IMAGES / f"page-{name}.png", full_page=name == "overview")
            print(f"{name}: {address}")
        browser.close()


if __name__ == "__main__":
    main(sys.argv[1].rstrip("/"))
