from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.foreign import read_npz


@pytest.fixture
def path(tmp_path: Path) -> Path:
    np.savez_compressed(tmp_path / "a.npz", a=np.arange(200.0), b=np.ones(3))
    return tmp_path / "a.npz"


def test_wanted_and_other_arrays_are_read(path: Path) -> None:
    content = read_npz(path, ("a",), "numbers")
    assert set(content) == {"a", "b"}
    np.testing.assert_array_equal(content["a"], np.arange(200.0))


def test_missing_arrays_are_named(path: Path) -> None:
    with pytest.raises(BadInputError, match=r"a\.npz: expected the arrays a, c, d, found no c, d"):
        read_npz(path, ("a", "c", "d"), "numbers")


def test_a_single_array_is_no_set_of_arrays(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.ones(3))
    with pytest.raises(BadInputError, match="found no a"):
        read_npz(tmp_path / "a.npy", ("a",), "numbers")


def test_pickled_objects_are_refused_unopened(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", a=np.array([{}], dtype=object))
    with pytest.raises(UnreadableFileError, match="file of numbers, found a broken one"):
        read_npz(tmp_path / "a.npz", ("a",), "numbers")


def test_every_truncation_is_a_sentence(path: Path) -> None:
    content = path.read_bytes()
    for length in range(0, len(content), 7):
        path.write_bytes(content[:length])
        with pytest.raises(UnreadableFileError, match="expected a NumPy"):
            read_npz(path, ("a",), "numbers")


def test_changed_bytes_give_a_sentence_or_arrays(path: Path) -> None:
    content = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    rng = np.random.default_rng(1)
    refused = 0
    for _ in range(300):
        mutant = content.copy()
        mutant[rng.integers(0, mutant.size, 2)] = rng.integers(0, 256, 2)
        path.write_bytes(mutant.tobytes())
        try:
            read_npz(path, ("a",), "numbers")
        except (BadInputError, UnreadableFileError):
            refused += 1
    assert 100 < refused < 300
