from __future__ import annotations

from pathlib import Path

import pytest

from validation.machinery.records import claims_of
from validation.planted_faults import (
    AUTHORS,
    MEET_ALL,
    PlantedFault,
    StaleFaultError,
    is_seen,
    read_faults,
    rooms_of,
    run_tests,
    tell,
)

FAULTS = read_faults()
CODE = "def double(x):\n    return 2 * x\n\n\ndef half(x):\n    return x / 2\n"
TEST = "from room.sums import double\n\n\ndef test_two_is_doubled():\n    assert double(2) == 4\n"


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_every_fault_fits_the_code_exactly_once_and_can_be_compiled(fault: PlantedFault, repository: Path) -> None:
    changed = fault.planted((repository / fault.file).read_text())
    assert fault.after in changed
    assert fault.written_by in AUTHORS


def test_no_fault_is_listed_twice() -> None:
    assert len({(fault.file, fault.before, fault.after) for fault in FAULTS}) == len(FAULTS)


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A small tree with a room and a test that looks at half of it."""
    (tmp_path / "room").mkdir()
    (tmp_path / "room/__init__.py").touch()
    (tmp_path / "room/sums.py").write_text(CODE)
    (tmp_path / "tests/room").mkdir(parents=True)
    (tmp_path / "tests/room/test_sums.py").write_text(TEST)
    return tmp_path


def fault_of(before: str, after: str) -> PlantedFault:
    return PlantedFault("room/sums.py", before, after, "blind")


def test_a_fault_is_seen_where_a_test_fails_and_the_tree_is_as_before(tree: Path) -> None:
    fault = fault_of("2 * x", "3 * x")
    assert fault.tests(tree) == ["tests/room/test_sums.py"]
    assert is_seen(tree, fault, fault.tests(tree), 60) == (True, "tests/room/test_sums.py::test_two_is_doubled")
    assert (tree / "room/sums.py").read_text() == CODE
    assert rooms_of([fault], tree) == ["tests/room"]
    assert run_tests(tree, ["tests/room"], 60) == (0, "")


def test_a_fault_that_no_test_looks_at_is_not_seen(tree: Path) -> None:
    fault = fault_of("x / 2", "x / 3")
    assert is_seen(tree, fault, fault.tests(tree), 60) == (False, "")


def test_the_tests_nearest_to_a_fault_come_first(repository: Path) -> None:
    fault = PlantedFault("lbacal_core/discovery/scan.py", "", "", "blind")
    tests = fault.tests(repository)
    assert tests[0] == "tests/lbacal_core/discovery/test_scan.py"
    assert len(set(tests)) == len(tests) > 15
    assert all((repository / test).is_file() for test in tests)
    gate = PlantedFault("service/usecases/gate.py", "", "", "blind").tests(repository)
    assert gate[0] == "tests/service/usecases/test_gate.py"
    assert all((repository / "tests/lbacal_core" / place).exists() for place in MEET_ALL)
    assert f"tests/lbacal_core/{MEET_ALL[0]}" in gate


def test_tests_that_fail_without_a_fault_refute_the_proof() -> None:
    rows = [{"room": "a", "passes": True, "test": ""}, {"room": "b", "passes": False, "test": "b::test"}]
    assert [claim.verdict for claim in claims_of("planted_faults", "healthy", rows)] == ["refuted"]
    assert [claim.verdict for claim in claims_of("planted_faults", "healthy", rows[:1])] == ["shown"]


@pytest.mark.parametrize(("before", "after"), [("7 * x", "8 * x"), ("return", "yield"), ("x / 2", "x / 2")])
def test_a_fault_that_does_not_fit_the_code_is_an_error(before: str, after: str) -> None:
    with pytest.raises(StaleFaultError):
        fault_of(before, after).planted(CODE)


def test_what_is_explained_counts_neither_way() -> None:
    rows = [
        {"name": by, "written_by": author, "by": by, "test": ""}
        for author in AUTHORS
        for by in ("room", "suite", "explained", "unseen")
    ]
    both, blind = claims_of("planted_faults", "faults", rows)
    assert (both.key, both.n, both.found, both.verdict) == ("seen", 8, pytest.approx(2 / 3), "refuted")
    assert (blind.key, blind.n, blind.found) == ("seen_blind", 4, pytest.approx(2 / 3))
    assert "4 faults, 1 seen by the tests of their room and of discovery, 1 more" in tell(rows)[0]
    assert "- Not seen: `unseen`" in tell(rows)
    assert claims_of("planted_faults", "faults", [row for row in rows if row["by"] != "unseen"])[0].verdict == "shown"
