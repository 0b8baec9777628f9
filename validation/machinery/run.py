"""Run a part of a proof on a block of seeds, and record it where that is allowed."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from validation.machinery import code
from validation.machinery.parts import SHARED, Part
from validation.machinery.records import (
    FRESH,
    LOOKED_AT,
    NO_CHANCE,
    RECORDS,
    REPETITION,
    SEEN,
    Record,
    make_claims,
    of_part,
    pool,
    read_records,
)
from validation.machinery.seeds import Block, enter_looked_at, looked_at, next_fresh
from validation.machinery.trials import run_part


class RefusedError(Exception):
    """A run that may not be recorded: why, and what to do."""


@dataclass(frozen=True)
class Order:
    """How a part is to be run.

    Attributes
    ----------
    first, count
        The block of seeds; by default the next that nobody has seen, and as many as the part usually has.
    is_scratch
        Whether nothing is recorded; by default seeds that are for debugging.
    is_repetition
        Whether the seeds may be those of an earlier record.
    """

    first: int | None = None
    count: int | None = None
    workers: int = 2
    is_scratch: bool = False
    is_repetition: bool = False


def choose_block(part: Part, order: Order, used: list[Block]) -> Block:
    """The seeds of a run."""
    count = order.count or part.count
    if not part.has_chance:
        return Block(0, part.count)
    if order.first is not None:
        return Block(order.first, count)
    return Block(0 if order.is_scratch else next_fresh(used), count)


def seeds_of(part: Part, block: Block, order: Order, earlier: list[Record], seen: list[Block], digest: str) -> str:
    """What the seeds of a block are; raises RefusedError where they may not be used as they are."""
    if not part.has_chance:
        return NO_CHANCE
    if block.is_for_debugging:
        return SEEN
    spent = [record for record in earlier if any(block.overlaps(one) for one in record.blocks)]
    if any(record.code == digest for record in spent):
        raise RefusedError(f"seeds {block.first} to {block.end - 1} are in a record of this code already")
    where = [f"in the record of {record.commit}" for record in spent]
    where += ["tried without a record"] * any(block.overlaps(one) for one in seen)
    if where and not order.is_repetition:
        raise RefusedError(
            f"seeds {block.first} to {block.end - 1} were used before ({where[0]}): leave out --first for fresh ones, "
            "or say --repetition, which decides nothing"
        )
    return REPETITION if where else FRESH


def run_and_record(proof: str, part: Part, order: Order) -> tuple[Record, bool]:
    """Run one part.

    Returns
    -------
    The record, and whether it was written; a record of the same code takes it in. Raises RefusedError where it would
    have to be written and may not.
    """
    if part.needs_shared and not SHARED.is_dir():
        raise RefusedError(f"{proof} {part.name} needs the folder ../shared beside the project")
    changed = code.changed_files()
    if changed and not order.is_scratch:
        raise RefusedError(f"the tree is changed ({', '.join(changed[:3])}): commit first, or run with --scratch")
    digest, commit = code.digest(part.trial, part.code), code.commit()
    earlier, seen = of_part(read_records(), proof, part.name), looked_at(LOOKED_AT, proof, part.name)
    used = [block for record in earlier for block in record.blocks] + seen
    block = choose_block(part, order, used)
    if order.is_scratch:
        seeds = SEEN if part.has_chance else NO_CHANCE
        if part.has_chance and not block.is_for_debugging:
            enter_looked_at(LOOKED_AT, proof, part.name, block)
    else:
        seeds = seeds_of(part, block, order, earlier, seen, digest)
    kept = code.ROOT / "var" / "proofs" / f"{proof}-{part.name}-{digest[:16]}.jsonl"
    rows = run_part(part, block, kept, order.workers)
    record = Record(
        proof, part.name, commit, f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}", digest, (block,), seeds,
        sum(row["seconds"] for row in rows) / 3600, make_claims(part, rows, seeds), tuple(rows),
    )  # fmt: skip
    if order.is_scratch:
        return record, False
    if code.changed_files() or code.digest(part.trial, part.code) != digest:
        raise RefusedError("the code was changed while the proof ran: nothing is recorded")
    return take_in(record, part), True


def take_in(record: Record, part: Part, path: Path | None = None) -> Record:
    """Write a record, together with those of the same code.

    Parameters
    ----------
    path
        Where it lies already; a file of the folder of records is replaced by the one that holds it.
    """
    alike = [
        one
        for one in of_part(read_records(), record.proof, record.part)
        if one.code == record.code and one.seeds == record.seeds and RECORDS / one.file_name != path
    ]
    whole = record if record.seeds == NO_CHANCE else pool([*alike, record], part)
    for one in alike:
        (RECORDS / one.file_name).unlink()
    if path is not None and path.is_relative_to(RECORDS):
        path.unlink()
    whole.write()
    return whole
