"""Run a part of a proof on a block of seeds that is entered before its first trial, and record what it gave."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from datetime import UTC, datetime

from validation.frozen.comparison import frozen_digest
from validation.machinery import code
from validation.machinery.claims import decide
from validation.machinery.ledger import DEBUG_BELOW, Block, Entry, enter, first_unspent, read_ledger
from validation.machinery.page import renew_page
from validation.machinery.parts import SHARED, Part
from validation.machinery.records import Record, asked_of, name_of, read_history, read_records, take_in, without_result
from validation.machinery.trials import run_part


class RefusedError(Exception):
    """A run that may not be made: why, and what to do."""


@dataclass(frozen=True)
class Order:
    """How a part is to be run.

    Attributes
    ----------
    count
        Seeds; as many as the part usually has unless given.
    is_scratch
        Whether nothing is entered or recorded.
    first
        First seed of a scratch run; those of a recorded run follow from the ledger.
    mended
        What was mended in the code since the last block, where the record is to begin anew.
    """

    count: int | None = None
    workers: int = 2
    is_scratch: bool = False
    first: int = 0
    mended: str = ""


def run_and_record(proof: str, part: Part, order: Order) -> Record:
    """Run one part; raises RefusedError where it may not be run so."""
    if part.needs_shared and not SHARED.is_dir():
        raise RefusedError(f"{proof} {part.name} needs the folder ../shared beside the project")
    made_at = f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"
    entries = read_ledger(proof, part.name)
    if order.is_scratch:
        return _try_out(proof, part, _scratch_block(part, order, entries), made_at, order.workers)
    if changed := code.changed_files():
        raise RefusedError(f"the tree is changed ({', '.join(changed[:3])}): commit first, or run with --scratch")
    entry = _resumed(entries) or _entered(proof, part, order, entries, made_at)
    look = [one.first for one in read_ledger(proof, part.name)].index(entry.first) + 1 if part.has_chance else 1
    kept = code.ROOT / "var" / "proofs" / f"{name_of(proof, part.name)}-{entry.first}-{entry.commit}.jsonl"
    rows = run_part(part, entry.block, kept, order.workers)
    if code.changed_files() or code.changed_since(entry.commit):
        raise RefusedError("the code was changed while the proof ran: nothing is recorded")
    hours = sum(row["seconds"] for row in rows) / 3600
    record = Record(
        proof, part.name, entry.commit, made_at, frozen_digest(), look, (entry.block,), hours, (), mended=entry.mended
    )
    return take_in(record, part, rows)


def _try_out(proof: str, part: Part, block: Block, made_at: str, workers: int) -> Record:
    rows = run_part(part, block, None, workers)
    claims = decide(part.judge(rows), asked_of(proof, part.name))
    hours = sum(row["seconds"] for row in rows) / 3600
    return Record(proof, part.name, code.commit(), made_at, "", 1, (block,), hours, claims, tuple(rows))


def _scratch_block(part: Part, order: Order, entries: list[Entry]) -> Block:
    """Seeds for looking at: those for debugging, and those that have been entered."""
    block = Block(order.first, order.count or part.count) if part.has_chance else Block(0, part.count)
    if block.end > DEBUG_BELOW and not any(e.first <= block.first and block.end <= e.block.end for e in entries):
        raise RefusedError(
            f"seeds {block.first} to {block.end - 1} are neither below {DEBUG_BELOW} nor of one block of the ledger: "
            "nobody looks at seeds before they are entered"
        )
    return block


def _resumed(entries: list[Entry]) -> Entry | None:
    """The block that was entered last, if it has no result and the code is still that of its entry."""
    last = without_result([*read_records(), *read_history()], entries[-1:])
    if not last or code.changed_since(last[0].commit):
        return None
    print(f"{last[0].part}: the block entered on {last[0].entered_at} is continued", file=sys.stderr)
    return last[0]


def _entered(proof: str, part: Part, order: Order, entries: list[Entry], now: str) -> Entry:
    first, count = (first_unspent(entries), order.count or part.count) if part.has_chance else (0, part.count)
    entry = Entry(proof, part.name, first, count, now, code.commit(), order.mended)
    try:
        enter(entry, renew_page)
    except RuntimeError as error:
        raise RefusedError(str(error)) from error
    return entry
