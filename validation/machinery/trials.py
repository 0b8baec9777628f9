"""Many independent trials on several processes; an interrupted run goes on where it was."""

from __future__ import annotations

import json
import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TypeVar

from threadpoolctl import threadpool_limits

from validation.machinery.ledger import Block
from validation.machinery.parts import Part, Row

Task = TypeVar("Task")
Outcome = TypeVar("Outcome")


def run_trials(
    trial: Callable[[Task], Outcome], tasks: Sequence[Task], name: str, workers: int = 2
) -> Iterator[Outcome]:
    """Do every task, in any order, and say how far it is; linear algebra has one thread in each process."""
    begin = last = time.monotonic()
    for done, outcome in enumerate(_outcomes(trial, tasks, workers), 1):
        yield outcome
        now = time.monotonic()
        if done == len(tasks) or now - last > 20:
            left = (now - begin) * (len(tasks) - done) / done
            print(f"{name}: {done} of {len(tasks)}, {left:.0f} s left", file=sys.stderr, flush=True)
            last = now


def _outcomes(trial: Callable[[Task], Outcome], tasks: Sequence[Task], workers: int) -> Iterator[Outcome]:
    if workers < 2 or len(tasks) < 4:
        with threadpool_limits(1):
            yield from map(trial, tasks)
        return
    # Children are forked once and keep what they have built.
    with multiprocessing.get_context("fork").Pool(workers, _one_thread) as pool:
        yield from pool.imap_unordered(trial, tasks)


def _one_thread() -> None:
    threadpool_limits(1)


def run_part(part: Part, block: Block, kept: Path | None, workers: int) -> list[Row]:
    """Rows of a block of seeds, in their order.

    Parameters
    ----------
    kept
        File to which every row is appended as soon as it is there; rows that it holds are not done again. It must be
        of this part and this state of the code. Where it is None nothing is kept.

    Returns
    -------
    The rows; `seconds` is the processor time of the trial and of the processes that it started and waited for.
    """
    done = read_kept(kept) if kept else {}
    wanted = range(block.first, block.end)
    missing = [seed for seed in wanted if seed not in done]
    if len(missing) < block.count:
        print(f"{part.name}: {block.count - len(missing)} of {block.count} were done before", file=sys.stderr)
    if kept:
        kept.parent.mkdir(parents=True, exist_ok=True)
    with kept.open("a") if kept else nullcontext() as file:
        for row in run_trials(
            partial(_try, part.trial), missing, part.name, workers=workers if part.is_parallel else 1
        ):
            done[row["seed"]] = row
            if file:
                file.write(json.dumps(row) + "\n")
                file.flush()
    return [done[seed] for seed in wanted]


def _try(trial: Callable[[int], Row], seed: int) -> Row:
    begin = _processor_time()
    row = trial(seed)
    # What is kept is what is judged: the row as JSON gives it back.
    stored: Row = json.loads(json.dumps({"seed": seed, **row, "seconds": round(_processor_time() - begin, 3)}))
    return stored


def _processor_time() -> float:
    return sum(os.times()[:4])


def read_kept(file: Path) -> dict[int, Row]:
    """Rows of an interrupted run by seed; a line that was cut off is left out."""
    rows: dict[int, Row] = {}
    if not file.is_file():
        return rows
    text = file.read_text()
    if text and not text.endswith("\n"):
        text = text[: text.rfind("\n") + 1]
        file.write_text(text)  # so that the next row starts a line of its own
    for line in text.splitlines():
        row = json.loads(line)
        rows[int(row["seed"])] = row
    return rows
