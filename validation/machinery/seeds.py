"""Which data sets had been seen before: every trial is drawn from a seed, and every recorded block of seeds is known.

A rate is quoted from a block of seeds that nobody had looked at when the code was written. Seeds below `DEBUG_BELOW`
are for looking at. A block that was recorded once is spent: whoever changes the code afterwards may have seen what
failed in it. Seeds above `DEBUG_BELOW` that were tried without a record are entered in `records/looked_at.json`.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

DEBUG_BELOW = 1_000_000
"""Seeds below are for debugging; all that was drawn before there were records is below as well."""


@dataclass(frozen=True, order=True)
class Block:
    """`count` seeds from `first` on."""

    first: int
    count: int

    @property
    def end(self) -> int:
        """The first seed after the block."""
        return self.first + self.count

    @property
    def is_for_debugging(self) -> bool:
        """Whether the block has seeds that are for looking at."""
        return self.first < DEBUG_BELOW

    def overlaps(self, other: Block) -> bool:
        """Whether a seed is in both."""
        return self.first < other.end and other.first < self.end


def joined(blocks: Iterable[Block]) -> tuple[Block, ...]:
    """The blocks in order, neighbours made one; raises ValueError where two share a seed."""
    result: list[Block] = []
    for block in sorted(blocks):
        if result and block.first < result[-1].end:
            raise ValueError(f"seeds {block.first} to {result[-1].end - 1} are in two records")
        if result and block.first == result[-1].end:
            result[-1] = Block(result[-1].first, result[-1].count + block.count)
        else:
            result.append(block)
    return tuple(result)


def next_fresh(used: Iterable[Block]) -> int:
    """The first seed after all that were used."""
    return max([DEBUG_BELOW, *(block.end for block in used)])


def looked_at(file: Path, proof: str, part: str) -> list[Block]:
    """Blocks of fresh seeds that were tried without a record."""
    if not file.is_file():
        return []
    entries = json.loads(file.read_text())
    return [Block(e["first"], e["count"]) for e in entries if (e["proof"], e["part"]) == (proof, part)]


def enter_looked_at(file: Path, proof: str, part: str, block: Block) -> None:
    """Remember that somebody looked at a block."""
    entries = json.loads(file.read_text()) if file.is_file() else []
    entry = {"proof": proof, "part": part, "first": block.first, "count": block.count}
    if entry not in entries:
        rows: Sequence[str] = [json.dumps(one) for one in [*entries, entry]]
        file.write_text("[\n" + ",\n".join(rows) + "\n]\n")
