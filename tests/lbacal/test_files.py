from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from lbacal.files import UnwritableError, written_beside
from lbacal.settings import CLIENT_SETTINGS, SERVER_SETTINGS, require_known_settings
from lbacal_core.errors import BadInputError
from service.config import Settings


def names_in(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()]


def write_half(path: Path, error: BaseException) -> None:
    with written_beside(path) as beside:
        beside.write_text("half")
        raise error


def test_a_file_is_replaced_when_the_new_one_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "fit.json"
    path.write_text("old")
    path.chmod(0o640)
    with written_beside(path) as beside:
        assert beside.suffix == ".json"
        beside.write_text("new")
        assert path.read_text() == "old"
    assert (path.read_text(), path.stat().st_mode & 0o777) == ("new", 0o640)
    assert names_in(tmp_path) == ["fit.json"]


FULL = "No space left on device"
OF_HDF5 = f"can't write (file write failed: time = Sun, errno = 28, error message = '{FULL}', buf = 0x1, size = 7)"


@pytest.mark.parametrize(
    "error", [OSError(errno.ENOSPC, FULL), OSError(OF_HDF5), RuntimeError(OF_HDF5), KeyboardInterrupt()]
)
def test_whatever_stops_the_writing_leaves_what_was_there(tmp_path: Path, error: BaseException) -> None:
    path = tmp_path / "fit.json"
    path.write_text("old")
    expected = KeyboardInterrupt if isinstance(error, KeyboardInterrupt) else UnwritableError
    with pytest.raises(expected) as told:
        write_half(path, error)
    sentence = f"{path} could not be written: {FULL}; what was there before is unchanged"
    assert str(told.value) == ("" if expected is KeyboardInterrupt else sentence)
    assert (path.read_text(), names_in(tmp_path)) == ("old", ["fit.json"])


def test_a_link_stays_a_link_and_a_device_is_written_itself(tmp_path: Path) -> None:
    (tmp_path / "there").write_text("old")
    link = tmp_path / "link"
    link.symlink_to("there")
    with written_beside(link) as beside:
        beside.write_text("new")
    assert link.is_symlink()
    assert (tmp_path / "there").read_text() == "new"
    with written_beside(Path("/dev/null")) as beside:
        assert beside == Path("/dev/null")


def test_two_who_write_the_same_file_leave_one_whole_file(tmp_path: Path) -> None:
    script = (
        "import sys; from pathlib import Path; from lbacal.files import written_beside\n"
        "for _ in range(50):\n with written_beside(Path('f')) as b: b.write_text(sys.argv[1] * 10000)"
    )
    writers = [subprocess.Popen([sys.executable, "-c", script, letter], cwd=tmp_path) for letter in "ab"]
    assert [writer.wait() for writer in writers] == [0, 0]
    text = (tmp_path / "f").read_text()
    assert (len(text), len(set(text)), names_in(tmp_path)) == (10000, 1, ["f"])


WRITE = {
    "text": "b.write_text('x' * 200_000)",
    "hdf5": "import h5py, numpy\n  with h5py.File(b, 'w') as f: f.create_dataset('x', data=numpy.zeros(100_000))",
    "figure": "import matplotlib.figure as f; f.Figure((20, 20), dpi=300).savefig(b)",
}


@pytest.mark.long
@pytest.mark.parametrize("kind", WRITE)
def test_a_full_disk_cut_a_good_file_and_names_the_file_now(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "good.png"
    path.write_text("good")
    script = (
        "import resource; from pathlib import Path; from lbacal.cli.main import run, app; from lbacal.files import *\n"
        "@app.command()\ndef write() -> None:\n"
        f" with written_beside(Path('good.png')) as b:\n  {WRITE[kind]}\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))\nrun()"
    )
    command = [sys.executable, "-c", script, "write"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    assert done.stderr.startswith("lbacal: good.png could not be written: ")
    assert done.stderr.endswith("File too large; what was there before is unchanged\n")
    assert len(done.stderr.splitlines()) == 1
    assert (path.read_text(), names_in(tmp_path)) == ("good", ["good.png"])


LBACAL = Path(sys.executable).with_name("lbacal")


def test_the_client_knows_the_names_of_all_settings_of_the_server() -> None:
    assert tuple(f"LBACAL_{name.upper()}" for name in Settings.model_fields) == SERVER_SETTINGS
    assert not set(SERVER_SETTINGS) & set(CLIENT_SETTINGS)


@pytest.mark.parametrize("arguments", [["status"], ["effective", "--station", "CS002"], ["fit", "S.h5"]])
@pytest.mark.parametrize(("name", "near"), [("FOO", "docs/settings.md"), ("ULR", "LBACAL_URL")])
def test_a_setting_that_nobody_reads_was_accepted_by_client_commands(
    name: str, near: str, arguments: list[str]
) -> None:
    done = subprocess.run(
        [LBACAL, *arguments], env=os.environ | {f"LBACAL_{name}": "1"}, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"lbacal: LBACAL_{name}: expected a name")
    assert near in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("name", "expected"), [("FOO", "a name in docs/settings.md"), ("ULR", "a name such as LBACAL_URL")]
)
def test_a_setting_that_nobody_reads_is_refused_with_the_name_that_is_near(
    name: str, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    require_known_settings()
    monkeypatch.setenv(f"LBACAL_{name}", "1")
    with pytest.raises(BadInputError) as told:
        require_known_settings()
    assert str(told.value) == f"LBACAL_{name}: expected {expected}, found this one"
