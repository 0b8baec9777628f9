"""Write the frozen numbers of the present code, or compare the present code with them.

    python -m validation.frozen --compare [NAME ...] [--workers N]
    python -m validation.frozen --write [NAME ...] [--workers N]
    python -m validation.frozen --list

`--compare` prints every difference and exits 1 if there is any. `--write` does the same and then stores the numbers: a
commit that does so names which of them move, and why.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from collections.abc import Iterator, Sequence
from typing import Any

from threadpoolctl import threadpool_limits

from validation.frozen.comparison import NUMBERS, Difference, list_differences, read_numbers, summarise, write_numbers
from validation.frozen.listing import DATA_SETS
from validation.frozen.surface import frozen_numbers
from validation.superterp import power_of


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m validation.frozen", description=__doc__.partition("\n")[0])
    action = parser.add_mutually_exclusive_group(required=True)
    action.add_argument("--compare", action="store_true", help="exit 1 if anything differs")
    action.add_argument("--write", action="store_true", help="store the numbers of the present code")
    action.add_argument("--list", action="store_true", help="name the data sets")
    parser.add_argument("names", nargs="*", metavar="NAME", help="data sets; all of them unless given")
    parser.add_argument("--workers", type=int, default=2, help="data sets at once (2)")
    chosen = parser.parse_args(arguments)
    unknown = sorted(set(chosen.names) - set(DATA_SETS))
    if unknown:
        parser.error(f"no such data set: {', '.join(unknown)}; --list names them")
    if chosen.list:
        print("\n".join(DATA_SETS))
        return 0
    started = time.monotonic()
    names, differences = chosen.names or list(DATA_SETS), list[Difference]()
    for name, numbers in _numbers_of(names, chosen.workers):
        found = compare_with_stored(name, numbers)
        print(f"{name}: {len(found)} differences", *found, sep="\n  ", flush=True)
        differences += found
        if chosen.write:
            write_numbers(NUMBERS / f"{name}.json.gz", numbers)
    if differences:
        print("\nBy place:", *summarise(differences), sep="\n  ")
    print(f"\n{len(names)} data sets, {len(differences)} differences; {time.monotonic() - started:.0f} s")
    return 1 if differences and chosen.compare else 0


def compare_with_stored(name: str, numbers: dict[str, Any]) -> list[Difference]:
    """Differences of a data set's numbers from those stored."""
    path = NUMBERS / f"{name}.json.gz"
    return list_differences(name, read_numbers(path) if path.is_file() else {}, numbers)


def _numbers_of(names: Sequence[str], workers: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Each data set in a process of its own; one alone in this process."""
    if len(names) == 1:
        with threadpool_limits(1):
            yield _take(names[0])
        return
    power_of()  # once, before the processes are forked
    with multiprocessing.get_context("fork").Pool(workers, threadpool_limits, (1,), maxtasksperchild=1) as pool:
        yield from pool.imap(_take, names, chunksize=1)


def _take(name: str) -> tuple[str, dict[str, Any]]:
    return name, frozen_numbers(DATA_SETS[name])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
