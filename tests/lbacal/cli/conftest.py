"""One station as files on disk: spectra, instrument and sky power of a chain that is known."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lbacal.cli.main import main
from lbacal_core.instrument.instrument import Instrument, parse_instrument
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.sky.table import SkyPower, write_sky_power
from lbacal_core.spectra.spectra import Spectra, write_spectra

FREQUENCY = np.arange(30.0, 81.0)
EVENTS = 120
Lbacal = Callable[..., tuple[int, str, str]]


def make_instrument() -> Instrument:
    content = {
        "name": "one station", "latitude_deg": 52.9, "longitude_deg": 6.9, "height_m": 49.0,
        "frequency_mhz": FREQUENCY.tolist(), "dipoles": {"X": {"azimuth_deg": 45.0}, "Y": {"azimuth_deg": 135.0}},
        "antenna_gain": (0.01 + 1.0 / (1.0 + ((FREQUENCY - 58.0) / 5.0) ** 2)).tolist(),
        "receiver_gain": (1.0 / (1.0 + (FREQUENCY / 78.0) ** 12)).tolist(),
        "cables": {"80 m": np.linspace(0.5, 0.3, FREQUENCY.size).tolist()},
        "antennas": [{"station": "CS002", "antenna": k, "cable": "80 m"} for k in range(2)],
    }  # fmt: skip
    return parse_instrument(content, "one station")


def make_sky_power() -> SkyPower:
    lst = np.arange(96) * 0.25
    wave = np.outer(1 + 0.25 * np.cos(2 * np.pi * (lst - 18) / 24), (FREQUENCY / 55.0) ** -0.55)
    return SkyPower(FREQUENCY, lst, {"X": wave, "Y": 1.1 * wave})


def make_spectra(instrument: Instrument, sky_power: SkyPower, slope: float = 4.0) -> Spectra:
    """Power of `slope` G_ant (P_sky + 0.05) + 0.2 G_RCU + 0.1 with 2 % of noise: C is 1/2 in every channel."""
    rng = np.random.default_rng(4)
    time_unix = 1.4e9 + np.sort(rng.uniform(0, 3e7, EVENTS))
    lst = local_sidereal_time(time_unix, instrument.longitude_deg)
    power = [
        slope * instrument.antenna_gain * (sky_power.at(dipole, lst) + 0.05) + 0.2 * instrument.receiver_gain + 0.1
        for _ in range(2)
        for dipole in "XY"
    ]
    return Spectra(
        frequency_mhz=FREQUENCY, power=np.concatenate(power) * rng.normal(1, 0.02, (4 * EVENTS, FREQUENCY.size)),
        event_id=np.tile([f"e{k}" for k in range(EVENTS)], 4), time_unix=np.tile(time_unix, 4),
        station=np.full(4 * EVENTS, "CS002"), antenna=np.repeat([0, 0, 1, 1], EVENTS),
        dipole=np.repeat(["X", "Y", "X", "Y"], EVENTS), blocks=np.full(4 * EVENTS, 100),
    )  # fmt: skip


def list_commands(group: Any, *above: str) -> Iterator[tuple[str, Any]]:
    """Every command by its name, those of groups too."""
    for name, one in group.commands.items():
        if not hasattr(one, "commands") or one.invoke_without_command:
            yield " ".join((*above, name)), one
        if hasattr(one, "commands"):
            yield from list_commands(one, *above, name)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with spectra.h5, instrument.json and sky_power.json."""
    instrument, sky_power = make_instrument(), make_sky_power()
    write_spectra(make_spectra(instrument, sky_power), tmp_path / "spectra.h5")
    (tmp_path / "instrument.json").write_text(json.dumps(instrument.as_dict()))
    write_sky_power(sky_power, tmp_path / "sky_power.json")
    return tmp_path


@pytest.fixture
def lbacal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Lbacal:
    """`lbacal` as it runs in the folder of the test: exit code, standard output and standard error."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("lbacal.cli.outputs.PATIENCE_S", 3600.0)  # a slow machine says no more than a fast one

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["lbacal", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            main()
        captured = capsys.readouterr()
        return int(caught.value.code or 0), captured.out, captured.err

    return run
