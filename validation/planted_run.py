"""A plugin of pytest: every test runs again with each fault whose function it calls, until one test sees the fault.

The code of a function is exchanged in the running process, so that modules and what fixtures of a session made stay as
they are, and a fault costs the tests that call it and no new process. What a cache or a session's fixture keeps of the
healthy code is not made again: a tier may see more than is counted, and not less.
"""

from __future__ import annotations

import ast
import importlib
import json
import os
import signal
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from _pytest.runner import runtestprotocol

from validation.code_changes import find

LOG = "PLANTED_LOG"
"""Variable of the environment: the file in which a test that sees a fault is written down, a line each."""
BLOCK = "PLANTED_BLOCK"
"""Variable of the environment: first seed of the drawn faults; those of the list where it is empty."""
LOOP_S = 300.0
"""Seconds of the processor after which a fault counts as a loop without end."""
CALLED: set[str] = set()
"""Places that the running test has called."""


def function_of(where: str) -> types.FunctionType | None:
    """The function of `MODULE:NAME`, the outermost one of a nested name; None where the place is no function."""
    module, _, path = where.partition(":")
    found: Any = importlib.import_module(module.removesuffix(".__init__"))
    for name in path.split("."):
        found = vars(found).get(name)
        for inner in ("fget", "func", "__func__", "__wrapped__"):
            found = getattr(found, inner, found)
        if not isinstance(found, type):
            break
    return found if isinstance(found, types.FunctionType) else None


def code_in(text: str, function: types.FunctionType) -> types.CodeType:
    """The code of a function in another text of its module."""
    whole = compile(text, function.__code__.co_filename, "exec")
    code = next(one for one in _codes(whole) if one.co_qualname == function.__code__.co_qualname)
    # a method of which `super()` was taken out no longer has `__class__`, without which its code is not exchanged
    return code.replace(co_freevars=function.__code__.co_freevars)


def _codes(code: types.CodeType) -> Iterator[types.CodeType]:
    yield code
    for one in code.co_consts:
        if isinstance(one, types.CodeType):
            yield from _codes(one)


def with_note(text: str, place: str) -> str:
    """The text of a module whose function notes that it is called."""
    node = find(ast.parse(text), place.partition(":")[2])
    if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        raise TypeError(f"{place} is no function")
    first = node.body[1] if ast.get_docstring(node) and len(node.body) > 1 else node.body[0]
    lines = text.splitlines(keepends=True)
    indent = " " * first.col_offset
    lines[first.lineno - 1] = (
        f'{indent}__import__("{__name__}", fromlist=["CALLED"]).CALLED.add({place!r})\n{lines[first.lineno - 1]}'
    )
    return "".join(lines)


class PlantedRun:
    """The faults of the list, by the function that they change."""

    def __init__(self, faults: list[tuple[str, str, str, str]], log: Path) -> None:
        """Take faults as (name, place, healthy text of the module, planted text)."""
        self.log = log
        self.faults: dict[str, list[tuple[str, types.FunctionType, types.CodeType]]] = {}
        for name, place, healthy, planted in faults:
            function = function_of(place)
            if function is not None:
                code = code_in(planted, function)
                if place not in self.faults:
                    function.__code__ = code_in(with_note(healthy, place), function)
                self.faults.setdefault(place, []).append((name, function, code))

    def seen(self) -> set[str]:
        """Faults that a test has seen, in any process."""
        return {json.loads(line)[0] for line in self.log.read_text().splitlines()}

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> bool:
        """Run a test, and once more with each unseen fault of what it called; it sees those that make it fail."""
        # what a module or a session's fixture made stays until the last of the runs
        parents: Any = types.SimpleNamespace(listchain=lambda: item.listchain()[:-1])
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        CALLED.clear()
        if self._passes(item, parents, is_told=True):
            asked = [fault for place in sorted(CALLED) for fault in self.faults[place]]
            for name, function, code in asked:
                if name in self.seen():
                    continue
                noting, function.__code__ = function.__code__, code
                try:
                    fails = not self._passes_in_time(item, parents)
                finally:
                    function.__code__ = noting
                if fails and self._passes(item, parents):  # a test that fails by chance sees nothing
                    with self.log.open("a") as log:
                        log.write(json.dumps([name, item.nodeid]) + "\n")
        item.session._setupstate.teardown_exact(nextitem)  # noqa: SLF001 - pytest has no public way
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def _passes_in_time(self, item: Any, parents: Any) -> bool:
        signal.signal(signal.SIGVTALRM, _end_loop)
        signal.setitimer(signal.ITIMER_VIRTUAL, LOOP_S)
        try:
            return self._passes(item, parents)
        finally:
            signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)

    @staticmethod
    def _passes(item: Any, parents: Any, is_told: bool = False) -> bool:
        item._initrequest()  # noqa: SLF001 - as reruns of a test do
        return not any(one.failed for one in runtestprotocol(item, log=is_told, nextitem=parents))


class _LoopError(BaseException):
    """A fault that does not end; no `except Exception` of the product takes it for its own."""


def _end_loop(*_: object) -> None:
    raise _LoopError


def pytest_configure(config: pytest.Config) -> None:
    """Plant where the run has been given a log."""
    if LOG in os.environ and not hasattr(config, "workerinput") and config.getoption("numprocesses", None):
        return  # the process that only hands out tests
    if LOG in os.environ:
        from validation.planted_faults import list_planted

        config.pluginmanager.register(
            PlantedRun(list_planted(Path.cwd(), os.environ.get(BLOCK, "")), Path(os.environ[LOG]))
        )
