from __future__ import annotations

import errno
import json
import re
import subprocess
import sys
from functools import partial
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import typer.main
from typer.core import TyperGroup
from typer.testing import CliRunner

from lbacal import FIT
from lbacal.cli import main as command
from lbacal.cli.main import app
from lbacal_core.errors import BadInputError, LbacalError, UnknownNameError, UnreadableFileError
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.lstcurve.curve import measured_curve
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.table import read_sky_power
from lbacal_core.spectra.spectra import write_spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings
from tests.lbacal.cli.conftest import Lbacal, list_commands

LBACAL = Path(sys.executable).with_name("lbacal")


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
    def work(**_: Any) -> None:
        raise error

    monkeypatch.setattr(command, "app", work)
    with pytest.raises(SystemExit) as caught:
        command.run()
    assert caught.value.code == code
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("lbacal: ")
    assert captured.err.count("\n") == 1
    assert "None" not in captured.err


@pytest.mark.parametrize(
    ("sentence", "told"),
    [
        ("no change 99; GET /v1/changes lists them", "no change 99; lbacal changes lists them"),
        ("no tag a; GET /v1/tags lists them", "no tag a; lbacal tag lists them"),
        ("body.scope: expected 'array', found 'all'", "--scope: expected 'array', found 'all'"),
        ("body.valid_from: expected an instant", "--from: expected an instant"),
        ("body.spectra[0].power: expected 4 channels", "body.spectra[0].power: expected 4 channels"),
        (
            "it is none: gap=hold of GET /v1/calibrations/effective answers with the nearest",
            "it is none: lbacal effective --gap hold answers with the nearest",
        ),
    ],
)
def test_the_sentences_of_a_server_speak_of_the_commands(sentence: str, told: str) -> None:
    """They spoke of routes and fields, which who types a command has never seen."""
    assert command._say(LbacalError(sentence)) == told


def test_every_command_is_listed_once_in_a_group_with_its_whole_first_sentence() -> None:
    command.add_commands()
    listed = [name for names in command.GROUPS.values() for name in names]
    whole = typer.main.get_command(app)
    assert isinstance(whole, TyperGroup)
    assert sorted(listed) == sorted(whole.commands)
    shown = CliRunner().invoke(app, ["--help"]).output
    assert [title for title in command.GROUPS if f"\n{title}:\n" not in shown] == []
    assert "name the cause, extend the\n" in shown
    assert "..." not in shown.partition("Options:")[2]


def test_commands_of_other_wheels_come_in_one_order_wherever_the_wheels_lie(monkeypatch: pytest.MonkeyPatch) -> None:
    """The reference of all commands, docs/commands.md, is the same on every machine."""
    for listed in (("server", "paper"), ("paper", "server")):
        loaded = list[str]()
        wheels = [SimpleNamespace(name=name, load=partial(loaded.append, name)) for name in listed]
        monkeypatch.setattr(command, "entry_points", lambda wheels=wheels, **_: _Wheels(wheels))
        command.add_commands.__wrapped__()
        assert loaded == ["paper", "server"]


class _Wheels(list[Any]):
    names = frozenset(command.ADDED)


RUN_OR_WRITE = (
    "serve", "scheduler", "worker", "db upgrade", "db check", "db backup", "db copy", "db repair-clock", "keys revoke",
    "sky-power", "antenna-gain", "spectra", "import", "export", "paper", "causes add",
)  # fmt: skip
"""Commands that run something, or write a file and say so."""


def test_every_command_that_answers_does_so_as_json() -> None:
    command.add_commands()
    listed = list_commands(typer.main.get_command(app))
    options = {name: {option for parameter in one.params for option in parameter.opts} for name, one in listed}
    assert {"audit", "changes", "changes decide", "keys list", "sync"} < set(options)
    assert sorted(name for name, known in options.items() if "--json" not in known) == sorted(RUN_OR_WRITE)


PREDICT = "predict --simulation lofar-superterp --station CS002"
WHERE = "--instrument instrument.json"
ANSWERS = {
    f"audit spectra.h5 {WHERE} --report R.json": "spectra.h5: nothing wrong",
    f"budget spectra.h5 {WHERE} --report R.json": "C is known best at",
    f"fit spectra.h5 {WHERE} --sky-power sky_power.json --report fit.json --output R.json": "4 of 4 curves converged",
    f"lst-curve {measured_curve()} {WHERE} --sky-power sky_power.json --report R.json": "chi2 per point",
    f"investigate --lst-curve {measured_curve()} {WHERE} --sky-power sky_power.json --report R.json": "wrote R.json",
    f"{PREDICT} --antenna 0 --dipole X --at 2014-05-01 --output R.json": "sefd",
}


@pytest.mark.parametrize("asked", ANSWERS)
def test_a_command_answers_in_words_and_as_json_what_it_writes(lbacal: Lbacal, folder: Path, asked: str) -> None:
    code, words, _ = lbacal(*asked.split())
    assert (code, ANSWERS[asked] in words, "None" in words) == (0, True, False), words
    assert json.loads(lbacal(*asked.split(), "--json")[1]) == json.loads((folder / "R.json").read_text())


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
    program = f"import sys\nsys.modules |= dict.fromkeys({(*FIT, 'erfa')!r})\nimport lbacal.cli.main"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_command_writes_an_instrument_with_the_gain_of_a_table(folder: Path) -> None:
    content = json.loads((folder / "instrument.json").read_text())
    del content["antenna_gain"]
    (folder / "bare.json").write_text(json.dumps(content))
    zenith, azimuth = np.arange(0.0, 91.0, 10.0), np.arange(0.0, 360.0, 15.0)
    along = np.broadcast_to(np.cos(np.radians(azimuth)), (2, zenith.size, azimuth.size)).astype(complex)
    across = np.broadcast_to(-np.sin(np.radians(azimuth)), along.shape).astype(complex)
    grid = {"frequency_mhz": [20.0, 90.0], "zenith_deg": zenith, "azimuth_deg": azimuth}
    np.savez(folder / "lba.npz", **grid, v_theta=3.0 * along, v_phi=3.0 * across)
    for instrument in ("lofar-superterp", str(folder / "bare.json")):
        files = ["--instrument", instrument, "--antenna", str(folder / "lba.npz")]
        wanted = [*files, "--source", "a test", "--absolute", "--output", str(folder / "made.json")]
        result = CliRunner().invoke(app, ["antenna-gain", *wanted])
        assert result.exit_code == 0, result.output
        assert "G_ant at most 9 m^2 at " in result.output
        made = load_instrument(str(folder / "made.json"))
        np.testing.assert_allclose(made.antenna_gain, 9.0)
    assert made.antenna_gain_note == "absolute: a test; error of ln G_ant unknown"
    assert Path(str(made.antenna)).name == "lba.npz"


def test_sky_power_writes_a_file_that_reads_back_and_takes_sky_parameters_and_sources(tmp_path: Path) -> None:
    common = ["sky-power", "--instrument", "lofar-superterp", "--output"]
    plain, more = tmp_path / "P.json", tmp_path / "Q.json"
    result = CliRunner().invoke(app, [*common, str(plain)])
    assert result.exit_code == 0, result.output
    assert "X (arm at 45 deg)" in result.output
    assert read_sky_power(plain).power["Y"].shape == (96, 51)
    options = ["--scale", "1.1", "--isotropic", "0.5", "--source", "cas-a", "--source", "cyg-a", "--year", "2013"]
    result = CliRunner().invoke(app, [*common, str(more), *options])
    assert result.exit_code == 0, result.output
    assert "gsm(scale=1.1, isotropic=0.5)" in result.output
    assert (read_sky_power(more).power["X"] > 1.1 * read_sky_power(plain).power["X"]).all()


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A day of a simulated station of which antenna 3 is dead."""
    instrument = load_instrument("lofar-superterp")
    settings = TwinSettings(
        years=1 / 365.25, events_per_year=60 * 365, stations=("CS002",), antennas=10,
        event_gain_common=0.01, event_gain_path=0.01, radiometer=0.005,
    )  # fmt: skip
    campaign = simulate_campaign(settings, instrument, compute_sky_power(instrument), np.random.default_rng(8))
    spectra = campaign.spectra
    spectra.power[spectra.antenna == 3] *= 0.01
    path = tmp_path_factory.mktemp("audit") / "s.h5"
    write_spectra(spectra, path)
    return path


def test_the_audit_prints_a_line_a_question_writes_report_and_page_and_exits_with_3(
    data: Path, tmp_path: Path, lbacal: Lbacal
) -> None:
    report, page = tmp_path / "audit.json", tmp_path / "audit.html"
    code, said, _ = lbacal("audit", data, "--instrument", "lofar-superterp", "--report", report, "--html", page)
    assert code == 3
    assert "antenna 3 X is dead" in said
    content = json.loads(report.read_text())
    assert content["healthy"] is False
    assert {line["check"] for line in content["lines"] if line["verdict"] == "wrong"} == {"dead"}
    written = page.read_text()
    assert re.findall(r'<svg [^>]*aria-label="([^:"]*)', written) == ["CS002 X", "CS002 Y"] * 2, (
        "map and course of each"
    )
    assert all(f'<th scope="row">{name}</th>' in written for name in ("file", "dates", "instrument", "sky", "lbacal"))


def test_a_file_that_is_no_data_is_refused_with_2(tmp_path: Path, lbacal: Lbacal) -> None:
    (tmp_path / "s.txt").write_text("power")
    code, _, err = lbacal("audit", "s.txt", "--instrument", "lofar-superterp")
    assert (code, "uvh5" in err) == (2, True)
