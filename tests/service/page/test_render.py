from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

import service.page
from lbacal.pages.chart import Chart
from service.page.render import Figure, load_assets, render_page, render_part
from service.storage.models import Investigation
from service.usecases.drift import Step

REPORT: dict[str, Any] = {"verdict": "consistent", "findings": [], "unexplained": None, "unidentifiable": []}
ADOPTED = {
    "cause": "lst_offset", "target": "station", "adopted": {"value": 0.5, "sigma": 0.01},
    "size": {"value": 0.51, "sigma": 0.02, "unit": "h"},
}  # fmt: skip
FREQUENCY = {"mhz": [30.0, 55.0, 80.0], "slope": [0.001, 0.004, 0.01], "sigma": [0.02, 0.009, 0.015]}
EMPTY = Chart("t", "x", "y", [])
TREND = {"slope": 0.004, "sigma": 0.009, "limit_95": 0.022, "years": 7, "scatter": 0.05, "frequency": FREQUENCY}


def test_the_page_of_an_investigation_was_silent_about_adopted_causes() -> None:
    found = Investigation("a" * 64, "CS002", 0, 10**15, {}, REPORT, 1, "test", "test")
    content = {"here": "/", "instrument": "x", "found": found, "report": REPORT, "kept": {}}
    content |= {"findings": [], "station": {}}
    with_causes = render_page("investigation.html", adopted=[ADOPTED], **content).decode()
    assert "<h2>Adopted causes</h2>" in with_causes
    assert "0.51 ± 0.02" in with_causes
    assert "0.5 ± 0.01" in with_causes
    assert "the simulation with the adopted causes says" in with_causes
    assert "adopted" not in render_page("investigation.html", adopted=[], **content).decode()


@pytest.mark.parametrize(
    ("slope", "said"), [(0.004, "no ageing is seen"), (-0.03, "it ages, or what C is held against does")]
)
def test_the_page_of_the_drift_states_the_ageing_of_the_array_with_its_error(slope: float, said: str) -> None:
    trends = [("CS002", TREND), ("array", {**TREND, "slope": slope})]
    page = render_part("drift_main.html", figure=Figure(EMPTY, ""), steps=[], points=[], trends=trends, threshold=5.0)
    assert f"C of the whole array changes by {100 * slope:+.2f} % &plusmn; 0.90 % a year over 7 years" in page
    assert f"({100 * slope:+.2f} % &plusmn; 2.20 % with 95 % confidence)" in page
    assert said in page
    assert "+0.10 ± 2.00 % at 30 MHz, +0.40 ± 0.90 % at 55 MHz, +1.00 ± 1.50 % at 80 MHz a year" in page
    assert "arXiv 2410.13591" in page


def test_the_table_of_steps_gave_the_size_of_one_antenna_for_all() -> None:
    members = [
        {"antenna": antenna, "dipole": "X", "size": size, "sigma": 0.004, "significance": 9.0}
        for antenna, size in ((0, 0.5325), (4, -0.352))
    ]
    shape = {"tilt": {"value": 0.2, "sigma": 0.004}}
    change = {"station": "CS002", "is_known": False, "date_unix": 0.0, "date_sigma_days": 1.0, "shape": shape}
    steps = [Step({**change, "members": members, **members[0]}, None)]
    content = {"trends": [], "threshold": 5.0, "frequency_mhz": [30.0, 80.0], "points": []}
    page = render_part("drift_main.html", figure=Figure(EMPTY, ""), steps=steps, **content)
    rows = [row for row in page.split("<tr>") if "CS002" in row]
    assert [("antenna 0 X" in row, "+53.25 %" in row, "tilt" in row) for row in rows] == [(True,) * 3, (False,) * 3]
    assert "antenna 4 X" in rows[1]
    assert "-35.20 %" in rows[1]


VENDOR = Path(service.page.__file__).parent / "static" / "vendor"


def test_every_file_of_others_is_listed_with_its_hash_and_licence() -> None:
    row = re.compile(r"^\| (\S+\.js) \|.*\| (\S+) \((\S+)\) \| ([0-9a-f]{64}) \|$", re.MULTILINE)
    listed = {found[0]: found for found in row.findall((VENDOR / "README.md").read_text())}
    files = {path.name: path for path in VENDOR.glob("*.js")}
    assert set(listed) == set(files)
    for name, (_, _, licence, digest) in listed.items():
        assert hashlib.sha256(files[name].read_bytes()).hexdigest() == digest
        assert (VENDOR / licence).read_text().startswith("MIT License")


def test_files_of_the_page_never_change_under_their_address(client: TestClient) -> None:
    for asset in load_assets().values():
        answer = client.get(asset.url)
        assert answer.content == asset.content
        assert "immutable" in answer.headers["cache-control"]
    assert client.get("/static/0000000000000000/page.css").status_code == 404
