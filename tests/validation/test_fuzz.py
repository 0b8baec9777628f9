from __future__ import annotations

import json
from contextlib import suppress

import numpy as np
import pytest

from validation import fuzz
from validation.fuzz import BOMBS, SPECTRA, _write_file, ask_routes, read_documents, read_files, send_bomb
from validation.fuzzing import change_bytes, change_hdf5, change_json, write_json
from validation.machinery.records import verdicts_of


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """The suite's small instance of `./dev prove fuzz`."""
    monkeypatch.setattr(fuzz, "EXAMPLES", 3)
    monkeypatch.setattr(fuzz, "DOCUMENTS", 1000)
    monkeypatch.setattr(fuzz, "FILES", 100)


@pytest.mark.parametrize("number", [0, 1])
def test_no_route_fails_and_all_answer_as_they_say(number: int, request: pytest.FixtureRequest) -> None:
    """Over HTTP; on PostgreSQL a NUL in the query of three routes was a failure that SQLite did not have."""
    if fuzz.DATABASES[number] == "postgresql":
        request.getfixturevalue("needs_postgres")
    row = ask_routes(number)
    assert row["failures"] == []
    assert {"200", "403", "404", "422"} <= set(row["statuses"])


def test_every_reader_of_changed_documents_reads_or_says_what_is_wrong() -> None:
    row = read_documents(0)
    assert row["failures"] == []
    assert len(row["read"]) == 11


def test_every_changed_file_is_read_or_refused() -> None:
    row = read_files(0)
    assert row["failures"] == []
    assert row["outcomes"]["read"] > 0
    assert row["outcomes"]["bad_input"] > 0


@pytest.mark.parametrize("name", ["300,000 empty spectra", "3.6 MB that become 2.3 GB"])
def test_a_bomb_is_refused_within_bounds(name: str) -> None:
    row = send_bomb(sorted(BOMBS).index(name))
    assert (row["failures"], row["bomb"]) == ([], name)
    assert row["memory_mb"] < 500  # as validation/claims.toml asks


def test_no_failure_in_ten_thousand_cases_shows_that_fewer_than_one_in_two_thousand_fails() -> None:
    rows = [{"cases": 5000, "failed": 0}] * 2
    assert verdicts_of("fuzz", "files", rows) == {"failed": "shown"}
    assert verdicts_of("fuzz", "readers", rows) == {"failed": "undecided"}
    bombs = [{"failed": 0, "memory_mb": 300}, {"failed": 0, "memory_mb": 5000}]
    assert verdicts_of("fuzz", "bombs", bombs) == {"failed": "shown", "memory": "refuted"}


def test_a_change_leaves_the_document_and_its_parts_alone() -> None:
    before = json.dumps(SPECTRA)
    changed = [json.dumps(change_json(np.random.default_rng(k), SPECTRA)) for k in range(300)]
    assert json.dumps(SPECTRA) == before
    assert len(set(changed)) > 200, "changes differ"
    assert changed == [json.dumps(change_json(np.random.default_rng(k), SPECTRA)) for k in range(300)]


def test_one_written_document_in_ten_is_not_json() -> None:
    broken = 0
    for k in range(300):
        content = write_json(np.random.default_rng(k), SPECTRA)
        with suppress(ValueError):
            json.loads(content)
            continue
        broken += 1
    assert 3 < broken < 60


def test_bytes_and_files_are_changed() -> None:
    file = _write_file()
    assert sum(change_bytes(np.random.default_rng(k), file) != file for k in range(50)) > 45
    assert sum(change_hdf5(np.random.default_rng(k), file) != file for k in range(50)) > 45
    assert change_bytes(np.random.default_rng(0), b"") == b""
