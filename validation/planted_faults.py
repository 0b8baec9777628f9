"""Faults are planted in the code one by one, and the tests have to see them, most of them the tests of `./dev test`.

A fault is a line of `planted_faults.toml`, a function and what changes in it, or drawn by a seed. One run of the first
tier over a copy of the tree meets every test with the faults of what it calls (`planted_run`). Whatever survives, and
what changes a constant and no function, is written into a copy and meets the tests near it and then the tier; of drawn
ones several of disjoint rooms are written into it together. Faults that nothing sees show where a test is missing.
"""

from __future__ import annotations

import ast
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
from functools import cache, partial
from pathlib import Path
from types import MappingProxyType

import numpy as np

from validation.code_changes import SEARCHED, Change, StaleChangeError, changed, mutations
from validation.machinery.claims import Found, exactly, rate_interval
from validation.machinery.ledger import DEBUG_BELOW
from validation.machinery.parts import Part, Row
from validation.planted_run import BLOCK, LOG, function_of

ROOT = Path(__file__).parents[1]
FAULTS = Path(__file__).with_suffix(".toml")
FIRST_TIER, SECOND_TIER, UNSEEN = "first tier", "second tier", "unseen"
Runs = Sequence[tuple[Sequence[str], float]]
"""Tests that are run together, and how long they may take, s."""
TIERS = {FIRST_TIER: "not long", SECOND_TIER: "long"}
"""Markers of the tests of each tier (`./dev test`, and what `./dev test --all` runs beside them)."""
PRODUCT = ("lbacal_core", "lbacal", "service")
"""Packages of which drawn faults are."""
DRAWN = 150
"""Seeds in a row whose faults meet the first tier in one run."""
NEAR_S, TIER_S, ALL_S = 1800.0, 3600.0, 10_800.0
"""What hangs longer counts as not seen; most faults are seen within 30 s of one core. A tier may meet 150 of them."""
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


def read_equivalents(path: Path = FAULTS) -> dict[str, str]:
    """Why a drawn fault changes nothing that anybody could see, by its name."""
    return {one["name"]: one["why"] for one in tomllib.loads(path.read_text()).get("equivalents", ())}


def draw_fault(seed: int, root: Path = ROOT) -> PlantedFault:
    """Draw a module of the product, a function of it and a mutation of that, each of all with equal chances."""
    rng = np.random.default_rng(seed)
    modules = sorted(path for name in PRODUCT for path in (root / name).rglob("*.py"))
    while True:
        path = modules[rng.integers(len(modules))]
        functions = {name: sites for name, node in _functions(_parsed(path)) if (sites := [*mutations(node)])}
        if not functions:
            continue
        name = sorted(functions)[rng.integers(len(functions))]
        sites = functions[name]
        k = int(rng.integers(len(sites)))
        operator, node, _ = sites[k]
        nth = sum(one == operator for one, *_ in sites[: k + 1])
        module = ".".join(path.relative_to(root).with_suffix("").parts)
        fault = PlantedFault(f"{module}:{name}", (f"{operator} #{nth}",), blind=True)
        if not (isinstance(node, ast.Call) and _is_required(node, tuple(modules))) and fault.is_function:
            return fault


@cache
def _parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


def _functions(node: ast.Module | ast.ClassDef, above: str = "") -> Iterator[tuple[str, ast.AST]]:
    """The functions of a module and the methods of its classes, by name; none that stands twice."""
    names = Counter(one.name for one in node.body if isinstance(one, SEARCHED))
    for one in node.body:
        if isinstance(one, ast.ClassDef):
            yield from _functions(one, f"{above}{one.name}.")
        elif isinstance(one, SEARCHED) and names[one.name] == 1:
            yield f"{above}{one.name}", one


def _is_required(call: ast.Call, modules: tuple[Path, ...]) -> bool:
    """Whether the last keyword of a call has no default where the product defines what is called."""
    wanted = ast.unparse(call.func).split(".")[-1], call.keywords[-1].arg if call.keywords else None
    return wanted in _required(modules)


@cache
def _required(modules: tuple[Path, ...]) -> set[tuple[str, str]]:
    """What every call must give: functions and their parameters, classes and their fields without a default."""
    found = []
    for node in (one for path in modules for one in ast.walk(_parsed(path))):
        if isinstance(node, ast.FunctionDef):
            of, named = node.args, zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True)
            found += [(node.name, one.arg) for one in of.args[: len(of.args) - len(of.defaults)]]
            found += [(node.name, one.arg) for one, default in named if default is None]
        elif isinstance(node, ast.ClassDef):
            fields = (one for one in node.body if isinstance(one, ast.AnnAssign) and one.value is None)
            found += [(node.name, ast.unparse(one.target)) for one in fields]
    return set(found)


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


def faults_of(block: str, root: Path) -> list[PlantedFault]:
    """The faults of the list, or those drawn by a block of seeds, named by its first."""
    return [draw_fault(int(block) + k, root) for k in range(DRAWN)] if block else read_faults()


def list_planted(root: Path, block: str = "") -> list[tuple[str, str, str, str]]:
    """Every fault as its name and place, and the text of its module without and with it."""
    faults = (fault for fault in faults_of(block, root) if (root / fault.file).is_file())
    texts = ((fault, (root / fault.file).read_text()) for fault in faults)
    return [(fault.name, fault.where, text, fault.planted(text)) for fault, text in texts]


def seen_in_one_run(tree: Path, block: str = "") -> dict[str, str]:
    """The first test of the first tier that sees a fault, by its name.

    One run for a state of the tree and a block of drawn faults; processes that ask meanwhile wait for it. A drawn one
    that it does not see meets the tests near it once more, written into the tree: it may act when a module is imported.
    """

    def run(noted: Path) -> None:
        plugin = ["-p", "validation.planted_run", *TOGETHER]
        code, failed = run_tests(tree, plugin, ALL_S, TIERS[FIRST_TIER], {LOG: str(noted), BLOCK: block})
        if code and not (block and code == FAILED):  # a drawn one may end its process: the others are met below
            raise RuntimeError(f"without a fault pytest ends with {code}: {failed[:1]}")
        for fault in faults_of(block, tree) if block else ():
            if fault.name not in _read(noted):
                _note(noted, fault, _find_failing(tree, fault, TIERS[FIRST_TIER], [(fault.tests(tree), NEAR_S)]))

    return _made_once(tree, f"first{block}", run)


def seen_in_groups(tree: Path, faults: Sequence[PlantedFault], block: str) -> dict[str, str]:
    """The first test of the second tier that sees each of some faults; one of a room is written into the tree at once.

    What then fails meets each fault of the group alone.
    """

    def run(noted: Path) -> None:
        left = list(faults)
        while left:
            group = list({Path(fault.file).parent: fault for fault in left}.values())
            left = [fault for fault in left if fault not in group]
            with written(tree, group):
                code, failed = run_tests(tree, TOGETHER, ALL_S, TIERS[SECOND_TIER])
            for fault in group if code else ():
                runs = [(failed or fault.tests(tree), TIER_S)]
                _note(noted, fault, _find_failing(tree, fault, TIERS[SECOND_TIER], runs))

    return _made_once(tree, f"second{block}", run)


def _made_once(tree: Path, name: str, make: Callable[[Path], None]) -> dict[str, str]:
    """The first test by the name of the fault, as a run writes them into a file, once for a state of the tree."""
    log = ROOT / "var" / "planted" / f"{_git(tree, 'rev-parse', 'HEAD^{tree}').strip()[:12]}-{name}.jsonl"
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not log.exists():
            noted = log.with_suffix(".running")
            noted.write_text("")
            make(noted)
            noted.rename(log)
    return _read(log)


def _read(log: Path) -> dict[str, str]:
    return dict(reversed([json.loads(line) for line in log.read_text().splitlines()]))


def _note(log: Path, fault: PlantedFault, test: str) -> None:
    with log.open("a") as file:
        file.write(f"{json.dumps([fault.name, test])}\n" if test else "")


TOGETHER = ("-n", "2", "--dist", "loadfile", "--maxfail", "1000")
"""Options of pytest for a whole tier of which more than the first failure matters."""


def run_tests(
    tree: Path, tests: Sequence[str], limit_s: float, marker: str = "", more: Mapping[str, str] = MappingProxyType({})
) -> tuple[int | None, list[str]]:
    """Exit code of pytest on some tests of a tree, None where they last too long, and the tests that failed."""
    own = {"PYTHONPATH": str(tree), "OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    environment = {**os.environ, **own, **more}
    options = ["-q", "-x", "-p", "no:cacheprovider", "--no-header", "-m", marker]
    command = [sys.executable, "-m", "pytest", *options, *tests]
    try:
        done = subprocess.run(
            command, cwd=tree, env=environment, capture_output=True, text=True, timeout=limit_s, check=False
        )
    except subprocess.TimeoutExpired:
        return None, []
    told = [line for line in done.stdout.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    failed = [line.partition(" ")[2].partition(" - ")[0] for line in told]
    return done.returncode, failed


def find_seen(tree: Path, fault: PlantedFault, first_run: Callable[[], dict[str, str]]) -> tuple[str, str]:
    """The tier that sees a fault of a tree, and the first test that does; the tree is as before afterwards.

    `first_run` gives what the one run of the first tier has seen.
    """
    near_and_all: Runs = [(fault.tests(tree), NEAR_S), ((), TIER_S)]
    for tier, marker in TIERS.items():
        is_in_run = fault.is_function and tier == FIRST_TIER
        if test := first_run().get(fault.name, "") if is_in_run else _find_failing(tree, fault, marker, near_and_all):
            return tier, test
    return UNSEEN, ""


@contextmanager
def written(tree: Path, faults: Sequence[PlantedFault]) -> Iterator[None]:
    """Write faults of different files into a tree, which is as before afterwards."""
    healthy = {tree / fault.file: (tree / fault.file).read_text() for fault in faults}
    try:
        for fault, (place, text) in zip(faults, healthy.items(), strict=True):
            place.write_text(fault.planted(text))
        yield
    finally:
        for place, text in healthy.items():
            place.write_text(text)


def _find_failing(tree: Path, fault: PlantedFault, marker: str, runs: Runs) -> str:
    """A test that fails with a fault written into the tree, of those of one run after the other."""
    with written(tree, [fault]):
        for tests, limit_s in runs:
            code, failed = run_tests(tree, tests, limit_s, marker)
            if code not in (0, FAILED, BROKEN, NONE_CHOSEN, None):
                raise RuntimeError(f"pytest ends with {code}: {' '.join(tests)}")
            # A test that fails by chance on a busy machine sees nothing: it has to fail again by itself.
            if code in (FAILED, BROKEN) and run_tests(tree, failed[:1] or tests, NEAR_S)[0] == code:
                return failed[0] if failed else fault.file
    return ""


def plant(number: int) -> Row:
    """Plant one fault of the list in a copy of the tree: who sees it, and which test first."""
    fault = read_faults()[number]
    with copy_of_tree() as tree:
        by, test = find_seen(tree, fault, partial(seen_in_one_run, tree))
    return {"name": fault.name, "blind": fault.blind, "by": by, "test": test}


def plant_drawn(seed: int) -> Row:
    """Draw a fault and plant it in a copy of the tree, with those of its block: who sees it, and which test first."""
    block = str(seed - seed % DEBUG_BELOW % DRAWN)
    with copy_of_tree() as tree:
        fault = draw_fault(seed, tree)
        seen = seen_in_one_run(tree, block)
        tests = {FIRST_TIER: seen.get(fault.name)}
        if fault.name not in seen:
            left = {one.name: one for one in faults_of(block, tree) if one.name not in seen}
            tests[SECOND_TIER] = seen_in_groups(tree, list(left.values()), block).get(fault.name)
    by = next((tier for tier, test in tests.items() if test), UNSEEN)
    return {"name": fault.name, "by": by, "test": tests.get(by) or ""}


def judge_drawn(rows: Sequence[Row]) -> list[Found]:
    """The share that tests see of those that change something, how many only the second tier sees, and the others."""
    real = [row for row in rows if row["name"] not in read_equivalents()]
    seen = [row for row in real if row["by"] != UNSEEN]
    late = [row for row in seen if row["by"] != FIRST_TIER]
    return [
        _share("seen", seen, real),
        exactly("late", len(late), n=len(seen)),
        _share("equivalent", [row for row in rows if row not in real], rows),
    ]


def tell_drawn(rows: Sequence[Row]) -> list[str]:
    """How many each tier sees, by package and operator with intervals; and why some cannot be seen."""
    why = read_equivalents()
    real = [row for row in rows if row["name"] not in why]
    groups = {
        row["name"]: (row["name"].partition(".")[0], row["name"].partition(": ")[2].partition(" #")[0]) for row in real
    }
    lines = tell(real)
    for group in sorted({one for both in groups.values() for one in both}):
        some = [row for row in real if group in groups[row["name"]]]
        seen = sum(row["by"] != UNSEEN for row in some)
        low, high = rate_interval(seen, len(some))
        lines.append(f"- {group}: {seen} of {len(some)}, {100 * low:.0f}-{100 * high:.0f} %")
    return lines + [f"- equivalent: `{row['name']}`: {why[row['name']]}" for row in rows if row["name"] in why]


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


PARTS = (
    Part("faults", plant, judge, len(read_faults()), tell, ("seen",), has_chance=False),
    Part("drawn", plant_drawn, judge_drawn, DRAWN, tell_drawn, ("seen",)),
)
