"""A spectra file as clients send it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lbacal_core.spectra.spectra import Spectra, write_spectra
from tests.service.conftest import MHZ


@pytest.fixture
def file(tmp_path: Path) -> bytes:
    """The spectra of two events of four paths."""
    rows = [(e, a, d) for e in range(2) for a in range(2) for d in "XY"]
    spectra = Spectra(
        frequency_mhz=np.array(MHZ), power=np.array([[1.0 + e, 2.0, 3.0, 4.0] for e, _, _ in rows]),
        event_id=np.array([f"e{e}" for e, _, _ in rows]),
        time_unix=np.array([1393675200.123456 + 86400.0 * e for e, _, _ in rows]),
        station=np.full(len(rows), "CS001"), antenna=np.array([a for _, a, _ in rows]),
        dipole=np.array([d for _, _, d in rows]), blocks=np.full(len(rows), 100),
        environment={"temperature_c": np.array([4.0 + e for e, _, _ in rows])},
    )  # fmt: skip
    write_spectra(spectra, tmp_path / "spectra.h5")
    return (tmp_path / "spectra.h5").read_bytes()
