"""What may be recorded, in a git repository of its own."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from validation.machinery import code, records, run
from validation.machinery.claims import at_least, claim_rate
from validation.machinery.parts import Part, Row
from validation.machinery.records import FRESH, REPETITION, read_records
from validation.machinery.run import Order, RefusedError, run_and_record, take_in
from validation.machinery.seeds import DEBUG_BELOW, Block


def _try(seed: int) -> Row:
    return {"is_even": seed % 2 == 0}


def _judge(rows):
    return [claim_rate("even", "Even", at_least(0.4), sum(row["is_even"] for row in rows), len(rows))]


PART = Part("parity", _try, _judge, 6, code=("lbacal_core",))


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository with a file of code, committed."""
    folder = tmp_path / "validation" / "records"
    folder.mkdir(parents=True)
    (tmp_path / "lbacal_core").mkdir()
    (tmp_path / "lbacal_core" / "physics.py").write_text("C = 1\n")
    (tmp_path / ".gitignore").write_text("var/\n")
    for module, name in ((code, "ROOT"), (records, "RECORDS"), (run, "RECORDS")):
        monkeypatch.setattr(module, name, tmp_path if name == "ROOT" else folder)
    monkeypatch.setattr(run, "LOOKED_AT", folder / "looked_at.json")
    monkeypatch.setattr(run, "read_records", lambda: read_records(folder))
    write = records.Record.write
    monkeypatch.setattr(records.Record, "write", lambda record: write(record, folder))
    git(tmp_path, "init", "-q")
    commit(tmp_path)
    return tmp_path


def git(folder: Path, *arguments: str) -> None:
    who = ["-c", "user.name=nobody", "-c", "user.email=nobody@example.org"]
    subprocess.run(["git", "-C", str(folder), *who, *arguments], check=True, capture_output=True)


def commit(folder: Path) -> None:
    git(folder, "add", ".")
    git(folder, "commit", "-q", "-m", "state")


def change_code(folder: Path, value: int) -> None:
    (folder / "lbacal_core" / "physics.py").write_text(f"C = {value}\n")


def test_a_changed_tree_is_not_recorded_and_scratch_runs_on_seeds_for_debugging(checkout: Path):
    change_code(checkout, 2)
    with pytest.raises(RefusedError, match=r"the tree is changed \(lbacal_core/physics\.py\)"):
        run_and_record("some", PART, Order())
    record, is_written = run_and_record("some", PART, Order(is_scratch=True))
    assert not is_written
    assert record.blocks == (Block(0, 6),)
    assert record.claims[0].verdict == "undecided"
    assert read_records(checkout / "validation" / "records") == []


def test_a_file_that_git_does_not_know_is_a_changed_tree(checkout: Path):
    (checkout / "lbacal_core" / "more.py").write_text("D = 1\n")
    with pytest.raises(RefusedError, match="lbacal_core/more"):
        run_and_record("some", PART, Order())


def test_records_of_the_same_code_grow_together_with_fresh_seeds(checkout: Path):
    first, _ = run_and_record("some", PART, Order())
    assert (first.seeds, first.blocks) == (FRESH, (Block(DEBUG_BELOW, 6),))
    second, _ = run_and_record("some", PART, Order(count=4))
    assert second.blocks == (Block(DEBUG_BELOW, 10),)
    assert len(read_records(checkout / "validation" / "records")) == 1
    with pytest.raises(RefusedError, match="in a record of this code already"):
        run_and_record("some", PART, Order(first=DEBUG_BELOW + 3, count=1))


def test_seeds_of_another_commit_are_refused_unless_said_to_be_a_repetition(checkout: Path):
    run_and_record("some", PART, Order())
    change_code(checkout, 2)
    commit(checkout)
    with pytest.raises(RefusedError, match="were used before"):
        run_and_record("some", PART, Order(first=DEBUG_BELOW))
    again, _ = run_and_record("some", PART, Order(first=DEBUG_BELOW, is_repetition=True))
    assert again.seeds == REPETITION
    fresh, _ = run_and_record("some", PART, Order())
    assert (fresh.seeds, fresh.blocks) == (FRESH, (Block(DEBUG_BELOW + 6, 6),))
    assert len(read_records(checkout / "validation" / "records")) == 3


@pytest.mark.usefixtures("checkout")
def test_fresh_seeds_that_were_tried_without_a_record_are_spent():
    run_and_record("some", PART, Order(first=DEBUG_BELOW, count=3, is_scratch=True))
    with pytest.raises(RefusedError, match="tried without a record"):
        run_and_record("some", PART, Order(first=DEBUG_BELOW + 2))
    record, _ = run_and_record("some", PART, Order())
    assert record.blocks == (Block(DEBUG_BELOW + 3, 6),)


@pytest.mark.usefixtures("checkout")
def test_seeds_for_debugging_are_recorded_as_seen_and_decide_nothing():
    record, _ = run_and_record("some", PART, Order(first=0))
    assert record.seeds == "seen before"
    assert record.claims[0].verdict == "undecided"


def test_code_that_changes_while_the_proof_runs_is_not_recorded(checkout: Path):
    def change(seed: int) -> Row:
        change_code(checkout, 3)
        return _try(seed)

    with pytest.raises(RefusedError, match="changed while the proof ran"):
        run_and_record("some", Part("parity", change, _judge, 2, code=("lbacal_core",)), Order())
    assert read_records(checkout / "validation" / "records") == []


def test_records_of_two_machines_become_one(checkout: Path):
    folder = checkout / "validation" / "records"
    one, _ = run_and_record("some", PART, Order(first=DEBUG_BELOW))
    elsewhere = (folder / one.file_name).rename(checkout / "var" / one.file_name)
    run_and_record("some", PART, Order(first=DEBUG_BELOW + 6))
    whole = take_in(records.read_record(elsewhere), PART, elsewhere)
    assert whole.blocks == (Block(DEBUG_BELOW, 12),)
    assert elsewhere.is_file()
    assert len(read_records(folder)) == 1


def test_a_scratch_run_of_a_new_file_does_not_take_up_what_its_earlier_text_gave(checkout: Path):
    """Rows were kept under the digest of files that git knew, so that a proof not yet added resumed from old code."""
    (checkout / "validation" / "new.py").write_text("A = 1\n")
    before = code.digest(_try, ("validation",))
    (checkout / "validation" / "new.py").write_text("A = 2\n")
    changed = code.digest(_try, ("validation",))
    assert changed != before
    commit(checkout)
    assert code.digest(_try, ("validation",)) == changed


def test_what_only_tells_of_results_leaves_records_poolable(checkout: Path):
    before = code.digest(_try, ("validation", "lbacal_core"))
    (checkout / "validation" / "quotes.toml").write_text("")
    assert code.digest(_try, ("validation", "lbacal_core")) == before


def test_what_a_record_itself_writes_does_not_stand_in_the_way_of_the_next(checkout: Path):
    run_and_record("some", PART, Order())
    (checkout / "README.md").write_text("renewed\n")
    assert code.changed_files() == []
