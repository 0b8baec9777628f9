from __future__ import annotations

from pathlib import Path

from typer.testing import CliRunner

from lbacal.cli.main import app
from lbacal_core.skypower.table import read_sky_power


def test_sky_power_writes_a_file_that_reads_back(tmp_path: Path) -> None:
    target = tmp_path / "P.json"
    result = CliRunner().invoke(app, ["sky-power", "--instrument", "lofar-superterp", "--output", str(target)])
    assert result.exit_code == 0, result.output
    assert "X (arm at 45 deg)" in result.output
    assert read_sky_power(target).power["Y"].shape == (96, 51)


def test_sky_power_takes_sky_parameters_and_sources(tmp_path: Path) -> None:
    common = ["sky-power", "--instrument", "lofar-superterp", "--output"]
    plain, more = tmp_path / "P.json", tmp_path / "Q.json"
    assert CliRunner().invoke(app, [*common, str(plain)]).exit_code == 0
    options = ["--scale", "1.1", "--isotropic", "0.5", "--source", "cas-a", "--source", "cyg-a", "--year", "2013"]
    result = CliRunner().invoke(app, [*common, str(more), *options])
    assert result.exit_code == 0, result.output
    assert "gsm(scale=1.1, isotropic=0.5)" in result.output
    assert (read_sky_power(more).power["X"] > 1.1 * read_sky_power(plain).power["X"]).all()


def test_sky_power_has_an_example() -> None:
    assert "Example: lbacal sky-power" in CliRunner().invoke(app, ["sky-power", "--help"]).output
