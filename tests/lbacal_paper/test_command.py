from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from lbacal_paper.statements import VERDICTS, load_statements

MOST_BYTES = 10_000_000


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "lbacal", "paper", *arguments], capture_output=True, text=True, check=False
    )


@pytest.fixture(scope="module")
def redone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("paper")
    done = run("--output", str(folder / "new"), "--antennas", "6")
    assert done.returncode == 0, done.stderr
    assert "statements" in done.stdout
    return folder / "new"


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
