from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def test_the_demo_finds_what_it_planted_and_ends_by_itself(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "service.cli.demo"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=200,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "The largest step of C is that of CS002 antenna 7 Y on 2015-0" in done.stdout
    assert "C(nu) in effect, in µV per ADC unit:" in done.stdout
    page = (tmp_path / "var/report.html").read_text()
    assert "Two years through the service" in page


def test_the_demo_names_what_it_does_not_know() -> None:
    command = [sys.executable, "-m", "service.cli.demo", "--quick"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stderr) == (2, "usage: ./dev demo [--serve], found '--quick'\n")
