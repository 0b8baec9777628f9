from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from lbacal_paper.everything import redo_paper
from lbacal_paper.page import BEGIN, END, describe_claims, insert_claims
from lbacal_paper.statements import load_statements


def claim(verdict: str, ours: float | None) -> dict[str, Any]:
    return {
        "id": verdict.split(maxsplit=1)[0], "section": "1", "claim": "text", "published": 5.0, "relation": "at most",
        "unit": "%", "ours": ours, "sigma": 0.5, "verdict": verdict, "how": "so",
    }  # fmt: skip


def test_claims_become_a_table_with_reasons() -> None:
    text = describe_claims([claim("agree", 4.0), claim("disagree", 9.0), claim("cannot be tested here", None)])
    assert "| `agree` | 1 | text | at most 5 % | 4 ± 0.5 % | agree |" in text
    assert "## Where we disagree\n- `disagree`: so." in text
    assert "## What cannot be tested here\n- `cannot`: so." in text


def test_claims_replace_what_stood_between_the_marks() -> None:
    page = f"before\n{BEGIN}\nold\n{END}\nafter\n"
    new = insert_claims(page, [claim("agree", 4.0)])
    assert new.startswith("before\n")
    assert new.endswith("\nafter\n")
    assert "old" not in new
    assert insert_claims(new, [claim("agree", 4.0)]) == new


def test_the_page_says_of_every_statement_what_a_run_finds(repository: Path) -> None:
    page = (repository / "docs/explanation/the-paper-redone.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([a-z0-9-]+)` \|.*\| ([a-z ]+) \|$", page, re.MULTILINE)
    assert [name for name, _ in rows] == [one.identifier for one in load_statements()]
    for one in redo_paper(lambda _: None, antennas=12).claims:
        # a quarter of the antennas: what lies near the limit of two standard deviations may fall on either side
        scale = 2 * np.hypot(one["precision"], one["sigma"] or 0.0)
        is_near = one["ours"] is not None and 0.7 * scale < abs(one["ours"] - one["published"]) < 1.4 * scale
        assert dict(rows)[one["id"]] == one["verdict"] or is_near, one
