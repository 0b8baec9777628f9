from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from lbacal_core.spectra.spectra import read_spectra


def test_the_demo_finds_what_it_planted_and_ends_by_itself(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "validation.demo"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=900)
    assert done.returncode == 0, done.stdout + done.stderr
    for sentence in (
        "In station CS002, the Sun adds power by day",
        "the letters of the dipoles X and Y are exchanged",
        "The daily run found that C of CS002 antenna 5 Y changed by",
        "in effect on 2015-06-15",
        "lbacal investigate var/spectra.h5",
    ):
        assert sentence in done.stdout
    page = (tmp_path / "var/report.html").read_text()
    assert "4. In effect on a date" in page
    spectra = read_spectra(tmp_path / "var/spectra.h5")
    assert np.unique(spectra.event_id).size > 250, "a reader of the README has no spectra to begin with"
    for next_step in re.findall(r"^  \.venv/bin/(lbacal .+)$", done.stdout, re.MULTILINE):
        command = [sys.executable, "-m", *next_step.split()]
        told = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert told.returncode == 0, next_step + told.stderr
    assert {path.name for path in tmp_path.glob("var/*.html")} == {"report.html", "fit.html", "R.html"}


def test_the_demo_names_what_it_does_not_know() -> None:
    command = [sys.executable, "-m", "validation.demo", "--quick"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=900)
    assert (done.returncode, done.stderr) == (2, "usage: ./dev demo [--serve], found '--quick'\n")


def children_in(folder: Path) -> list[int]:
    """The processes that run in a folder: those of the demo and of its server."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError):
                if (entry / "cwd").resolve() == folder and (entry / "stat").read_text().rpartition(")")[2].split()[
                    0
                ] != "Z":
                    found.append(int(entry.name))
    return found


def wait_for(is_so: Callable[[], bool]) -> None:
    for _ in range(1500):
        if is_so():
            return
        time.sleep(0.1)
    raise TimeoutError


@pytest.mark.skipif(not Path("/proc/self/cwd").exists(), reason="needs /proc")
@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_demo_that_is_stopped_left_a_traceback_and_orphans(tmp_path: Path, ending: signal.Signals) -> None:
    # a shell's background jobs ignore SIGINT, and so would the demo of a suite that runs as one
    heed = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    start = "import runpy; runpy.run_module('validation.demo', None, '__main__')"
    demo = subprocess.Popen(
        [sys.executable, "-c", f"{heed}; {start}", "--serve"], cwd=tmp_path,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    wait_for(lambda: len(children_in(tmp_path)) >= 3)
    if ending is signal.SIGINT:
        os.killpg(demo.pid, ending)  # a terminal tells them all
    else:
        demo.send_signal(ending)
    _, said = demo.communicate(timeout=900)  # a part of a job may have to end first, on a busy machine
    expected = (130, "\n./dev demo: stopped\n") if ending is signal.SIGINT else (-ending, "")
    assert (demo.returncode, said) == expected
    wait_for(lambda: children_in(tmp_path) == [])
