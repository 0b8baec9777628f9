"""Which state of the code a figure belongs to: the commit, and a digest of what can change a result."""

from __future__ import annotations

import ast
import hashlib
import subprocess
from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import grimp

ROOT = Path(__file__).parents[2]
WRITTEN = ("README.md", "docs/", "validation/records/")
"""What a record writes or renews itself: it changes no result, so one record does not stand in the way of the next."""
TOLD = (
    "validation/__main__.py", "validation/quotes.toml", "validation/machinery/page.py",
    "validation/machinery/quotes.py",
    "validation/machinery/records.py", "validation/machinery/run.py", "validation/frozen/",
)  # fmt: skip
"""What tells of results and makes none."""


def git(*arguments: str) -> str:
    """What git prints."""
    done = subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, check=False)  # noqa: S607
    if done.returncode:
        raise RuntimeError(f"git {arguments[0]} failed: {done.stderr.strip()}")
    return done.stdout


def commit() -> str:
    """The commit of the checkout, in short."""
    return git("rev-parse", "--short=7", "HEAD").strip()


def changed_files() -> list[str]:
    """Files that differ from the commit, but for those that records write themselves."""
    status = git("status", "--porcelain", "-z", "--untracked-files=all").split("\0")
    names = [entry[3:] for entry in status if len(entry) > 3]
    return [name for name in names if not name.startswith(WRITTEN)]


def imported_by(trial: Callable[..., Any]) -> set[str]:
    """The project's files that the module of a trial imports, directly or through others, and that file itself."""
    function = trial.func if isinstance(trial, partial) else trial
    graph = _imports()
    if function.__module__ not in graph.modules:
        return set()
    modules = {function.__module__, *graph.find_upstream_modules(function.__module__)}
    modules |= {name.rsplit(".", depth)[0] for name in modules for depth in range(1, name.count(".") + 1)}
    stems = [name.replace(".", "/") for name in modules]
    return {name for stem in stems for name in (f"{stem}.py", f"{stem}/__init__.py")}


@cache
def _imports() -> grimp.ImportGraph:
    return grimp.build_graph(
        "lbacal", "lbacal_core", "lbacal_paper", "lbacal_twin", "validation", "service", cache_dir=None
    )


class _Wordless(ast.NodeTransformer):
    def visit_Expr(self, node: ast.Expr) -> ast.Expr | None:
        is_text = isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        return None if is_text else node


@cache
def without_words(source: str) -> str:
    """Python code without its comments, its docstrings and its layout, none of which changes a result."""
    return ast.dump(_Wordless().visit(ast.parse(source)))


def digest(trial: Callable[..., Any], folders: Sequence[str]) -> str:
    """SHA-256 of what can change the result of a trial: the code that it imports, and all else in folders.

    Records of the same digest may be pooled, whatever else of the project was changed between them.
    """
    total = hashlib.sha256()
    names = set(git("ls-files", "-z", "--cached", "--others", "--exclude-standard", *folders).split("\0"))
    for name in sorted(names | imported_by(trial)):
        file = ROOT / name
        if name and not name.startswith((*WRITTEN, *TOLD)) and file.is_file():
            content = without_words(file.read_text("utf-8")).encode() if file.suffix == ".py" else file.read_bytes()
            total.update(f"{name}\0{hashlib.sha256(content).hexdigest()}\n".encode())
    return total.hexdigest()
