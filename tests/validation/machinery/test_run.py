"""What is entered and recorded, in a git repository of its own."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from validation.machinery import code, records
from validation.machinery.claims import Asked, rate_of
from validation.machinery.ledger import DEBUG_BELOW, LEDGER, Block, read_ledger
from validation.machinery.page import _tell_refuted_before, tell_change, write_page
from validation.machinery.parts import Part, Row
from validation.machinery.records import read_history, read_records, without_result
from validation.machinery.run import Order, RefusedError, run_and_record


def _try(seed: int) -> Row:
    return {"is_even": seed % 2 == 0}


def _judge(rows):
    return [rate_of("even", sum(row["is_even"] for row in rows), len(rows))]


PART = Part("parity", _try, _judge, 6)
ASKED = {"even": Asked("Even", at_least=0.4)}


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository with a file of code, committed."""
    (tmp_path / "validation" / "records").mkdir(parents=True)
    (tmp_path / "lbacal_core").mkdir()
    (tmp_path / ".gitignore").write_text("var/\n")
    monkeypatch.setattr(code, "ROOT", tmp_path)
    monkeypatch.setattr(records, "RECORDS", tmp_path / "validation" / "records")
    monkeypatch.setattr(records, "HISTORY", tmp_path / "validation" / "history.jsonl")
    monkeypatch.setattr(records, "frozen_digest", lambda: "as today")
    monkeypatch.setattr("validation.machinery.run.frozen_digest", lambda: "as today")
    for module in ("run", "records"):
        monkeypatch.setattr(f"validation.machinery.{module}.asked_of", lambda _proof, _part: ASKED)
    git(tmp_path, "init", "-q")
    git(tmp_path, "config", "user.name", "nobody")
    git(tmp_path, "config", "user.email", "nobody@example.org")
    change_code(tmp_path, 1)
    return tmp_path


def git(folder: Path, *arguments: str) -> str:
    command = ["git", "-C", str(folder), *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def change_code(folder: Path, value: int) -> None:
    (folder / "lbacal_core" / "physics.py").write_text(f"C = {value}\n")
    git(folder, "add", ".")
    git(folder, "commit", "-q", "-m", "state")


def test_a_changed_tree_is_not_recorded_and_scratch_runs_on_seeds_for_debugging(checkout: Path):
    (checkout / "lbacal_core" / "more.py").write_text("D = 1\n")
    with pytest.raises(RefusedError, match=r"the tree is changed \(lbacal_core/more\.py\)"):
        run_and_record("some", PART, Order())
    record = run_and_record("some", PART, Order(is_scratch=True))
    assert record.blocks == (Block(0, 6),)
    assert read_records() == read_ledger() == []


def test_a_block_is_entered_and_committed_alone_before_its_first_trial(checkout: Path):
    def look(seed: int) -> Row:
        assert git(checkout, "show", "--name-only", "--format=%s").split("\n")[0].startswith("Entered: some parity")
        assert git(checkout, "show", "--name-only", "--format=").split() == ["docs/validation.md", LEDGER]
        return _try(seed)

    record = run_and_record("some", Part("parity", look, _judge, 6, is_parallel=False), Order())
    (entry,) = read_ledger("some", "parity")
    assert (record.blocks, record.commit, record.look) == ((entry.block,), entry.commit, 1)


@pytest.mark.usefixtures("checkout")
def test_a_commit_that_is_refused_stops_the_run_before_its_first_trial(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(code, "git", lambda *a: "" if a[0] in ("commit", "show") else GIT(*a))
    with pytest.raises(RefusedError, match="is not committed with its line"):
        run_and_record("some", Part("parity", lambda _: pytest.fail("drawn"), _judge, 6, is_parallel=False), Order())


GIT = code.git


def test_a_stopped_run_goes_on_and_its_seeds_never_come_again(checkout: Path):
    def stop(seed: int) -> Row:
        if seed == DEBUG_BELOW + 3:
            raise KeyboardInterrupt
        return _try(seed)

    tried: list[int] = []
    with pytest.raises(KeyboardInterrupt):
        run_and_record("some", Part("parity", stop, _judge, 6, is_parallel=False), Order())
    page = write_page([], [], read_ledger())
    assert "The ledger has the seeds: some-parity." in page
    again = Part("parity", lambda seed: tried.append(seed) or _try(seed), _judge, 6, is_parallel=False)
    record = run_and_record("some", again, Order())
    assert tried == [DEBUG_BELOW + k for k in (3, 4, 5)]
    assert record.blocks == (Block(DEBUG_BELOW, 6),)
    assert len(read_ledger()) == 1
    assert "The ledger has the seeds" not in write_page(read_records(), [], read_ledger())

    with pytest.raises(KeyboardInterrupt):
        run_and_record("some", Part("parity", lambda _: stop(DEBUG_BELOW + 3), _judge, 6, is_parallel=False), Order())
    change_code(checkout, 2)
    record = run_and_record("some", PART, Order())
    assert record.blocks[-1] == Block(DEBUG_BELOW + 12, 6), "of other code another block is entered"
    assert "The ledger has the seeds: some-parity." in write_page(read_records(), read_history(), read_ledger())
    assert without_result(read_records(), read_ledger()) == [read_ledger()[1]]
    assert read_ledger()[1].block == Block(DEBUG_BELOW + 6, 6)


def test_blocks_are_pooled_while_the_frozen_data_sets_say_the_same(checkout: Path, monkeypatch: pytest.MonkeyPatch):
    run_and_record("some", PART, Order())
    change_code(checkout, 2)
    whole = run_and_record("some", PART, Order(count=4))
    assert (whole.blocks, whole.look, whole.claim("even").n) == ((Block(DEBUG_BELOW, 10),), 2, 10)
    assert read_history() == []
    monkeypatch.setattr(records, "frozen_digest", lambda: "another finder")
    assert not whole.holds
    fresh = run_and_record("some", PART, Order())
    assert (fresh.blocks, fresh.look, fresh.claim("even").n) == ((Block(DEBUG_BELOW + 10, 6),), 3, 6)
    (old,) = read_history()
    assert (old.blocks, old.claims, old.rows) == (whole.blocks, whole.claims, ())


def test_a_record_begins_anew_where_something_was_mended_and_says_what_was_refuted_before(checkout: Path):
    def never(_rows):
        return [rate_of("even", 0, 100)]

    run_and_record("some", Part("parity", _try, never, 6), Order())
    change_code(checkout, 2)
    fresh = run_and_record("some", PART, Order(mended="C was 1"))
    assert (fresh.blocks, fresh.look, fresh.mended) == ((Block(DEBUG_BELOW + 6, 6),), 2, "C was 1")
    assert [one.claim("even").verdict for one in read_history()] == ["refuted"]
    whole = run_and_record("some", PART, Order())
    assert (whole.blocks, whole.look, whole.mended) == ((Block(DEBUG_BELOW + 6, 12),), 3, "C was 1")
    told = _tell_refuted_before({"some": read_records()}, read_history())
    assert told[2] == "- some-parity: `even` 0 % (0 to 4.48) of 100. Mended since: C was 1."


@pytest.mark.usefixtures("checkout")
def test_a_small_block_does_not_take_the_place_of_many_trials_that_hold():
    run_and_record("some", PART, Order(count=4000))
    whole = run_and_record("some", PART, Order(count=6))
    assert (whole.claim("even").n, whole.claim("even").verdict) == (4006, "shown")
    assert len(read_records()[0].rows) == 4006


@pytest.mark.usefixtures("checkout")
def test_seeds_can_be_looked_at_again_once_they_were_entered_and_not_before():
    with pytest.raises(RefusedError, match="nobody looks at seeds before they are entered"):
        run_and_record("some", PART, Order(is_scratch=True, first=DEBUG_BELOW))
    run_and_record("some", PART, Order())
    assert run_and_record("some", PART, Order(is_scratch=True, first=DEBUG_BELOW + 2, count=2)).claim("even").n == 2
    assert len(read_ledger()) == 1


def test_code_that_changes_while_the_proof_runs_is_not_recorded(checkout: Path):
    def change(seed: int) -> Row:
        (checkout / "lbacal_core" / "physics.py").write_text("C = 3\n")
        return _try(seed)

    with pytest.raises(RefusedError, match="changed while the proof ran"):
        run_and_record("some", Part("parity", change, _judge, 2), Order())
    assert read_records() == []


def test_what_a_record_itself_writes_does_not_stand_in_the_way_of_the_next(checkout: Path):
    run_and_record("some", PART, Order())
    (checkout / "README.md").write_text("renewed\n")
    assert code.changed_files() == []


@pytest.mark.usefixtures("checkout")
def test_a_limit_that_was_changed_after_it_was_refuted_is_told(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(ASKED, "even", Asked("Even", at_least=0.9))
    run_and_record("some", PART, Order(count=60))
    monkeypatch.setitem(ASKED, "even", Asked("Even", at_least=0.3))
    monkeypatch.setattr(records, "frozen_digest", lambda: "another finder")
    record = run_and_record("some", PART, Order(count=60))
    (old,) = read_history()
    told = f"; limit changed after {old.made_at[:10]}, when >= 90 % was *refuted*"
    assert tell_change(record.claim("even"), record, read_history()) == told
