from __future__ import annotations

import errno
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from lbacal.cli import main as command
from lbacal_core.errors import BadInputError, LbacalError, UnknownNameError, UnreadableFileError

LBACAL = Path(sys.executable).with_name("lbacal")


def run_raising(error: Exception, monkeypatch: pytest.MonkeyPatch) -> int:
    """Exit code of `lbacal` when its work ends in an error."""

    def work() -> None:
        raise error

    monkeypatch.setattr(command, "app", work)
    with pytest.raises(SystemExit) as caught:
        command.run()
    return int(caught.value.code or 0)


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (BadInputError("a", "b", "c"), 2),
        (UnreadableFileError("a"), 2),
        (UnknownNameError("instrument", "a", ["b"]), 2),
        (FileNotFoundError(errno.ENOENT, "No such file or directory", "a/b.json"), 2),
        (IsADirectoryError(errno.EISDIR, "Is a directory", "a"), 2),
        (PermissionError(errno.EACCES, "Permission denied", "a"), 2),
        (LbacalError("the work"), 1),
        (OSError(errno.ENOSPC, "No space left on device", "a"), 1),
    ],
)
def test_bad_input_exits_with_2_and_failed_work_with_1_and_both_with_one_line(
    error: Exception, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_raising(error, monkeypatch) == code
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("lbacal: ")
    assert captured.err.count("\n") == 1
    assert "None" not in captured.err


def test_the_installed_command_tells_its_version() -> None:
    done = subprocess.run([LBACAL, "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"lbacal {version('lbacal')}\n"


@pytest.mark.parametrize("arguments", [["fitt"], ["fit"], ["fit", "--no-such-option"]])
def test_bad_usage_exits_with_2_without_a_traceback(arguments: list[str]) -> None:
    done = subprocess.run([LBACAL, *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert done.stdout == ""


def test_a_client_without_the_extra_fit_starts() -> None:
    # every command of a client was a ModuleNotFoundError: what `lbacal fit` prints was imported with all of them
    program = f"import sys\nsys.modules |= dict.fromkeys({(*command.FIT, 'erfa')!r})\nimport lbacal.cli.main"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
