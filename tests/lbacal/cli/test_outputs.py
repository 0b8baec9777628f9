from __future__ import annotations

import os
import pty
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import typer.main

from lbacal.cli.main import add_commands, app
from lbacal.cli.outputs import require_outputs
from lbacal.selection import Selection, find_spectra_files, parse_selection, read_selected
from lbacal_core.errors import BadInputError
from lbacal_core.spectra.spectra import Spectra, write_spectra
from tests.lbacal.cli.conftest import Lbacal, list_commands


def test_new_files_and_files_to_be_replaced_are_welcome(tmp_path: Path) -> None:
    (tmp_path / "old.json").write_text("old")
    require_outputs(
        {"--output": tmp_path / "new.ecsv", "--report": tmp_path / "old.json", "--plot": None},
        {"SPECTRA": tmp_path / "s.h5", "--sky-power": None, "--instrument": "lofar-superterp"},
    )


@pytest.mark.parametrize(
    ("outputs", "inputs", "said"),
    [
        ({"--output": "none/c.ecsv"}, {}, "--output .*expected a file in a folder that exists, found no folder"),
        ({"--output": "file/c.ecsv"}, {}, "found no folder"),
        ({"--report": "."}, {}, "expected a file to write, found a folder"),
        ({"--output": "c", "--report": "./c"}, {}, "--report .*a file of its own, found the file of --output"),
        ({"--output": "s.h5"}, {"SPECTRA": "s.h5"}, "found the file of SPECTRA"),
    ],
)
def test_an_output_is_a_file_of_its_own_in_a_folder_that_exists(
    tmp_path: Path, outputs: dict[str, str], inputs: dict[str, str], said: str
) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInputError, match=said):
        require_outputs(
            {name: tmp_path / path for name, path in outputs.items()},
            {name: str(tmp_path / path) for name, path in inputs.items()},
        )


VALUES = {
    "instrument": "lofar-superterp", "station": "CS002", "antenna": "0", "dipole": "X", "at": "2014-05-01",
    "kind": "json",
}  # fmt: skip
"""Values of options and arguments that a command needs beside its output."""
OFTEN = ("instrument", "kind", "spectra", "report")
"""What some commands need that the line does not say by itself."""
OUTPUTS = ("--output", "--report", "--html", "--plot", "--inspect", "OUTPUT")


def list_outputs() -> list[tuple[str, str, list[str]]]:
    """Every command that writes a file, the option that names it, and a command line with that in no folder."""
    add_commands()
    found = []
    for name, command in list_commands(typer.main.get_command(app)):
        needed = {one.name: one for one in command.params if one.required or one.name in OFTEN}
        for one in command.params:
            option = one.opts[0] if one.opts[0].startswith("-") else one.name.upper()
            if option not in OUTPUTS or name == "paper":  # which makes its folder
                continue
            line = name.split()
            for other in {**needed, one.name: one}.values():
                value = "none/out.png" if other is one else VALUES.get(other.name, f"{other.name}.json")
                line += [*other.opts[:1] * other.opts[0].startswith("-"), value]
            found.append((name, option, line))
    return found


@pytest.mark.parametrize(
    "arguments", [pytest.param(line, id=f"{name} {option}") for name, option, line in list_outputs()]
)
def test_every_command_refuses_an_output_before_it_looks_at_its_input(lbacal: Lbacal, arguments: list[str]) -> None:
    code, _, err = lbacal(*arguments)
    assert "none/out.png: expected a file in a folder that exists, found no folder none\n" in err
    assert code == 2


def test_a_figure_has_a_form_that_can_be_drawn() -> None:
    for path in (Path("C.PNG"), Path("C.pdf"), None):
        require_outputs({"--plot": path}, {})
    for name in ("C", "C.jpeg", "C.png.txt"):
        with pytest.raises(BadInputError, match=r"ends in \.png, \.pdf, \.svg"):
            require_outputs({"--plot": Path(name)}, {})


PROGRAM = """
from lbacal.cli.outputs import progress
with progress(2) as tell:
    tell("read a.h5")
    tell("fit 10 spectra")
print("done")
"""


LONG = """
import time
from lbacal.cli import outputs
outputs.PATIENCE_S = 0.1
with outputs.progress() as tell:
    tell("read a.h5")
    tell("fit 10 spectra")
    time.sleep(0.5)
    tell("draw")
with outputs.progress() as tell:
    for k in range(1, 31):
        tell(f"{k} of 30 events", k, 30)
"""


def test_a_pipe_sees_no_bar(repository: Path) -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, cwd=repository)
    assert (done.stdout, done.stderr) == ("done\n", "")


def test_a_pipe_sees_the_steps_of_long_work_and_every_tenth_event(repository: Path) -> None:
    done = subprocess.run([sys.executable, "-c", LONG], capture_output=True, text=True, check=True, cwd=repository)
    events = [f"{k} of 30 events" for k in range(3, 31, 3)]
    assert done.stderr.splitlines() == ["fit 10 spectra", "draw", *events]


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


NOW = 1.8e9
NEW_YEAR_2015 = 1_420_070_400.0


def months(stations: tuple[str, ...], first: int, events: int = 4) -> Spectra:
    """Events on the first of some months of 2014, one antenna a station."""
    n = events * len(stations)
    month = np.tile(first + np.arange(events), len(stations))
    starts = np.array([np.datetime64(f"2014-{k:02d}-01") for k in range(1, 13)]).astype("datetime64[s]").astype(float)
    return Spectra(
        np.array([30.0, 31.0, 32.0]), np.ones((n, 3)), np.array([f"E{k}" for k in month]), starts[month - 1],
        np.repeat(stations, events), np.zeros(n, dtype=np.int64), np.full(n, "X"), np.full(n, 100),
    )  # fmt: skip


@pytest.fixture
def data(tmp_path: Path) -> Path:
    (tmp_path / "2014" / "autumn").mkdir(parents=True)
    write_spectra(months(("CS002", "CS003"), 1), tmp_path / "2014" / "spring.h5")
    write_spectra(months(("CS002",), 8), tmp_path / "2014" / "autumn" / "august.hdf5")
    (tmp_path / "2014" / "notes.txt").write_text("no spectra")
    (tmp_path / "2014" / "broken.h5").write_bytes(b"no HDF5")
    return tmp_path


def test_a_folder_is_its_spectra_files_however_deep_and_other_files_are_passed_by(data: Path) -> None:
    files = find_spectra_files([data / "2014"])
    assert [file.name for file in files] == ["august.hdf5", "spring.h5"]
    twice = find_spectra_files([data / "2014" / "spring.h5", data / "2014"])
    assert [file.name for file in twice] == ["spring.h5", "august.hdf5"]
    assert len(read_selected(files, Selection(), NOW)) == 12


def test_a_window_begins_with_its_first_instant_and_ends_before_its_last(data: Path) -> None:
    files = find_spectra_files([data])
    chosen = read_selected(files, parse_selection("2014-02-01", "2014-04-01", None, None), NOW)
    assert sorted(set(chosen.event_id.tolist())) == ["E2", "E3"]
    year = parse_selection(None, None, 2014, ["CS003", "CS003"])
    assert year == Selection(year.since, year.until, ("CS003",))
    assert year.until is not None
    assert 1e-6 * year.until == NEW_YEAR_2015
    assert len(read_selected(files, year, NOW)) == 4
    assert year.options == " --since 2014-01-01T00:00:00Z --until 2015-01-01T00:00:00Z --station CS003"
    assert Selection().options == ""


def test_nothing_chosen_names_what_there_is(data: Path) -> None:
    with pytest.raises(BadInputError, match=r"there are 2014-01-01 to 2014-11-01 of CS002, CS003"):
        read_selected(find_spectra_files([data]), parse_selection(None, None, 2013, None), NOW)


@pytest.mark.parametrize(
    ("since", "until", "year", "message"),
    [
        ("2014-01-01", None, 2014, "both"),
        ("2014-05-01", "2014-05-01", None, "after the beginning"),
        ("2014", None, None, "ISO 8601"),
    ],
)
def test_windows_that_mean_nothing_are_refused(
    since: str | None, until: str | None, year: int | None, message: str
) -> None:
    with pytest.raises(BadInputError, match=message):
        parse_selection(since, until, year, None)


def test_every_file_is_told_before_it_is_read(data: Path) -> None:
    told: list[str] = []
    read_selected(find_spectra_files([data]), Selection(), NOW, told.append)
    assert told == ["read august.hdf5", "read spring.h5"]
