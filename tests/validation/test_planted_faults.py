from __future__ import annotations

import ast
import importlib
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from validation import planted_faults, planted_run
from validation.code_changes import Change, StaleChangeError, changed, mutations
from validation.machinery.records import claims_of
from validation.planted_faults import (
    FIRST_TIER,
    PRODUCT,
    SECOND_TIER,
    UNSEEN,
    PlantedFault,
    _is_required,
    draw_fault,
    find_seen,
    read_faults,
    run_tests,
    seen_in_groups,
    tell,
)
from validation.planted_run import PlantedRun, code_in, function_of

pytest_plugins = ["pytester"]

FAULTS = read_faults()
CODE = "FACTOR = 2\n\n\ndef double(x):\n    return 2 * x  # twice\n\n\ndef half(x):\n    return x / 2 if x else 0\n"
TEST = """from pytest import mark
from room.sums import double


@mark.parametrize("kind", ["a name of two words"])
def test_two_is_doubled(kind):
    assert double(2) == 4
"""
DOUBLED = "tests/room/test_sums.py::test_two_is_doubled[a name of two words]"


def test_every_fault_fits_the_code_and_none_is_listed_twice(repository: Path) -> None:
    planted = [fault.file + fault.planted((repository / fault.file).read_text()) for fault in FAULTS]
    assert len(set(planted)) == len(FAULTS)


@pytest.mark.parametrize(
    ("function", "change", "line"),
    [
        ("double", "* -> +", "return (2 + x)  # twice"),
        ("double", "2 -> 3", "return (3) * x  # twice"),
        ("double", "* ... -> right", "return (x)  # twice"),
        ("half", "if -> yes", "return (x / 2)"),
        ("half", "x #3 -> -it", None),
        ("half", "x #2 -> -it", "return (-x) / 2 if x else 0"),
        ("half", "< -> >", None),
        ("half", "2 -> 2", None),
        ("third", "2 -> 3", None),
    ],
)
def test_a_change_is_made_once_where_it_is_told_and_all_else_stays(
    function: str, change: str, line: str | None
) -> None:
    if line is None:
        with pytest.raises(StaleChangeError):
            changed(CODE, function, [Change.read(change)])
        return
    other = CODE.replace("return 2 * x  # twice" if function == "double" else "return x / 2 if x else 0", line)
    assert changed(CODE, function, [Change.read(change)]) == other


MUTATED = """def total(first, some: list[1], kind=1):
    '''Docs: 3.'''
    self.kind = first < 0.5 or kind == 1
    while some:
        first += some.pop(index=0)
    if not first:
        raise ValueError(2)
    return sorted(one for one in some if one)
"""


def test_every_mutation_of_a_function_is_found_without_its_head() -> None:
    found = [
        (operator, ast.unparse(node).partition("\n")[0], text)
        for operator, node, text in mutations(ast.parse(MUTATED).body[0])
    ]
    assert found == [
        ("statement dropped", "self.kind = first < 0.5 or kind == 1", "pass"),
        ("opposite operator", "first < 0.5 or kind == 1", "(first < 0.5 and kind == 1)"),
        ("opposite operator", "first < 0.5", "(first > 0.5)"),
        ("float x 1.1", "0.5", "0.55"),
        ("opposite operator", "kind == 1", "(kind != 1)"),
        ("integer + 1", "1", "2"),
        ("condition negated", "some", "(not some)"),
        ("opposite operator", "first += some.pop(index=0)", "first -= some.pop(index=0)"),
        ("keyword dropped", "some.pop(index=0)", "some.pop()"),
        ("integer + 1", "0", "1"),
        ("condition negated", "not first", "(not not first)"),
        ("statement dropped", "raise ValueError(2)", "pass"),
        ("integer + 1", "2", "3"),
        ("first argument returned", "sorted((one for one in some if one))", "first"),
        ("order reversed", "sorted((one for one in some if one))", "sorted((one for one in some if one))[::-1]"),
        ("condition negated", "one", "(not one)"),
    ]
    for operator in {one for one, *_ in found}:
        changed(MUTATED, "total", [Change(operator, "", 1)])
    silent = ast.parse("def f(a):\n    return zip(a, strict=True)").body[0]
    assert [operator for operator, *_ in mutations(silent)] == ["first argument returned"]
    assert list(mutations(ast.parse("def f(a):\n    return a").body[0])) == [], "it is returned as it stands"
    with pytest.raises(StaleChangeError, match="has 2 times: statement dropped"):
        changed(MUTATED, "total", [Change("statement dropped", "", 4)])


def test_a_seed_draws_the_same_fault_again_and_many_draw_from_every_package(repository: Path) -> None:
    drawn = [draw_fault(seed, repository) for seed in range(12)]
    assert draw_fault(7, repository) == drawn[7]
    assert {fault.where.partition(".")[0] for fault in drawn} == set(PRODUCT)
    for fault in drawn:
        fault.planted((repository / fault.file).read_text())  # refuses what changes nothing


def test_a_keyword_is_dropped_only_where_it_has_a_default(tmp_path: Path) -> None:
    (tmp_path / "sums.py").write_text(
        "def add(a, b, c=1, *, d, e=2): ...\nclass Sum:\n    left: int\n    right: int = 0\n"
    )
    calls = {"add(a=1)": True, "add(c=1)": False, "add(d=1)": True, "add(e=1)": False, "sums.Sum(left=1)": True}
    calls |= {"Sum(right=1)": False, "numpy.add(a=1)": True, "numpy.sum(a=1)": False}
    asked = {text: ast.parse(text, mode="eval").body for text in calls}
    found = {
        text: _is_required(call, (tmp_path / "sums.py",)) for text, call in asked.items() if isinstance(call, ast.Call)
    }
    assert found == calls


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A small tree with a room and a test that looks at half of it."""
    monkeypatch.setattr(planted_faults, "TIERS", {FIRST_TIER: "not slow", SECOND_TIER: "slow"})
    settings = "[tool.pytest.ini_options]\nmarkers = ['slow']\naddopts = '--import-mode=importlib'\n"
    (tmp_path / "pyproject.toml").write_text(settings)
    (tmp_path / "room").mkdir()
    (tmp_path / "room/__init__.py").touch()
    (tmp_path / "room/sums.py").write_text(CODE)
    (tmp_path / "tests/room").mkdir(parents=True)
    (tmp_path / "tests/room/test_sums.py").write_text(TEST)
    monkeypatch.syspath_prepend(tmp_path)
    for name in ("room", "room.sums"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return tmp_path


def test_a_test_runs_again_with_the_faults_of_what_it_calls(pytester: pytest.Pytester, tree: Path) -> None:
    log, path = tree / "log", pytester.makepyfile(TEST)
    log.touch()
    changes = {"doubled": ("double", "2 -> 3"), "halved": ("half", "2 -> 3"), "same": ("double", "* -> +")}
    faults = [
        (name, f"room.sums:{place}", CODE, changed(CODE, place, [Change.read(change)]))
        for name, (place, change) in changes.items()
    ]
    pytester.inline_run("-p", "no:cacheprovider", plugins=[PlantedRun(faults, log)]).assertoutcome(passed=1)
    seen = [json.loads(line) for line in log.read_text().splitlines()]
    assert seen == [["doubled", f"{path.name}::{DOUBLED.partition('::')[2]}"]], "2 + 2 is 4, and half is not called"
    assert function_of("room.sums:FACTOR") is None
    double = function_of("room.sums:double")
    assert double is not None
    assert double(4) == 8


def test_a_method_whose_call_of_super_is_taken_out_runs_without_it(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    head = "class Kept(dict):\n    def __init__(self, x):\n"
    (tree / "room/kept.py").write_text(f"{head}        super().__init__(x)\n")
    monkeypatch.delitem(sys.modules, "room.kept", raising=False)
    function = function_of("room.kept:Kept.__init__")
    assert function is not None
    function.__code__ = code_in(f"{head}        self.only = x\n", function)
    made = importlib.import_module("room.kept").Kept({1: 2})
    assert (made, made.only) == ({}, {1: 2})


def test_a_fault_that_does_not_end_is_seen(
    pytester: pytest.Pytester, tree: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(planted_run, "LOOP_S", 0.2)
    code = "def double(x):\n    while x < 0:\n        pass\n    return 2 * x\n"
    (tree / "room/sums.py").write_text(code)
    (tree / "log").touch()
    pytester.makepyfile(TEST)
    fault = ("endless", "room.sums:double", code, changed(code, "double", [Change.read("opposite operator #1")]))
    pytester.inline_run("-p", "no:cacheprovider", plugins=[PlantedRun([fault], tree / "log")]).assertoutcome(passed=1)
    assert json.loads((tree / "log").read_text())[0] == "endless"


def test_faults_of_disjoint_rooms_meet_the_second_tier_together(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("hall", "tests/hall"):
        shutil.copytree(tree / name.replace("hall", "room"), tree / name)
    for command in (["init", "-q"], ["add", "-A"], ["-c", "user.name=a", "-c", "user.email=a@b", "commit", "-qm", "a"]):
        subprocess.run(["git", *command], check=True, cwd=tree)
    slow = TEST.replace("@mark", "@mark.slow\n@mark")
    (tree / "tests/room/test_sums.py").write_text(slow)
    (tree / "tests/hall/test_sums.py").write_text(
        slow.replace("room", "hall").replace("double", "half").replace("4", "1")
    )
    runs: list[int] = []
    monkeypatch.setattr(planted_faults, "ROOT", tree)
    monkeypatch.setattr(planted_faults, "TOGETHER", ("-p", "no:xdist", "--maxfail", "9"))
    whole = planted_faults.written
    monkeypatch.setattr(planted_faults, "written", lambda tree, some: runs.append(len(some)) or whole(tree, some))
    faults = [
        PlantedFault(f"{room}.sums:{one}", (change,))
        for room, one, change in (
            ("room", "double", "opposite operator #1"),
            ("room", "half", "integer + 1 #1"),
            ("hall", "half", "integer + 1 #1"),
        )
    ]
    found = seen_in_groups(tree, faults, "0")
    assert {name.partition(": ")[0]: test for name, test in found.items()} == {
        "room.sums:double": DOUBLED,
        "hall.sums:half": "tests/hall/test_sums.py::test_two_is_halfd[a name of two words]",
    }
    assert runs == [2, 1, 1, 1, 1]
    assert seen_in_groups(tree, [], "0") == found, "the run is made once"


def test_what_changes_nothing_is_left_out_of_what_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planted_faults, "read_equivalents", lambda: {"lbacal.f: integer + 1 #4": "a limit of nothing"})
    by = [FIRST_TIER] * 2 + [SECOND_TIER, UNSEEN, UNSEEN]
    rows = [{"name": f"lbacal.f: integer + 1 #{k}", "by": one, "test": ""} for k, one in enumerate(by)]
    found = {claim.key: (claim.found, claim.n) for claim in claims_of("planted_faults", "drawn", rows)}
    assert found == {"seen": (3 / 4, 4), "late": (1, 3), "equivalent": (1 / 5, 5)}
    told = planted_faults.tell_drawn(rows)
    assert "- integer + 1: 3 of 4, 30-95 %" in told
    assert told[-1] == "- equivalent: `lbacal.f: integer + 1 #4`: a limit of nothing"


def test_a_fault_of_a_constant_is_written_into_the_tree_which_is_as_before(tree: Path) -> None:
    fault = PlantedFault("room.sums:FACTOR", ("2 -> 3",))
    assert not fault.is_function
    assert fault.tests(tree) == ["tests/room/test_sums.py"]
    assert find_seen(tree, fault, dict) == (UNSEEN, "")
    test = tree / "tests/room/test_sums.py"
    test.write_text(TEST.replace("import double", "import FACTOR, double").replace("(2) == 4", "(FACTOR) == 4"))
    assert find_seen(tree, fault, dict) == (FIRST_TIER, DOUBLED)
    test.write_text(f"import pytest\n{test.read_text()}".replace("@mark", "@pytest.mark.slow\n@mark"))
    assert find_seen(tree, fault, dict)[0] == SECOND_TIER
    assert (tree / "room/sums.py").read_text() == CODE
    assert run_tests(tree, ["tests/room"], 60) == (0, [])


def test_a_fault_of_a_function_that_the_run_of_the_first_tier_does_not_see_meets_the_second(tree: Path) -> None:
    fault = PlantedFault("room.sums:double", ("2 -> 3",))
    assert find_seen(tree, fault, lambda: {fault.name: "a test"}) == (FIRST_TIER, "a test")
    assert find_seen(tree, fault, dict) == (UNSEEN, "")
    (tree / "tests/room/test_sums.py").write_text(f"import pytest\n{TEST}".replace("@mark", "@pytest.mark.slow\n@mark"))
    assert find_seen(tree, fault, dict) == (SECOND_TIER, DOUBLED)


def test_what_the_first_tier_sees_is_counted_among_what_any_test_sees() -> None:
    by = [FIRST_TIER, FIRST_TIER, SECOND_TIER, UNSEEN]
    rows = [{"name": one, "blind": k > 0, "by": one, "test": ""} for k, one in enumerate(by)]
    claims = {claim.key: claim for claim in claims_of("planted_faults", "faults", rows)}
    found = {key: (claim.found, claim.n) for key, claim in claims.items()}
    assert found == {
        "seen": (3 / 4, 4),
        "seen_blind": (pytest.approx(2 / 3), 3),
        "first_tier": (pytest.approx(2 / 3), 3),
    }
    assert "- 2 first tier, 1 second tier, 1 unseen of 4" in tell(rows)
    assert {claim.verdict for claim in claims_of("planted_faults", "faults", rows[:2])} == {"shown"}
