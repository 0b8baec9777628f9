"""Faults are planted in the code one by one, and the tests have to see them, most of them the tests of `./dev test`.

A fault is a line of `planted_faults.toml`: a function, and what changes in it. One run of the first tier over a copy of
the tree meets every test with the faults of what it calls (`planted_run`). Whatever survives, and what changes a
constant and no function, is written into a copy and meets the tests near it and then the tier. Faults that nothing sees
show where a test is missing.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType

from validation.code_changes import Change, StaleChangeError, changed
from validation.machinery.claims import Found, exactly
from validation.machinery.parts import Part, Row
from validation.planted_run import LOG, function_of

ROOT = Path(__file__).parents[1]
FAULTS = Path(__file__).with_suffix(".toml")
FIRST_TIER, SECOND_TIER, UNSEEN = "first tier", "second tier", "unseen"
TIERS = {FIRST_TIER: "not long", SECOND_TIER: "long"}
"""Markers of the tests of each tier (`./dev test`, and what `./dev test --all` runs beside them)."""
NEAR_S, TIER_S = 1800.0, 3600.0
"""What hangs longer counts as not seen; most faults are seen within 30 s of one core."""
FAILED, BROKEN, NONE_CHOSEN = 1, 2, 5
"""Exit codes of pytest where a test fails, where tests cannot even be imported, and where none has the marker."""


@dataclass(frozen=True)
class PlantedFault:
    """One small change of the code.

    Attributes
    ----------
    where
        Module and function, `lbacal_core.causes.cable:log_loss_per_metre`.
    change
        What is there and what takes its place, as `code_changes` says.
    blind
        Whether its author had not seen the tests.
    """

    where: str
    change: tuple[str, ...]
    blind: bool = False

    @property
    def name(self) -> str:
        """The place and the change."""
        return f"{self.where}: {', '.join(self.change)}"

    @property
    def is_function(self) -> bool:
        """Whether it changes the code of a function."""
        return function_of(self.where) is not None

    @property
    def file(self) -> str:
        """Path from the root of the tree."""
        return f"{self.where.partition(':')[0].replace('.', '/')}.py"

    def planted(self, text: str) -> str:
        """The text of its file with the fault."""
        try:
            return changed(text, self.where.partition(":")[2], [Change.read(one) for one in self.change])
        except StaleChangeError as error:
            raise StaleChangeError(f"{self.where} {error}; write the fault of {FAULTS.name} anew") from error

    def tests(self, root: Path) -> list[str]:
        """Files of tests of its own file and of its room, the nearest first."""
        path = Path(self.file)
        place = root / "tests" / path.parent
        files = [place / f"test_{path.name}", *sorted(place.rglob("test_*.py"))]
        return list(dict.fromkeys(str(file.relative_to(root)) for file in files if file.is_file()))


def read_faults(path: Path = FAULTS) -> list[PlantedFault]:
    """Every fault of the list."""
    return [PlantedFault(**one | {"change": tuple(one["change"])}) for one in tomllib.loads(path.read_text())["faults"]]


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


def list_planted(root: Path) -> list[tuple[str, str, str, str]]:
    """Every fault as its name and place, and the text of its module without and with it."""
    texts = ((fault, (root / fault.file).read_text()) for fault in read_faults() if (root / fault.file).is_file())
    return [(fault.name, fault.where, text, fault.planted(text)) for fault, text in texts]


def seen_in_one_run(tree: Path) -> dict[str, str]:
    """The first test of the first tier that sees a fault, by its name.

    One run for a state of the tree; processes that ask meanwhile wait for it.
    """
    log = ROOT / "var" / "planted" / f"{_git(tree, 'rev-parse', 'HEAD^{tree}').strip()[:12]}.jsonl"
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not log.exists():
            noted = log.with_suffix(".running")
            noted.write_text("")
            plugin = ["-p", "validation.planted_run", "-n", "2", "--dist", "loadfile", "--maxfail", "1000"]
            code, test = run_tests(tree, plugin, TIER_S, TIERS[FIRST_TIER], {LOG: str(noted)})
            if code:
                raise RuntimeError(f"without a fault pytest ends with {code}: {test}")
            noted.rename(log)
    return dict(reversed([json.loads(line) for line in log.read_text().splitlines()]))


def run_tests(
    tree: Path, tests: Sequence[str], limit_s: float, marker: str = "", more: Mapping[str, str] = MappingProxyType({})
) -> tuple[int | None, str]:
    """Exit code of pytest on some tests of a tree, None where they last too long, and the first test that failed."""
    own = {"PYTHONPATH": str(tree), "OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    environment = {**os.environ, **own, **more}
    options = ["-q", "-x", "-p", "no:cacheprovider", "--no-header", "-m", marker]
    command = [sys.executable, "-m", "pytest", *options, *tests]
    try:
        done = subprocess.run(
            command, cwd=tree, env=environment, capture_output=True, text=True, timeout=limit_s, check=False
        )
    except subprocess.TimeoutExpired:
        return None, ""
    told = [line for line in done.stdout.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    failed = [line.partition(" ")[2].partition(" - ")[0] for line in told]
    return done.returncode, failed[0] if failed else ""


def find_seen(tree: Path, fault: PlantedFault, first_run: Callable[[], dict[str, str]]) -> tuple[str, str]:
    """The tier that sees a fault of a tree, and the first test that does; the tree is as before afterwards.

    `first_run` gives what the one run of the first tier has seen.
    """
    for tier, marker in TIERS.items():
        is_in_run = fault.is_function and tier == FIRST_TIER
        if test := first_run().get(fault.name, "") if is_in_run else _find_failing(tree, fault, marker):
            return tier, test
    return UNSEEN, ""


def _find_failing(tree: Path, fault: PlantedFault, marker: str) -> str:
    """A test that fails with a fault written into the tree: of those near it, then of the whole tier."""
    place = tree / fault.file
    healthy = place.read_text()
    try:
        place.write_text(fault.planted(healthy))
        for tests, limit_s in ((fault.tests(tree), NEAR_S), ((), TIER_S)):
            code, test = run_tests(tree, tests, limit_s, marker)
            if code not in (0, FAILED, BROKEN, NONE_CHOSEN, None):
                raise RuntimeError(f"pytest ends with {code}: {' '.join(tests)}")
            # A test that fails by chance on a busy machine sees nothing: it has to fail again by itself.
            if code in (FAILED, BROKEN) and run_tests(tree, [test] if test else tests, NEAR_S)[0] == code:
                return test or fault.file
    finally:
        place.write_text(healthy)
    return ""


def plant(number: int) -> Row:
    """Plant one fault of the list in a copy of the tree: who sees it, and which test first."""
    fault = read_faults()[number]
    with copy_of_tree() as tree:
        by, test = find_seen(tree, fault, partial(seen_in_one_run, tree))
    return {"name": fault.name, "blind": fault.blind, "by": by, "test": test}


def judge(rows: Sequence[Row]) -> list[Found]:
    """The share that tests see, of all faults and of those whose author did not know the tests; of these the tier's."""
    seen = [row for row in rows if row["by"] != UNSEEN]
    blind = [row for row in rows if row["blind"]]
    return [
        _share("seen", seen, rows),
        _share("seen_blind", [row for row in blind if row in seen], blind),
        _share("first_tier", [row for row in seen if row["by"] == FIRST_TIER], seen),
    ]


def _share(key: str, some: Sequence[Row], of: Sequence[Row]) -> Found:
    return exactly(key, len(some) / max(len(of), 1), "%", len(of))


def tell(rows: Sequence[Row]) -> list[str]:
    """How many each tier sees, and every fault that the first does not."""
    counts = Counter(row["by"] for row in rows)
    lines = [f"- {', '.join(f'{counts[by]} {by}' for by in (*TIERS, UNSEEN))} of {len(rows)}"]
    return lines + [f"- {row['by']}: `{row['name']}` {row['test']}" for row in rows if row["by"] != FIRST_TIER]


PARTS = (Part("faults", plant, judge, len(read_faults()), tell, ("seen",), has_chance=False),)
