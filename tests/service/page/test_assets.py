from __future__ import annotations

import hashlib
import re
from pathlib import Path

from fastapi.testclient import TestClient

import service.page
from service.page.render import load_assets

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


def test_pages_load_nothing_from_elsewhere(client: TestClient) -> None:
    for address in ("/", "/drift", "/jobs", "/stations/CS001"):
        answer = client.get(address)
        assert answer.status_code == 200
        assert not re.findall(r'(?:src|href)="(?!/)', answer.text)
        policy = answer.headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "script-src 'self';" in policy


def test_an_unknown_page_is_a_problem(client: TestClient) -> None:
    assert client.get("/calibrations/none").status_code == 404
    assert client.get("/stations/CS999").status_code == 422
    assert client.get("/nothing").headers["content-type"] == "application/problem+json"
