from __future__ import annotations

import os
import pty
import subprocess
import sys
from pathlib import Path

PROGRAM = """
from lbacal.cli.outputs import progress
with progress(2) as tell:
    tell("read a.h5")
    tell("fit 10 spectra")
print("done")
"""


def test_a_pipe_sees_no_bar(repository: Path) -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, cwd=repository)
    assert (done.stdout, done.stderr) == ("done\n", "")


def test_a_terminal_sees_the_steps_and_the_output_stays_clean(repository: Path) -> None:
    leader, follower = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "100"}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, stderr=follower, check=True, cwd=repository,
        env=environment,
    )  # fmt: skip
    os.close(follower)
    seen = os.read(leader, 100_000).decode()
    os.close(leader)
    assert done.stdout == b"done\n"
    assert "read a.h5" in seen
    assert "1/2" in seen
    assert "fit 10 spectra" in seen
