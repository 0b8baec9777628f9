from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from typer.testing import CliRunner

from lbacal.cli.main import app
from lbacal_core.instrument.instrument import load_instrument


def test_the_command_writes_an_instrument_with_the_gain_of_a_table(folder: Path) -> None:
    content = json.loads((folder / "instrument.json").read_text())
    del content["antenna_gain"]
    (folder / "bare.json").write_text(json.dumps(content))
    zenith, azimuth = np.arange(0.0, 91.0, 10.0), np.arange(0.0, 360.0, 15.0)
    along = np.broadcast_to(np.cos(np.radians(azimuth)), (2, zenith.size, azimuth.size)).astype(complex)
    across = np.broadcast_to(-np.sin(np.radians(azimuth)), along.shape).astype(complex)
    grid = {"frequency_mhz": [20.0, 90.0], "zenith_deg": zenith, "azimuth_deg": azimuth}
    np.savez(folder / "lba.npz", **grid, v_theta=3.0 * along, v_phi=3.0 * across)
    files = ["--instrument", str(folder / "bare.json"), "--antenna", str(folder / "lba.npz")]
    wanted = [*files, "--source", "a test", "--absolute", "--output", str(folder / "made.json")]
    result = CliRunner().invoke(app, ["antenna-gain", *wanted])
    assert result.exit_code == 0, result.output
    made = load_instrument(str(folder / "made.json"))
    np.testing.assert_allclose(made.antenna_gain, 9.0)
    assert made.antenna_gain_note == "absolute: a test; error of ln G_ant unknown"
    assert Path(str(made.antenna)).name == "lba.npz"
