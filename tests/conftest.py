from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import settings

from lbacal_core.curves.covariance import Budget, BudgetTerm, CurveCovariance
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.sky.table import SkyPower
from validation.running.postgres import find_binaries

FREQUENCY = np.arange(30.0, 81.0)

settings.register_profile("lbacal", deadline=None)  # a busy machine fails no test
settings.load_profile("lbacal")


SECOND_TIER = ("e2e", "lbacal_paper", "validation")
"""Rooms whose tests all belong to `./dev test --all`; elsewhere a test of more than about a second is marked `long`."""


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """The first tier does not even read the rooms of the second."""
    room = collection_path.relative_to(Path(__file__).parent).parts[:1]
    return True if config.option.markexpr == "not long" and room and room[0] in SECOND_TIER else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.relative_to(Path(__file__).parent).parts[0] in SECOND_TIER:
            item.add_marker("long")


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of measured data beside the project; tests that need it are marked `shared`."""
    folder = Path(__file__).parents[2] / "shared"
    if not folder.is_dir():
        pytest.skip("needs the folder ../shared beside the project")
    return folder


@pytest.fixture(scope="session")
def needs_postgres() -> None:
    """Skip where no PostgreSQL server is to be had; under CI the test goes on and fails."""
    if not (os.environ.get("CI") or os.environ.get("LBACAL_TEST_PG") or find_binaries()):
        pytest.skip("needs PostgreSQL server binaries, or LBACAL_TEST_PG")


@pytest.fixture(scope="session")
def repository() -> Path:
    """The root of the checkout."""
    return Path(__file__).parents[1]


@pytest.fixture(scope="session")
def tracked(repository: Path) -> list[Path]:
    """Every file under version control, relative to the root."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=repository, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("needs a git checkout")
    return [Path(name) for name in listed.stdout.split("\0") if name and (repository / name).is_file()]


@pytest.fixture(scope="session")
def low_band() -> Instrument:
    """A small resonant instrument: two stations of six antennas, three cables."""
    cables = {
        name: 10 ** (-length * 0.008 * (FREQUENCY / 30) ** 0.5 / 10)
        for name, length in (("50", 50), ("80", 80), ("115", 115))
    }
    records = [AntennaRecord(s, a, ("50", "80", "115")[a % 3]) for s in ("CS002", "CS003") for a in range(6)]
    return Instrument(
        name="resonant",
        latitude_deg=52.9153,
        longitude_deg=6.8698,
        height_m=49.0,
        frequency_mhz=FREQUENCY,
        dipole_azimuth_deg={"X": 45.0, "Y": 135.0},
        antenna_gain=0.01 + 1.0 / (1.0 + ((FREQUENCY - 58.0) / 5.0) ** 2),
        receiver_gain=1.0 / (1.0 + (FREQUENCY / 78.0) ** 12),
        cables=cables,
        antennas=records,
    )


@pytest.fixture(scope="session")
def two_waves() -> SkyPower:
    """A sky of two harmonics, enough for every stage of the chain to matter."""
    lst = np.arange(96) * 0.25 + 0.125
    angle = 2 * np.pi * lst / 24
    spectrum = (FREQUENCY / 55.0) ** -0.55
    shape = {"X": 1 + 0.25 * np.cos(angle - 4.9), "Y": 1 + 0.22 * np.cos(angle - 4.5) + 0.05 * np.cos(2 * angle)}
    return SkyPower(FREQUENCY, lst, {name: np.outer(values, spectrum) for name, values in shape.items()}, "two waves")


FLIP_CHILD = """
import signal, sys
from pathlib import Path
from lbacal_core.errors import LbacalError
{imports}
for name in sys.argv[1:]:
    signal.alarm(2)  # an endless loop inside the HDF5 library ends the process like a crash
    print("file", end=" ", flush=True)
    try:
        {read}
        print("read", flush=True)
    except LbacalError as error:
        is_sentence = "\\n" not in str(error) and len(str(error)) < 400
        print("sentence" if is_sentence else f"not a sentence: {{error!r}}", flush=True)
    except BaseException as error:
        print(f"escaped: {{error!r}}", flush=True)
"""


@pytest.fixture
def flip_bytes(tmp_path: Path) -> Callable[..., list[str]]:
    """Read copies of a file with a few bytes changed, in child processes: what came of each.

    An outcome is `read`, `sentence` (one line that refuses the file), `died` (the HDF5 library crashed or never
    returned, which only another process can contain), or a description of what must not happen.
    """

    def outcomes(content: bytes, count: int, imports: str, read: str, structure: slice = slice(None)) -> list[str]:
        original = np.frombuffer(content, dtype=np.uint8)
        rng = np.random.default_rng(20)
        # Most of a small file is unused space; bytes that are not zero are its structure and its numbers.
        used = np.flatnonzero(original)[structure]
        names = [str(tmp_path / f"flipped{k:04d}.h5") for k in range(count)]
        for name in names:
            mutant = original.copy()
            at = rng.choice(used, size=int(rng.integers(1, 6)))
            mutant[at] = rng.integers(0, 256, size=at.size)
            Path(name).write_bytes(mutant.tobytes())
        script = FLIP_CHILD.format(imports=imports, read=read)
        found: list[str] = []
        while names:
            child = subprocess.run([sys.executable, "-c", script, *names], capture_output=True, text=True, check=False)
            lines = [line.partition(" ")[2] or "died" for line in child.stdout.splitlines()]
            assert lines, child.stderr
            found += lines
            names = names[len(lines) :]
        return found

    return outcomes


@pytest.fixture
def calibrations() -> dict[str, Any]:
    """Curves of two antennas of a station as `effective` answers, with covariance and budget that agree with them."""
    frequency = np.arange(30.0, 81.0)
    shape = {letter: np.stack([np.full(51, level), 0.02 * np.linspace(-1, 1, 51)])
             for letter, level in (("X", 0.06), ("Y", 0.05))}  # fmt: skip
    budget = Budget(frequency, (BudgetTerm("sky", "drawn", shape),))
    curves = []
    for antenna in (4, 17):
        for letter in "XY":
            c = 1e-5 * (1.0 + frequency / 30.0 + 0.01 * antenna)
            own, factor = np.full((1, 51), 0.01), np.full((1, 51), 0.004)
            flag = ["interference" if k == 12 else "outside" if k == 50 else "ok" for k in range(51)]
            c[50] = np.nan
            gain = np.full(51, 4.0)
            curve = CalibrationCurve(
                "CS002", antenna, letter, "converged", 900, frequency, c, c * np.hypot(0.004, 0.003),
                c * np.sqrt(np.sum(np.round(shape[letter], 6) ** 2, axis=0) + 1e-4), 1.0, 1.0, {}, flag, gain,
                covariance=CurveCovariance(factor, np.full(51, 9e-6), budget.digest, own),
            )  # fmt: skip
            curves.append(curve.as_dict() | {
                "flag_reason": None, "factor": [1.0] * 51, "calibration": "ab" * 32, "answered_by": "antenna",
                "valid": {"from": "2014-01-01T00:00:00Z", "to": "2015-01-01T00:00:00Z"},
            })  # fmt: skip
    return {"at": "2014-05-01T00:00:00Z", "as_of": "2026-01-01T00:00:00Z", "curves": curves,
            "budgets": {budget.digest: budget.as_dict()}}  # fmt: skip
