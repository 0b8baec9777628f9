from __future__ import annotations

import json
import runpy
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from astropy.table import Table

from lbacal.calibration_files import read_calibrations
from lbacal.tables import COLUMNS, write_format
from lbacal_core.curves.galcal import CARRIED, make_head
from lbacal_core.errors import BadInputError, UnreadableFileError

ENDINGS = {"ecsv": ".ecsv", "fits": ".fits", "hdf5": ".h5"}


@pytest.mark.parametrize("kind", ENDINGS)
def test_a_file_gives_back_rows_covariances_and_budgets_bit_by_bit(
    tmp_path: Path, calibrations: dict[str, Any], kind: str
) -> None:
    path = tmp_path / f"c{ENDINGS[kind]}"
    calibrations["curves"][1] |= {"flag_reason": "gain by 5 % off: é", "valid": {"from": "2014-01-01", "to": None}}
    path.write_bytes(write_format(kind, calibrations))
    found = read_calibrations(path)
    for before, after in zip(calibrations["curves"], found["curves"], strict=True):
        assert {name: before[name] for name in after} == after
    assert (found["budgets"], found["at"], found["as_of"]) == tuple(calibrations[n] for n in ("budgets", "at", "as_of"))
    assert write_format(kind, found) == path.read_bytes()


def test_the_json_of_an_answer_and_of_a_fit_are_read_too(tmp_path: Path, calibrations: dict[str, Any]) -> None:
    path = tmp_path / "c.json"
    path.write_text(json.dumps(calibrations))
    assert read_calibrations(path)["curves"] == calibrations["curves"]
    # fit.json: nothing of promotion, and curves without values
    bare = [{name: one[name] for name in one if name not in ("factor", "valid", "calibration", "answered_by")}
            for one in calibrations["curves"]]  # fmt: skip
    path.write_text(json.dumps({"status": "converged", "curves": [*bare, {"c": None, "station": "CS003"}]}))
    found = read_calibrations(path)
    assert len(found["curves"]) == 4
    assert found["curves"][0]["valid"] == {"from": None, "to": None}


def test_the_served_hdf5_holds_budgets_of_a_megabyte(tmp_path: Path, calibrations: dict[str, Any]) -> None:
    calibrations["budgets"]["x"] = {"text": "y" * 1_000_000}
    path = tmp_path / "c.h5"
    path.write_bytes(write_format("hdf5", calibrations))
    assert read_calibrations(path)["budgets"] == calibrations["budgets"]


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("c.txt", b"1", "a name that ends in .ecsv, .fits, .h5, .hdf5, .json, found .txt"),
        ("c.json", b"[]", "a JSON object, found list"),
        ("c.json", b'{"curves": 3}', "a list of curves, found 3"),
        ("c.json", b'{"curves": [{"c": [1], "station": "A", "antenna": 1, "dipole": "X"}]}', "no frequency_mhz"),
    ],
)
def test_what_is_no_calibration_file_is_refused(tmp_path: Path, name: str, content: bytes, said: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(BadInputError, match=said):
        read_calibrations(tmp_path / name)


@pytest.mark.parametrize("name", ["c.json", "c.ecsv", "c.fits", "c.h5"])
def test_a_broken_file_is_one_sentence(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"no such thing \x00\xff")
    with pytest.raises(UnreadableFileError):
        read_calibrations(tmp_path / name)


def test_tables_of_other_kinds_are_refused(tmp_path: Path, calibrations: dict[str, Any]) -> None:
    Table({"a": [1]}).write(tmp_path / "a.ecsv", format="ascii.ecsv")
    with pytest.raises(BadInputError, match="no station, antenna"):
        read_calibrations(tmp_path / "a.ecsv")
    path = tmp_path / "c.h5"
    path.write_bytes(write_format("hdf5", calibrations))
    with h5py.File(path, "a") as root:
        del root.attrs["galcal"]
    with pytest.raises(BadInputError, match="the head of galcal-1"):
        read_calibrations(path)
    with h5py.File(path, "a") as root:
        root.attrs["galcal"] = "{"
    with pytest.raises(UnreadableFileError, match="JSON text"):
        read_calibrations(path)


def test_the_page_names_every_column_and_field_and_its_example_runs(
    repository: Path, tmp_path: Path, calibrations: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (repository / "docs/formats/galcal.md").read_text()
    head = make_head(calibrations)
    (budget,) = calibrations["budgets"].values()
    fields = [*COLUMNS, *head, *CARRIED, *head["covariances"]["CS002 17 X"], *budget, *budget["terms"][0]]
    assert [name for name in fields if f"`{name}`" not in page] == []
    monkeypatch.chdir(tmp_path)
    Path("C.ecsv").write_bytes(write_format("ecsv", calibrations))
    example = page.partition("```python\n")[2].partition("```")[0]
    Path("example.py").write_text(example)
    found = runpy.run_path("example.py")
    # sky 6 % and a slope, own 1 %, statistical 0.4 %: one draw lies within four of them
    assert np.std(found["ln_c"]) < 0.08
    assert found["ln_c"].shape == (51,)
