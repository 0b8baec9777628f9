from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from lbacal_paper.showers.coreas import STATVOLT_PER_CM

STEP_S = 2e-10
SAMPLES = 2000
WIDTH_S = 2e-9
PLACES_CM = np.array([[10_000.0, 0.0, 700.0], [0.0, 20_000.0, 700.0], [-5000.0, -5000.0, 700.0]])
"""North, west, up."""


def pulse(axis: int, amplitude: float = 1.0) -> np.ndarray:
    """A Gaussian pulse along one axis of CoREAS (x north, y west, z up), statvolt per cm: time and three components."""
    time = np.arange(SAMPLES) * STEP_S
    rows = np.zeros((SAMPLES, 4))
    rows[:, 0] = time
    rows[:, 1 + axis] = amplitude / STATVOLT_PER_CM * np.exp(-0.5 * ((time - 1e-7) / WIDTH_S) ** 2)
    return rows


@pytest.fixture
def hdf5_shower(tmp_path: Path) -> Path:
    """Three antennas, a pulse along north, along west and up; at 60 deg, moving to magnetic north."""
    path = tmp_path / "SIM1.hdf5"
    with h5py.File(path, "w") as file:
        group = file.create_group("CoREAS")
        group.attrs["ShowerZenithAngle"], group.attrs["ShowerAzimuthAngle"] = 60.0, 0.0
        group.attrs["PrimaryParticleEnergy"] = 1e17
        for k, place in enumerate(PLACES_CM):
            data = file.create_dataset(f"CoREAS/observers/a{k}", data=pulse(k))
            data.attrs["position"] = place
    return path


@pytest.fixture
def reas_shower(tmp_path: Path) -> Path:
    """The same shower as a folder of .dat files."""
    (tmp_path / "SIM2.reas").write_text(
        "# CoREAS\nShowerZenithAngle = 60.0 ; degrees\nShowerAzimuthAngle = 0.0\nPrimaryParticleEnergy = 1e17 ; eV\n"
    )
    lines = [f"AntennaPosition = {p[0]} {p[1]} {p[2]} a{k}" for k, p in enumerate(PLACES_CM)]
    (tmp_path / "SIM2.list").write_text("\n".join(lines) + "\n")
    (tmp_path / "SIM2_coreas").mkdir()
    for k in range(3):
        np.savetxt(tmp_path / f"SIM2_coreas/raw_a{k}.dat", pulse(k))
    return tmp_path / "SIM2.reas"
