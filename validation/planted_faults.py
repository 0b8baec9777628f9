"""Faults are planted in the code one by one, and the tests have to see them.

A fault is three lines of `planted_faults.toml`: a file, what stands there, and what takes its place. Each is applied to
a copy of the tree, never to the tree itself, and meets the tests of its own file, of its room and of discovery, until
the first of them fails. Whatever survives these meets the whole suite. Faults that nothing sees are either explained in
the file, or show where a test is missing.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from validation.machinery.claims import Found, exactly
from validation.machinery.parts import Part, Row

ROOT = Path(__file__).parents[1]
FAULTS = Path(__file__).with_suffix(".toml")
AUTHORS = ("with the tests", "blind")
SEEN_BY_ROOM, SEEN_BY_SUITE, EXPLAINED, UNSEEN = "room", "suite", "explained", "unseen"
ROOM_S, SUITE_S = 1800.0, 3600.0
"""What hangs longer counts as not seen; most faults are seen within 30 s of one core."""
MEET_ALL = (
    "discovery/test_refit.py",
    "discovery/test_report.py",
    "discovery/test_scan.py",
    "discovery/test_residual_structure.py",
    "causes",
    "discovery",
)
"""Tests of the science that every fault meets after those of its own file and room, the broadest claims first."""
FAILED, BROKEN = 1, 2
"""Exit codes of pytest where a test fails, and where tests cannot even be imported: a fault is seen either way."""


class StaleFaultError(Exception):
    """A fault that does not fit the code any more."""


@dataclass(frozen=True)
class PlantedFault:
    """One small change of the code.

    Attributes
    ----------
    file
        Path from the root of the tree.
    before, after
        What stands there exactly once, and what takes its place.
    written_by
        One of `AUTHORS`: whether its author knew the tests.
    explained
        Why it is no defect that no test sees it; empty for all others.
    """

    file: str
    before: str
    after: str
    written_by: str
    explained: str = ""

    @property
    def name(self) -> str:
        """The file and the first line that changes."""
        lines = [line.strip() for line in self.after.strip().splitlines()]
        old = {line.strip() for line in self.before.splitlines()}
        return f"{self.file}: {next((line for line in lines if line not in old), lines[0])}"

    def planted(self, text: str) -> str:
        """The text of its file with the fault."""
        count = text.count(self.before)
        if count != 1:
            raise StaleFaultError(
                f"{self.file}: expected once, found {count} times: {self.before.strip()!r}; write the fault of "
                f"{FAULTS.name} anew for the code as it is"
            )
        if self.before == self.after:
            raise StaleFaultError(f"{self.file}: changes nothing: {self.before.strip()}")
        changed = text.replace(self.before, self.after)
        compile(changed, self.file, "exec")
        return changed

    def tests(self, root: Path) -> list[str]:
        """Files of tests: of its own file, of its room, of discovery; those nearest first."""
        path = Path(self.file)
        places = [path.with_name(f"test_{path.name}"), path.parent, *(Path("lbacal_core") / one for one in MEET_ALL)]
        # Files, not folders: where arguments overlap pytest puts them into its own order.
        files = [file for place in places for file in _test_files(root / "tests" / place)]
        return list(dict.fromkeys(str(file.relative_to(root)) for file in files))


def _test_files(place: Path) -> list[Path]:
    return [place] if place.is_file() else sorted(place.rglob("test_*.py"))


def read_faults(path: Path = FAULTS) -> list[PlantedFault]:
    """Every fault of the list."""
    return [PlantedFault(**entry) for entry in tomllib.loads(path.read_text())["fault"]]


@contextmanager
def copy_of_tree(root: Path = ROOT) -> Iterator[Path]:
    """A copy of all files under version control, as they are now; gone afterwards."""
    listed = _git(root, "ls-files", "-z")
    with tempfile.TemporaryDirectory(prefix="planted-") as folder:
        copy = Path(folder) / "tree"
        for name in listed.split("\0"):
            if name and (root / name).is_file():
                (copy / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(root / name, copy / name)
        _git(copy, "init", "-q")
        _git(copy, "add", "-A")
        _git(copy, "-c", "user.name=copy", "-c", "user.email=copy@localhost", "commit", "-qm", "copy")
        if (root / ".venv").is_dir():
            (copy / ".venv").symlink_to(root / ".venv")  # whose programs read the code of the copy: PYTHONPATH
        yield copy


def _git(folder: Path, *arguments: str) -> str:
    command = ["git", "-C", str(folder), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def run_tests(tree: Path, tests: Sequence[str], limit_s: float) -> tuple[int | None, str]:
    """Exit code of pytest on some tests of a tree, None where they last too long, and the first test that failed."""
    environment = os.environ | {"PYTHONPATH": str(tree), "OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "--no-header", *tests]
    try:
        done = subprocess.run(
            command, cwd=tree, env=environment, capture_output=True, text=True, timeout=limit_s, check=False
        )
    except subprocess.TimeoutExpired:
        return None, ""
    failed = [line.split(" ")[1] for line in done.stdout.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    return done.returncode, failed[0] if failed else ""


def is_seen(tree: Path, fault: PlantedFault, tests: Sequence[str], limit_s: float) -> tuple[bool, str]:
    """Whether some tests of a tree fail with the fault planted; the tree is as before afterwards."""
    place = tree / fault.file
    healthy = place.read_text()
    place.write_text(fault.planted(healthy))
    try:
        code, test = run_tests(tree, tests, limit_s)
    finally:
        place.write_text(healthy)
    if code not in (0, FAILED, BROKEN, None):
        raise RuntimeError(f"pytest ends with {code}: {' '.join(tests)}")
    return code in (FAILED, BROKEN), test


def plant(number: int) -> Row:
    """Plant one fault of the list in a copy of the tree: who sees it, and which test first."""
    fault = read_faults()[number]
    with copy_of_tree() as tree:
        seen, test = is_seen(tree, fault, fault.tests(tree), ROOM_S)
        by = SEEN_BY_ROOM if seen else ""
        if not seen:
            seen, test = is_seen(tree, fault, [], SUITE_S)
            by = SEEN_BY_SUITE if seen else EXPLAINED if fault.explained else UNSEEN
    return {"name": fault.name, "written_by": fault.written_by, "by": by, "test": test}


def rooms_of(faults: Sequence[PlantedFault], tree: Path = ROOT) -> list[str]:
    """Folders of tests that meet faults."""
    return sorted({str(Path(test).parent) for fault in faults for test in fault.tests(tree)})


def pass_without(number: int) -> Row:
    """Run the tests of one room without a fault: if they failed, they would see every fault."""
    with copy_of_tree() as tree:
        room = rooms_of(read_faults(), tree)[number]
        code, test = run_tests(tree, [room], SUITE_S)
    return {"room": room, "passes": code == 0, "test": test}


def judge_healthy(rows: Sequence[Row]) -> list[Found]:
    """All rooms pass."""
    return [exactly("healthy", sum(row["passes"] for row in rows) / len(rows), "%", len(rows))]


def judge(rows: Sequence[Row]) -> list[Found]:
    """The share that tests see, of all faults and of those whose author did not know the tests."""
    claims = []
    for key, authors in (("seen", AUTHORS), ("seen_blind", AUTHORS[1:])):
        own = [row for row in rows if row["written_by"] in authors]
        if own:
            claims.append(exactly(key, share_seen(own), "%", len(own)))
    return claims


def tell(rows: Sequence[Row]) -> list[str]:
    """What was seen, by whom, and every fault that nothing saw."""
    lines = []
    for author in AUTHORS:
        own = [row["by"] for row in rows if row["written_by"] == author]
        if own:
            lines.append(
                f"- Written {author}: {len(own)} faults, {own.count(SEEN_BY_ROOM)} seen by the tests of their room and "
                f"of discovery, {own.count(SEEN_BY_SUITE)} more by the whole suite, {own.count(EXPLAINED)} explained, "
                f"{own.count(UNSEEN)} not seen."
            )
    return lines + [f"- Not seen: `{row['name']}`" for row in rows if row["by"] == UNSEEN]


def share_seen(rows: Sequence[Row]) -> float:
    """Share of the faults that the tests see, those left out that are explained."""
    counted = [row["by"] for row in rows if row["by"] != EXPLAINED]
    return sum(by in (SEEN_BY_ROOM, SEEN_BY_SUITE) for by in counted) / max(len(counted), 1)


PARTS = (
    Part("healthy", pass_without, judge_healthy, len(rooms_of(read_faults())), has_chance=False),
    Part("faults", plant, judge, len(read_faults()), tell, ("seen",), has_chance=False),
)
