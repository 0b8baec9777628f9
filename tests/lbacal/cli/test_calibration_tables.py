from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from lbacal.calibration_files import read_calibrations
from lbacal.tables import write_format
from tests.lbacal.cli.conftest import Lbacal


@pytest.fixture
def table(tmp_path: Path, calibrations: dict[str, Any]) -> Path:
    path = tmp_path / "c.fits"
    path.write_bytes(write_format("fits", calibrations))
    return path


def test_a_file_that_follows_its_format_is_described(lbacal: Lbacal, table: Path) -> None:
    code, out, err = lbacal("check-table", table.name)
    assert (code, err) == (0, "")
    assert out == (
        "c.fits: follows galcal-1: 4 curves, 30 to 80 MHz, covariance of 4, 1 budgets, in effect at "
        "2014-05-01T00:00:00Z, as of 2026-01-01T00:00:00Z\n"
    )


def test_a_file_that_contradicts_itself_fails_and_one_that_cannot_be_read_is_bad_input(
    lbacal: Lbacal, table: Path, calibrations: dict[str, Any]
) -> None:
    calibrations["curves"][0]["c_sigma_stat"][3] *= 2
    Path("bad.json").write_text(json.dumps(calibrations))
    code, out, _ = lbacal("check-table", table.name, "bad.json")
    assert code == 1
    assert "bad.json: 1 problems\n  CS002 4 X: covariance: expected c_sigma_stat^2" in out
    code, out, err = lbacal("check-table", "absent.fits", "bad.json")
    assert (code, err) == (2, "lbacal: absent.fits: expected a file, found nothing\n")
    assert "bad.json: 1 problems" in out, "a file that cannot be read does not hide the next"


@pytest.mark.parametrize("name", ["c.ecsv", "c.h5", "c.json"])
def test_an_export_keeps_everything(lbacal: Lbacal, table: Path, name: str) -> None:
    code, out, err = lbacal("export", table.name, "--output", name)
    assert (code, out, err) == (0, f"wrote {name}: 4 curves as {'hdf5' if name == 'c.h5' else name[2:]}\n", "")
    assert read_calibrations(Path(name)) == read_calibrations(table)
    assert lbacal("check-table", name)[0] == 0


def test_nuradio_has_one_path_or_the_mean(lbacal: Lbacal, table: Path) -> None:
    one = ("--station", "CS002", "--antenna", "17", "--dipole", "X")
    assert lbacal("export", table.name, "--output", "one.txt", *one)[0] == 0
    assert "CS002 antenna 17 X, answered by antenna" in Path("one.txt").read_text()
    code, _, err = lbacal("export", table.name, "--output", "all.txt")
    assert (code, "found 4 curves" in err) == (2, True)
    assert lbacal("export", table.name, "--output", "all.txt", "--mean")[0] == 0
    assert "mean recorded power of 4 curves" in Path("all.txt").read_text()


def test_station_tables_and_uvcal_are_written(lbacal: Lbacal, table: Path) -> None:
    assert lbacal("export", table.name, "--output", "s.h5", "--format", "lofar2")[0] == 0
    pytest.importorskip("pyuvdata")
    assert lbacal("export", table.name, "--output", "c.calh5", "--instrument", "lofar-superterp")[0] == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--output", "c.xml"), "a name that ends in .ecsv"),
        (("--output", "c.calfits"), "--instrument: expected the instrument"),
        (("--output", "c.csv", "--mean"), "--mean: expected the format nuradio, found csv"),
        (
            ("--output", "c.csv", "--station", "cs002"),
            "a curve of that station, antenna and dipole, found none of 'cs002' (is CS002 4 X meant?)",
        ),
        (("--output", "c.fits"), "a file of its own"),
    ],
)
def test_bad_usage_is_one_sentence(lbacal: Lbacal, table: Path, arguments: tuple[str, ...], said: str) -> None:
    code, out, err = lbacal("export", table.name, *arguments)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert said in err
