from __future__ import annotations

import json
from contextlib import suppress

import numpy as np

from validation.fuzz import SPECTRA, _write_file
from validation.fuzzing import change_bytes, change_hdf5, change_json, write_json


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
