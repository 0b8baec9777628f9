from __future__ import annotations

import pytest

from validation.machinery.seeds import DEBUG_BELOW, Block, enter_looked_at, joined, looked_at, next_fresh


def test_neighbours_become_one_block_and_a_seed_is_in_one_record_only():
    blocks = [Block(20, 5), Block(10, 10), Block(40, 1)]
    assert joined(blocks) == (Block(10, 15), Block(40, 1))
    with pytest.raises(ValueError, match="seeds 24 to 24 are in two records"):
        joined([*blocks, Block(24, 1)])


def test_the_next_fresh_seed_comes_after_all_that_were_used_and_never_below_those_for_debugging():
    assert next_fresh([]) == DEBUG_BELOW
    assert next_fresh([Block(0, 50)]) == DEBUG_BELOW
    assert next_fresh([Block(DEBUG_BELOW + 100, 50), Block(DEBUG_BELOW, 5)]) == DEBUG_BELOW + 150


def test_blocks_overlap_where_they_share_a_seed():
    assert Block(10, 5).overlaps(Block(14, 1))
    assert not Block(10, 5).overlaps(Block(15, 1))


def test_seeds_that_somebody_looked_at_are_remembered(tmp_path):
    file = tmp_path / "looked_at.json"
    enter_looked_at(file, "discovery", "clean", Block(DEBUG_BELOW + 7, 1))
    enter_looked_at(file, "discovery", "clean", Block(DEBUG_BELOW + 7, 1))
    enter_looked_at(file, "discovery", "one", Block(DEBUG_BELOW, 3))
    assert looked_at(file, "discovery", "clean") == [Block(DEBUG_BELOW + 7, 1)]
    assert looked_at(file, "fit", "example") == []
