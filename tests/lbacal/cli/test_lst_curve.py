from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lbacal_core.instrument.instrument import Instrument
from lbacal_core.lstcurve.curve import measured_curve


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """An instrument and a sky power file on the channels of the low band."""
    folder = tmp_path_factory.mktemp("inputs")
    frequency = np.arange(30.0, 81.0)
    gain = 1.0 / (1.0 + ((frequency - 58.0) / 5.0) ** 2)
    instrument = Instrument(
        "plain", 52.9, 6.87, 49.0, frequency, {"X": 45.0, "Y": 135.0}, gain, np.ones(51), {"80": np.full(51, 0.3)}, ()
    )
    (folder / "i.json").write_text(json.dumps(instrument.as_dict()))
    lst = np.arange(96) * 0.25
    rows = np.outer(1 + 0.3 * np.cos((lst - 19) * np.pi / 12), (frequency / 55) ** -0.5).tolist()
    sky = {"frequency_mhz": frequency.tolist(), "lst_hours": lst.tolist(), "X": rows, "Y": rows}
    (folder / "p.json").write_text(json.dumps(sky))
    return ["--instrument", str(folder / "i.json"), "--sky-power", str(folder / "p.json")]


def _run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "lbacal", "lst-curve", *arguments], capture_output=True, text=True, check=False
    )


@pytest.mark.long
def test_the_measured_curve_ends_in_a_report_and_a_plot(inputs: list[str], tmp_path: Path) -> None:
    report, plot = tmp_path / "r.json", tmp_path / "f.png"
    done = _run(str(measured_curve()), *inputs, "--report", str(report), "--plot", str(plot))
    assert done.returncode == 0, done.stderr
    assert "chi2 per point" in done.stdout
    assert json.loads(report.read_text())["points"] == 91
    assert plot.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--band", "90", "95"], "band: expected"),
        (["--plot", "f.xyz"], "--plot f.xyz: expected"),
        (["--instrument", "nowhere"], "unknown instrument"),
        (["--plot", "nowhere/f.png"], "a folder that exists"),
    ],
)
def test_bad_usage_is_one_sentence_and_exit_2(
    inputs: list[str], tmp_path: Path, arguments: list[str], message: str
) -> None:
    done = _run(str(measured_curve()), *inputs, "--report", str(tmp_path / "r.json"), *arguments)
    assert done.returncode == 2
    assert message in done.stderr
    assert "Traceback" not in done.stderr


def test_a_broken_curve_is_one_sentence_and_exit_2(inputs: list[str], tmp_path: Path) -> None:
    broken = tmp_path / "l.csv"
    broken.write_text("lst_h,x_db\n0,1\n")
    done = _run(str(broken), *inputs, "--report", str(tmp_path / "r.json"))
    assert done.returncode == 2
    assert (
        done.stderr.strip()
        == "lbacal: l.csv: expected the columns lst_h, x_db, y_db, error_db, found no y_db, error_db"
    )
