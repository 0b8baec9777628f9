from __future__ import annotations

import sys
from pathlib import Path

import pytest

from lbacal.cli.main import main
from lbacal.cli.outputs import require_image, require_outputs
from lbacal_core.errors import BadInputError


def test_new_files_and_files_to_be_replaced_are_welcome(tmp_path: Path) -> None:
    (tmp_path / "old.json").write_text("old")
    require_outputs(
        {"--output": tmp_path / "new.ecsv", "--report": tmp_path / "old.json", "--plot": None},
        {"SPECTRA": tmp_path / "s.h5", "--sky-power": None, "--instrument": "lofar-superterp"},
    )


def test_a_folder_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"--output .*expected a file in a folder that exists, found no folder"):
        require_outputs({"--output": tmp_path / "none" / "c.ecsv"}, {})


def test_a_file_in_place_of_a_folder_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInputError, match="found no folder"):
        require_outputs({"--output": tmp_path / "file" / "c.ecsv"}, {})


def test_a_folder_in_place_of_a_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="expected a file to write, found a folder"):
        require_outputs({"--report": tmp_path}, {})


def test_two_outputs_never_share_a_file(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"--report .*expected a file of its own, found the file of --output"):
        require_outputs({"--output": tmp_path / "c", "--report": tmp_path / "." / "c"}, {})


def test_an_output_never_replaces_an_input(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="found the file of SPECTRA"):
        require_outputs({"--output": tmp_path / "s.h5"}, {"SPECTRA": str(tmp_path / "s.h5")})


@pytest.mark.parametrize(
    "arguments",
    [
        ["fit", "in.h5", "--instrument", "lofar-superterp", "--output", "C.ecsv", "--report", "none/out"],
        ["fit", "in.h5", "--instrument", "lofar-superterp", "--output", "none/out", "--report", "fit.json"],
        ["sky-power", "--instrument", "lofar-superterp", "--output", "none/out"],
        ["lst-curve", "in.csv", "--report", "none/out"],
        ["lst-curve", "in.csv", "--report", "R.json", "--plot", "none/out"],
        ["spectra", "in.dat", "--output", "none/out"],
        ["spectra", "in.dat", "--inspect", "none/out"],
    ],
)
def test_every_command_refuses_an_output_before_it_looks_at_its_input(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["lbacal", *arguments])
    with pytest.raises(SystemExit) as caught:
        main()
    assert caught.value.code == 2
    assert capsys.readouterr().err.endswith("none/out: expected a file in a folder that exists, found no folder none\n")


@pytest.mark.parametrize("name", ["C", "C.jpeg", "C.png.txt"])
def test_a_figure_in_a_form_that_cannot_be_drawn_is_refused(name: str) -> None:
    with pytest.raises(BadInputError, match=r"ends in \.png, \.pdf, \.svg"):
        require_image(Path(name))


def test_a_figure_in_a_known_form_or_none_is_fine() -> None:
    for path in (Path("C.PNG"), Path("a/C.pdf"), None):
        require_image(path)
