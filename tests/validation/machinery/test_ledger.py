from __future__ import annotations

import pytest

from validation.machinery.ledger import DEBUG_BELOW, Block, Entry, first_unspent, joined


def entry(first: int, count: int, commit: str = "abcdefa") -> Entry:
    return Entry("some", "part", first, count, "2027-01-01T00:00:00Z", commit)


def test_neighbours_become_one_block_and_a_seed_is_in_one_block_only():
    blocks = [Block(20, 5), Block(10, 10), Block(40, 1)]
    assert joined(blocks) == (Block(10, 15), Block(40, 1))
    with pytest.raises(ValueError, match="seeds 24 to 24 are in two blocks"):
        joined([*blocks, Block(24, 1)])


def test_the_next_seed_comes_after_all_that_were_entered_and_never_below_those_for_debugging():
    assert first_unspent([]) == DEBUG_BELOW
    assert first_unspent([entry(0, 50)]) == DEBUG_BELOW
    assert first_unspent([entry(DEBUG_BELOW + 100, 50), entry(DEBUG_BELOW, 5)]) == DEBUG_BELOW + 150


def test_seeds_are_held_by_a_record_that_has_them_and_fixed_cases_by_their_commit():
    assert entry(DEBUG_BELOW, 5).is_held([Block(DEBUG_BELOW + 4, 6)], set())
    assert not entry(DEBUG_BELOW, 5).is_held([Block(DEBUG_BELOW + 5, 6)], {"abcdefa"})
    assert entry(0, 5).is_held([], {"abcdefa"})
    assert not entry(0, 5).is_held([Block(0, 5)], {"1234567"})
