"""NuRadioReco's released package takes our noise, our calibration and our table, in an environment of its own."""

from __future__ import annotations

import subprocess
import sys
import sysconfig
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from lbacal_core.grids import Floats

pytestmark = pytest.mark.long
PACKAGES = ("nuradiomc==3.1.0", "aenum", "pymongo", "radiotools", "six", "tinydb", "tinydb-serialization")
"""35 MB that our environment has not; it has the others that these modules import."""
MHZ = np.fft.rfftfreq(8192, 1 / 200.0)
BAND = (MHZ >= 30.0) & (MHZ <= 80.0)


@pytest.fixture(scope="module")
def found(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Floats]:
    folder = tmp_path_factory.mktemp("nuradio")
    environment, uv = folder / "venv", str(Path(sys.executable).with_name("uv"))
    python = str(environment / "bin/python")
    subprocess.run([uv, "venv", "--python", sys.executable, str(environment)], check=True, capture_output=True)
    install = [uv, "pip", "install", "--no-deps", "--python", python, *PACKAGES]
    installed = subprocess.run(install, check=False, capture_output=True, text=True)
    if installed.returncode:
        pytest.skip(f"no package index gives NuRadioReco: {installed.stderr[-200:]}")
    purelib = next(environment.glob("lib/python*/site-packages"))
    (purelib / "libraries.pth").write_text(f"{request.config.rootpath}\n{sysconfig.get_path('purelib')}\n")
    script = Path(__file__).with_name("nuradio_pipeline.py")
    ran = subprocess.run(
        [python, str(script), str(folder)], check=False, capture_output=True, text=True, cwd=folder, timeout=300
    )
    assert ran.returncode == 0, ran.stderr
    with np.load(folder / "found.npz") as arrays:
        return {name: arrays[name] for name in arrays.files}


def spectrum(traces: Floats) -> Floats:
    return np.abs(np.fft.rfft(traces, axis=-1)) ** 2


def test_every_channel_gets_the_power_of_its_own_path_and_the_gain_of_the_event(found: Mapping[str, Floats]) -> None:
    # one-sided density 2 |X|^2 / (n f_s), over 50 Ohm
    density = 2.0 * spectrum(found["adc"]) / (8192 * 200.0) / 50.0
    expected = np.array([np.interp(MHZ, np.arange(30.0, 81.0), power) for power in found["power"]])
    ratio = (density / expected)[..., BAND]
    # 41 bins a channel of 1 MHz in 20 events: 3.5 %, and 1.2 % of the gain of events
    binned = ratio.mean(axis=0)[:, :2040].reshape(4, 51, 40).mean(axis=2)
    np.testing.assert_allclose(binned, 1.0, atol=0.18)
    np.testing.assert_allclose(ratio.mean(axis=(0, 2)), 1.0, atol=0.06)
    assert 0.02 < ratio.mean(axis=2).std(axis=0).mean() < 0.10
    assert np.all(density[..., (MHZ < 29.0) | (MHZ > 81.0)] < 1e-12 * expected.max())


def test_c_of_every_path_makes_volts_of_it(found: Mapping[str, Floats]) -> None:
    assert set(found["said"].ravel().tolist()) == {"ok"}
    c = np.array([np.interp(MHZ, np.arange(30.0, 81.0), one) for one in found["c"]])[:, BAND]
    before, after = (np.fft.rfft(found[name], axis=-1)[..., BAND] for name in ("adc", "volts"))
    np.testing.assert_allclose(after, before * c, rtol=1e-6)
    level = [np.sqrt(np.mean(found[name] ** 2)) for name in ("in_volts", "volts")]
    assert level[0] == pytest.approx(level[1], rel=0.15)


def test_their_calibrator_reads_our_table(found: Mapping[str, Floats]) -> None:
    before, after = (np.fft.rfft(found[name], axis=-1)[..., BAND] for name in ("before", "after"))
    scale = np.abs(after / before) / np.interp(MHZ, np.arange(101.0), found["table"])[BAND]
    np.testing.assert_allclose(scale / scale[:, :1], 1.0, rtol=1e-6)
