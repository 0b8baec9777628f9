"""The state of the code that a figure belongs to: its commit, and whether the tree is that of the commit."""

from __future__ import annotations

import subprocess
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).parents[2]
WRITTEN = ("README.md", "docs/", "validation/records/", "validation/history.jsonl", "validation/ledger.jsonl")
"""What a record writes or renews itself: it changes no result, so one record does not stand in the way of the next."""


def git(*arguments: str) -> str:
    """Run git and return its output."""
    done = subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, check=False)  # noqa: S607
    if done.returncode:
        raise RuntimeError(f"git {arguments[0]} failed: {done.stderr.strip()}")
    return done.stdout


def commit() -> str:
    return git("rev-parse", "--short=7", "HEAD").strip()


def changed_files() -> list[str]:
    """Files that differ from the commit, but for those that records write themselves."""
    status = git("status", "--porcelain", "-z", "--untracked-files=all").split("\0")
    return _of_code(entry[3:] for entry in status if len(entry) > 3)


def changed_since(commit: str) -> list[str]:
    """Files that differ between a commit and that of the checkout, but for those that records write themselves."""
    return _of_code(git("diff", "--name-only", "-z", commit, "HEAD").split("\0"))


def _of_code(names: Iterable[str]) -> list[str]:
    return [name for name in names if name and not name.startswith(WRITTEN)]
