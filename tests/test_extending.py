"""docs/how-to/add-a-cause.md followed to the letter: a cause takes two files, an axis one."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ASK = """
import numpy as np
from dataclasses import replace
from lbacal_core.discovery.report import investigate
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.power import compute_sky_power
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.hardware import GainTemperature
from lbacal_twin.settings import TwinSettings
from validation.reference import describe_causes

chain = load_instrument("lofar-superterp")
sky = compute_sky_power(chain)
settings = TwinSettings(stations=("CS002",), antennas=4, events_per_year=250)
follows = [GainTemperature(size=0.02)]
for faults, amount in ((follows, 0.0), ([], 0.02)):
    spectra = simulate_campaign(settings, chain, sky, np.random.default_rng(2), faults).spectra
    wind = spectra.environment["temperature_c"]  # by the name of a column that nobody knows yet
    unknown = amount * np.outer(np.cos(wind / 3.0), np.linspace(0.0, 2.0, 51))
    blown = replace(spectra, power=spectra.power * (1.0 + unknown), environment={"wind_m_s": wind})
    report, _ = investigate(blown, Simulation(chain, sky))
    left = report["unexplained"]
    print(report["verdict"], [f["cause"] for f in report["findings"]], left and left["where"]["axis"])
print("gain_wind" in describe_causes())
"""


def blocks_of_the_page(repository: Path) -> dict[str, str]:
    """The Python blocks of the page by the file that their first line names."""
    page = (repository / "docs/how-to/add-a-cause.md").read_text()
    found = re.findall(r"```python\n# (\S+)\n(.*?)```", page, re.DOTALL)
    return dict(found)


@pytest.mark.long
def test_a_cause_takes_two_files_and_an_axis_one(repository: Path, tmp_path: Path) -> None:
    for package in ("lbacal_core", "lbacal", "service"):
        shutil.copytree(repository / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    blocks = blocks_of_the_page(repository)
    assert len(blocks) == 3, "two files for a cause, one for an axis"
    (of_class, text), (of_list, line), (of_axes, entry) = blocks.items()
    amplifier, catalogue, axes = (tmp_path / name for name in (of_class, of_list, of_axes))
    amplifier.write_text(f"{amplifier.read_text()}\n\n{text}")
    catalogue.write_text(catalogue.read_text().replace("    chain.GainDrift(),\n", f"    chain.GainDrift(),\n{line}"))
    axes.write_text(axes.read_text().replace("    *(_period", f"{entry}    *(_period"))
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", ASK],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    first, second, page = done.stdout.splitlines()
    assert first == "explained ['gain_wind'] None"
    assert second.endswith(" wind")
    assert second.startswith("unexplained")
    assert page == "True"
