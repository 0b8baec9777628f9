from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from validation import planted_faults
from validation.code_changes import Change, StaleChangeError, changed
from validation.machinery.records import claims_of
from validation.planted_faults import (
    FIRST_TIER,
    SECOND_TIER,
    UNSEEN,
    PlantedFault,
    find_seen,
    read_faults,
    run_tests,
    tell,
)
from validation.planted_run import PlantedRun, function_of

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


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A small tree with a room and a test that looks at half of it."""
    monkeypatch.setattr(planted_faults, "TIERS", {FIRST_TIER: "not slow", SECOND_TIER: "slow"})
    (tmp_path / "pyproject.toml").write_text("[tool.pytest.ini_options]\nmarkers = ['slow']\n")
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
    assert run_tests(tree, ["tests/room"], 60) == (0, "")


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
