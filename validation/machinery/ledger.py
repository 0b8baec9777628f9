"""Which seeds were entered before their first trial: `validation/ledger.jsonl`, a line a block, committed.

A rate is quoted from a block of seeds that nobody had looked at when the code was written. Seeds below `DEBUG_BELOW`
are for looking at. A block is entered, and the line committed, before anything is drawn from it; its seeds never come
again, whatever became of the run. What became of it is not stored here: a block that a record holds is recorded.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from validation.machinery import code

LEDGER = "validation/ledger.jsonl"
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

    def overlaps(self, other: Block) -> bool:
        """Whether a seed is in both."""
        return self.first < other.end and other.first < self.end


def joined(blocks: Iterable[Block]) -> tuple[Block, ...]:
    """The blocks in order, neighbours made one; raises ValueError where two share a seed."""
    result: list[Block] = []
    for block in sorted(blocks):
        if result and block.first < result[-1].end:
            raise ValueError(f"seeds {block.first} to {result[-1].end - 1} are in two blocks")
        if result and block.first == result[-1].end:
            result[-1] = Block(result[-1].first, result[-1].count + block.count)
        else:
            result.append(block)
    return tuple(result)


@dataclass(frozen=True)
class Entry:
    """A block of seeds of a part, entered at a commit; fixed cases, in which there is no chance, begin at 0.

    Attributes
    ----------
    mended
        What was mended in the code since the block before, with which this one is then not pooled.
    """

    proof: str
    part: str
    first: int
    count: int
    entered_at: str
    commit: str
    mended: str = ""

    @property
    def block(self) -> Block:
        """The seeds of the entry."""
        return Block(self.first, self.count)

    @property
    def line(self) -> str:
        """As stored."""
        return json.dumps(asdict(self))

    def is_held(self, blocks: Iterable[Block], commits: Iterable[str]) -> bool:
        """Whether records of its part, of these blocks and commits, hold its result."""
        if self.first < DEBUG_BELOW:
            return self.commit in commits
        return any(self.block.overlaps(one) for one in blocks)


def read_ledger(proof: str = "", part: str = "") -> list[Entry]:
    """The entries of a part, or all, in their order."""
    path = code.ROOT / LEDGER
    entries = _entries(path.read_text(encoding="utf-8")) if path.is_file() else []
    return [entry for entry in entries if not proof or (entry.proof, entry.part) == (proof, part)]


def _entries(text: str) -> list[Entry]:
    return [Entry(**json.loads(line)) for line in text.splitlines()]


def first_unspent(entries: Sequence[Entry]) -> int:
    """The first seed after all that a part has entered."""
    return max([DEBUG_BELOW, *(entry.block.end for entry in entries)])


def enter(entry: Entry, write_page: Callable[[], Path]) -> None:
    """Write a line and the page that tells it, and commit both; RuntimeError where the commit lacks the line."""
    path: Path = code.ROOT / LEDGER
    with path.open("a", encoding="utf-8") as file:
        file.write(entry.line + "\n")
    name = entry.proof if entry.part == entry.proof else f"{entry.proof} {entry.part}"
    files = [LEDGER, str(write_page())]
    code.git("add", *files)
    code.git("commit", "-q", "-m", f"Entered: {name}, seeds {entry.first} to {entry.block.end - 1}", "--", *files)
    if entry not in _entries(code.git("show", f"HEAD:{LEDGER}")):
        raise RuntimeError(f"{LEDGER} is not committed with its line: commit it, then start the proof again")
