from __future__ import annotations

import csv
import json
import re
import subprocess
import sys
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lbacal_paper.everything import BEGIN, END, WITHOUT_DATA, WITHOUT_SHOWERS, describe_claims, insert_claims
from lbacal_paper.statements import BY_CONSTRUCTION, UNTESTED, VERDICTS, load_statements

MOST_BYTES = 10_000_000


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "lbacal", "paper", *arguments], capture_output=True, text=True, check=False
    )


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """The folder of the paper redone with a quarter of its antennas and no other data, and the lines that were told."""
    folder = tmp_path_factory.mktemp("paper") / "new"
    done = run("--output", str(folder), "--antennas", "12")
    assert done.returncode == 0, done.stderr
    return folder, (done.stderr + done.stdout).splitlines()


@pytest.fixture(scope="module")
def redone(told: tuple[Path, list[str]]) -> Path:
    """That folder."""
    return told[0]


def test_claims_are_those_of_the_paper_each_with_a_verdict(redone: Path) -> None:
    claims = json.loads((redone / "claims.json").read_text())
    assert [claim["id"] for claim in claims] == [one.identifier for one in load_statements()]
    fields = {"id", "claim", "section", "published", "ours", "sigma", "verdict", "how"}
    assert all(fields <= set(claim) and claim["verdict"] in VERDICTS and claim["how"] for claim in claims)
    judged = [claim for claim in claims if claim["ours"] is not None]
    assert len(judged) >= 20


def test_the_report_is_one_file_that_loads_nothing(redone: Path) -> None:
    page = (redone / "report.html").read_text(encoding="utf-8")
    assert len(page.encode()) < MOST_BYTES
    assert re.findall(r"""(?:src|href)=["'](?!data:|#)""", page) == []
    assert "://" not in page
    assert page.count("<figure") == len(list(redone.glob("figure-*.csv")))


def test_every_figure_is_a_pdf_a_png_and_a_csv(redone: Path) -> None:
    numbers = sorted(int(path.stem.removeprefix("figure-")) for path in redone.glob("figure-*.csv"))
    assert numbers == list(range(1, 10))
    for number in numbers:
        assert (redone / f"figure-{number}.pdf").read_bytes().startswith(b"%PDF")
        assert (redone / f"figure-{number}.png").read_bytes().startswith(b"\x89PNG")


def test_bad_usage_is_one_sentence_and_exit_2(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for arguments, message in (
        (["--output", str(tmp_path / "file")], "expected a folder"),
        (["--output", str(tmp_path / "new"), "--data", str(tmp_path / "nowhere")], "expected a folder"),
    ):
        done = run(*arguments)
        assert done.returncode == 2
        assert message in done.stderr
        assert "Traceback" not in done.stderr


def claim(verdict: str, ours: float | None) -> dict[str, Any]:
    return {
        "id": verdict.split(maxsplit=1)[0], "section": "1", "claim": "text", "published": 5.0, "relation": "at most",
        "unit": "%", "ours": ours, "sigma": 0.5, "verdict": verdict, "how": "so",
    }  # fmt: skip


def test_claims_become_a_table_with_reasons() -> None:
    text = describe_claims(
        [
            claim("agree", 4.0),
            claim("disagree", 9.0),
            claim("cannot be tested here", None),
            claim("by construction", 5.0),
        ]
    )
    assert "| `agree` | 1 | text | at most 5 % | 4 ± 0.5 % | agree |" in text
    assert "## Where we disagree\n- `disagree`: so." in text
    assert "## What cannot be tested here\n- `cannot` (1), text: so." in text
    assert "## What holds by construction\n`by`." in text


def test_claims_replace_what_stood_between_the_marks() -> None:
    page = f"before\n{BEGIN}\nold\n{END}\nafter\n"
    new = insert_claims(page, [claim("agree", 4.0)])
    assert new.startswith("before\n")
    assert new.endswith("\nafter\n")
    assert "old" not in new
    assert insert_claims(new, [claim("agree", 4.0)]) == new


def test_the_page_says_of_every_statement_what_a_run_finds(repository: Path, redone: Path) -> None:
    page = (repository / "docs/explanation/the-paper-redone.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([a-z0-9-]+)` \|.*\| ([a-z ]+) \|$", page, re.MULTILINE)
    for title, verdict in (("What cannot be tested here", UNTESTED), ("What holds by construction", BY_CONSTRUCTION)):
        section = page.split(f"## {title}\n")[1].split("\n\n")[0].split("<!--")[0]
        rows += [(name, verdict) for name in re.findall(r"`([a-z0-9-]+)`", section)]
    assert sorted(name for name, _ in rows) == sorted(one.identifier for one in load_statements())
    for one in json.loads((redone / "claims.json").read_text()):
        # what lies near the limit of two standard deviations may fall on either side
        scale = 2 * np.hypot(one["precision"], one["sigma"] or 0.0)
        is_near = one["ours"] is not None and 0.7 * scale < abs(one["ours"] - one["published"]) < 1.4 * scale
        assert dict(rows)[one["id"]] == one["verdict"] or is_near, one


def test_the_whole_paper_is_redone_without_any_data_beside_the_package(told: tuple[Path, list[str]]) -> None:
    redone, lines = told
    assert len(lines) >= 6
    assert "statements" in lines[-1]
    page = unescape((redone / "report.html").read_text(encoding="utf-8"))
    assert WITHOUT_DATA in page
    assert WITHOUT_SHOWERS in page
    measured = page[page.index("What the measured sky changes in 5.1 and 5.2: with the sky tied to absolute") :][:1500]
    # a hotter sky is a larger C in every channel
    changes = re.findall(r"([+-]\d+) %", measured)
    assert changes
    assert all(part.startswith("+") for part in changes)
    tables = [list(csv.reader(path.read_text().splitlines())) for path in sorted(redone.glob("table-*.csv"))]
    assert [len(rows) > 4 for rows in tables] == [True, True, True]
    assert all(len(row) == len(rows[0]) for rows in tables for row in rows)
