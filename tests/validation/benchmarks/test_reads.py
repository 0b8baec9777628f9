"""What the benchmark of reads compares is what it names; the times themselves are no test."""

from __future__ import annotations

import asyncio
import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from fastapi import FastAPI

from service.app import make_app
from validation.benchmarks.ledger import PATHS, fill, opened
from validation.benchmarks.reads import ONE, REQUESTS, add_same, compare_a_year, fill_spectra, get


def read(app: FastAPI, address: str) -> bytes:
    """Ask in a thread of its own: in this one a browser of other tests may run its loop."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(asyncio.run, get(app, address)).result()


def test_each_request_is_answered_and_a_path_s_year_is_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with opened(str(tmp_path / "lbacal.sqlite")) as factory:
        version = fill(factory, 1)[PATHS[0]][0]
        fill_spectra(factory, 30)
        app = make_app(factory)
        bodies = {what: read(app, address.format(version=version)) for what, address in REQUESTS.items()}
        assert len(json.loads(bodies["effective, all paths"])["curves"]) == len(PATHS)
        add_same(app, json.loads(bodies["effective, one path"]))
        assert read(app, "/same") == read(app, ONE)
        compare_a_year(factory)
    assert "a path's year, " in capsys.readouterr().out
