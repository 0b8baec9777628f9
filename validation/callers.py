"""Which tests call a function: found by one run of the tests over a copy whose functions write their callers down."""

from __future__ import annotations

import ast
import fcntl
import json
import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from validation.code_changes import find

LOG = "CALLERS_LOG"
"""Variable of the environment: the file in which a call is noted."""
_noted: set[str] = set()


def note(place: str) -> None:
    """Write down that the running test has called a place; each once in a process."""
    test = os.environ.get("PYTEST_CURRENT_TEST", "").rpartition(" (")[0]
    line = json.dumps([place, test])
    if test and line not in _noted:
        _noted.add(line)
        with Path(os.environ[LOG]).open("a") as log:
            log.write(f"{line}\n")


def instrument(file: Path, function: str, place: str) -> bool:
    """Make a function of a file note its callers; False where it is no function."""
    text = file.read_text()
    node = find(ast.parse(text), function)
    if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        return False
    first = node.body[1] if ast.get_docstring(node) and len(node.body) > 1 else node.body[0]
    lines = text.splitlines(keepends=True)
    lines[first.lineno - 1] = (
        " " * first.col_offset + f'__import__("validation.callers").callers.note({place!r})\n' + lines[first.lineno - 1]
    )
    file.write_text("".join(lines))
    return True


def find_callers(places: Iterable[tuple[Path, str, str]], run: Callable[[], object], log: Path) -> dict[str, list[str]]:
    """Tests by the place that they call; places that are no functions are left out.

    Parameters
    ----------
    places
        File, name of the function in it, and the name under which its callers are told.
    run
        Runs the tests over these files.
    log
        A file in which calls are noted; a second process waits for it, and a log that is there is not made again.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not log.exists():
            called: dict[str, list[str]] = {
                place: [] for file, function, place in places if instrument(file, function, place)
            }
            noted = log.with_suffix(".calls")
            noted.write_text("")
            os.environ[LOG] = str(noted)
            try:
                run()
            finally:
                del os.environ[LOG]
            for place, test in dict.fromkeys(map(tuple, _read(noted))):
                called[place].append(test)
            log.write_text(json.dumps(called))
        return dict(json.loads(log.read_text()))


def _read(noted: Path) -> Sequence[list[str]]:
    return [json.loads(line) for line in noted.read_text().splitlines()]
