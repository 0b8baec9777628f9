from __future__ import annotations

from pathlib import Path

import pytest

from validation import planted_faults
from validation.callers import find_callers
from validation.code_changes import Change, StaleChangeError, changed
from validation.machinery.records import claims_of
from validation.planted_faults import (
    FIRST_TIER,
    MEET_ALL,
    SECOND_TIER,
    UNSEEN,
    PlantedFault,
    find_seen,
    read_faults,
    rooms_of,
    run_tests,
    tell,
)

FAULTS = read_faults()
CODE = "def double(x):\n    return 2 * x  # twice\n\n\ndef half(x):\n    return x / 2 if x else 0\n"
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
    return tmp_path


def test_a_fault_is_seen_where_a_test_fails_and_the_tree_is_as_before(tree: Path) -> None:
    fault = PlantedFault("room.sums:double", ("2 -> 3",))
    assert fault.tests(tree) == ["tests/room/test_sums.py"]
    assert find_seen(tree, fault) == (FIRST_TIER, DOUBLED)
    assert (tree / "room/sums.py").read_text() == CODE
    assert rooms_of([fault], tree) == ["tests/room"]
    assert run_tests(tree, ["tests/room"], 60) == (0, "")


def test_a_fault_that_only_the_second_tier_looks_at_is_its_and_one_that_nobody_looks_at_is_unseen(tree: Path) -> None:
    test = tree / "tests/room/test_sums.py"
    test.write_text(f"import pytest\n{TEST}".replace("@mark", "@pytest.mark.slow\n@mark"))
    assert find_seen(tree, PlantedFault("room.sums:double", ("2 -> 3",)))[0] == SECOND_TIER
    assert find_seen(tree, PlantedFault("room.sums:half", ("2 -> 3",))) == (UNSEEN, "")


def test_the_tests_that_call_a_function_are_found_once_and_meet_its_fault_first(tree: Path) -> None:
    test = tree / "tests/room/test_sums.py"
    test.write_text(f"{TEST}\n\ndef test_nothing():\n    pass\n")
    runs, log = [], tree / "var/callers.json"
    places = [(tree / "room/sums.py", name, f"room.sums:{name}") for name in ("double", "half")]
    for _ in range(2):
        callers = find_callers(places, lambda: runs.append(run_tests(tree, [], 60)), log)
    assert callers == {"room.sums:double": [DOUBLED], "room.sums:half": []}
    assert runs == [(0, "")]
    (tree / "room/sums.py").write_text(CODE)
    fault = PlantedFault("room.sums:double", ("2 -> 3",))
    assert fault.tests(tree, callers[fault.where]) == callers[fault.where]
    assert find_seen(tree, fault, lambda _marker: callers)[0] == FIRST_TIER


def test_the_tests_nearest_to_a_fault_come_first(repository: Path) -> None:
    tests = PlantedFault("lbacal_core.discovery.scan:scan", ()).tests(repository)
    assert tests[0] == "tests/lbacal_core/discovery/test_scan.py"
    assert len(set(tests)) == len(tests) > 15
    assert all((repository / test).is_file() for test in tests)
    gate = PlantedFault("service.usecases.gate:Gate", ()).tests(repository)
    assert gate[0] == "tests/service/usecases/test_gate.py"
    assert all((repository / "tests/lbacal_core" / place).exists() for place in MEET_ALL)
    assert f"tests/lbacal_core/{MEET_ALL[0]}" in gate


def test_tests_that_fail_without_a_fault_refute_the_proof() -> None:
    rows = [{"room": "a", "passes": True, "test": ""}, {"room": "b", "passes": False, "test": "b::test"}]
    assert [claim.verdict for claim in claims_of("planted_faults", "healthy", rows)] == ["refuted"]
    assert [claim.verdict for claim in claims_of("planted_faults", "healthy", rows[:1])] == ["shown"]


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
