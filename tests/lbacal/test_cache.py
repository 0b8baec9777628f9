"""Two tags in one cache, and a tag that stands for another instant than when it was synced."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import pytest

from lbacal import cache
from lbacal.cache import Cache, Question
from lbacal.instants import parse_instant


class Server:
    """One station with one edge, whose C is the year of the tag's instant."""

    url = "http://server"

    def __init__(self, **tags: int) -> None:
        self.tags = tags
        self.fetched = 0

    def get(self, path: str, **_: Any) -> Any:
        """The tags, or the edges."""
        if path == "/v1/tags":
            return {"tags": [{"name": name, "as_of": f"{year}-01-01T00:00:00Z"} for name, year in self.tags.items()]}
        edge = "2014-01-01T00:00:00Z"
        return {"stations": [{"station": "CS002", "antennas": [1], "dipoles": ["X"], "edges": [edge]}]}

    def fetch(self, _: str, **params: Any) -> bytes:
        """What is in effect."""
        self.fetched += 1
        curve = {"station": "CS002", "antenna": 1, "dipole": "X", "c": [float(params["as_of"][:4])]}
        return json.dumps({"curves": [curve], "missing": []}).encode()


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Cache:
    """A cache in which every sync is a day after the one before."""
    days = itertools.count(parse_instant("", "2026-01-01"), 86_400_000_000)
    monkeypatch.setattr(cache, "_now", lambda: next(days))
    return Cache(tmp_path)


def tell(kept: Cache, tag: str | None = None) -> float:
    snapshot = kept.snapshot(tag)
    asked = Question(parse_instant("", "2014-06-01"), "CS002", 1, "X", None)
    return float(json.loads(kept.answer(snapshot, asked))["curves"][0]["c"][0])


def test_without_a_name_the_tag_synced_last_answers(kept: Cache) -> None:
    server = Server(old=2020, new=2025)
    for names, last in ((("old", "new"), 2025.0), (("old",), 2020.0), (("new",), 2025.0)):
        for name in names:
            kept.sync(server, name)
        assert tell(kept) == last
    assert (tell(kept, "old"), tell(kept, "new")) == (2020.0, 2025.0)
    assert server.fetched == 2, "what is here and whole is not fetched again"


def test_a_tag_of_another_instant_is_fetched_anew(kept: Cache) -> None:
    """Made again on another server, it kept the answers of before, all hashes right."""
    kept.sync(Server(paper=2020), "paper")
    assert tell(kept) == 2020.0
    kept.sync(Server(paper=2025), "paper")
    assert tell(kept) == 2025.0
