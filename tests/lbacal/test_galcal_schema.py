"""The schema of galcal-1 and its conformance files, against our writers and our reader."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jsonschema_rs
import pytest

from lbacal.calibration_files import KEY, read_calibrations
from lbacal.tables import rows_of, write_format
from lbacal_core.curves.galcal import find_problems, make_head
from lbacal_core.errors import BadInputError

FOLDER = Path(__file__).parents[2] / "lbacal_core/data/galcal"
SCHEMA = json.loads((FOLDER / "galcal-1.schema.json").read_text())
VALID, INVALID, CONTRADICTORY = (sorted((FOLDER / name).iterdir()) for name in ("valid", "invalid", "contradictory"))


def validator(part: str = "file") -> jsonschema_rs.Draft202012Validator:
    return jsonschema_rs.Draft202012Validator({**SCHEMA, "$ref": f"#/$defs/{part}"})


def rows_in(content: dict[str, Any]) -> list[dict[str, Any]]:
    """The rows as tables hold them: texts empty, and antenna -1, where JSON has null."""
    texts = ("station", "dipole", "flag_reason", "calibration", "answered_by", "valid_from", "valid_to")
    unsaid = dict.fromkeys(texts, "") | {"antenna": -1}
    return [{n: unsaid.get(n) if value is None else value for n, value in row.items()} for row in rows_of(content)]


def refused_by_reader(path: Path) -> bool:
    try:
        return bool(find_problems(read_calibrations(path)))
    except BadInputError:
        return True


@pytest.mark.parametrize("path", VALID, ids=lambda path: path.name)
def test_valid_files_are_read_and_follow_the_schema(path: Path) -> None:
    content = read_calibrations(path)
    assert find_problems(content) == []
    validator().validate(content if path.suffix != ".json" else json.loads(path.read_text()))
    validator("head").validate(make_head(content))
    for row in rows_in(content):
        validator("row").validate(row)


def test_the_answer_is_the_same_in_every_form() -> None:
    first, *others = [read_calibrations(path) for path in VALID if path.stem == "answer" and path.suffix != ".json"]
    answer = read_calibrations(FOLDER / "valid/answer.json")
    assert len(others) == 2
    for one in (first, *others):
        rows = [{name: row[name] for name in told} for row, told in zip(answer["curves"], one["curves"], strict=True)]
        assert (one["curves"], one["budgets"], one["at"]) == (rows, answer["budgets"], answer["at"])


@pytest.mark.parametrize("path", INVALID, ids=lambda path: path.name)
def test_invalid_files_are_refused_by_schema_and_reader(path: Path) -> None:
    content = json.loads(path.read_text())
    assert content.pop("wrong")
    assert not validator().is_valid(content)
    assert refused_by_reader(path)


@pytest.mark.parametrize("path", CONTRADICTORY, ids=lambda path: path.name)
def test_contradictions_are_beyond_the_schema_and_refused_by_the_reader(path: Path) -> None:
    validator().validate(json.loads(path.read_text()))
    assert len(find_problems(read_calibrations(path))) > 0


@pytest.mark.parametrize("kind", ["json", "ecsv", "fits", "hdf5"])
def test_what_is_written_follows_the_schema(tmp_path: Path, calibrations: dict[str, Any], kind: str) -> None:
    calibrations["curves"][1] |= {
        "antenna": None,
        "flag_reason": "gain by 5 % off",
        "valid": {"from": None, "to": None},
    }
    path = tmp_path / {"json": "c.json", "ecsv": "c.ecsv", "fits": "c.fits", "hdf5": "c.h5"}[kind]
    path.write_bytes(json.dumps(calibrations).encode() if kind == "json" else write_format(kind, calibrations))
    content = read_calibrations(path)
    validator().validate(content)
    for row in rows_in(content):
        validator("row").validate(row)


def test_the_head_in_a_table_follows_the_schema(tmp_path: Path, calibrations: dict[str, Any]) -> None:
    from astropy.table import Table

    path = tmp_path / "c.ecsv"
    path.write_bytes(write_format("ecsv", calibrations))
    table = Table.read(path, format="ascii.ecsv")
    validator("head").validate(json.loads(table.meta[KEY]))
    first = {name: column.tolist()[0] for name, column in table.columns.items()}
    # astropy masks empty texts
    row = {name: "" if value is None else None if str(value) == "nan" else value for name, value in first.items()}
    validator("row").validate(row)


def test_every_column_and_field_of_the_page_is_in_the_schema() -> None:
    page = (FOLDER.parents[2] / "docs/formats/galcal.md").read_text()
    text = json.dumps(SCHEMA)
    rows, head = (page.partition(f"## {name}\n")[2].partition("\n## ")[0] for name in ("Rows", "Head"))
    named = [cell for line in (rows + head).splitlines() if line.startswith("| `")
             for cell in line.split("|")[1].replace("`", "").replace(" ", "").split(",")]  # fmt: skip
    assert len(named) > 20
    assert [name for name in named if f'"{name}"' not in text] == []
