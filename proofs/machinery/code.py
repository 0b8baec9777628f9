"""Which state of the code a figure belongs to: the commit, and a digest of what can change a result."""

from __future__ import annotations

import hashlib
import subprocess
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[2]
WRITTEN = ("README.md", "docs/", "proofs/records/")
"""What a record writes or renews itself: it changes no result, so one record does not stand in the way of the next."""
TOLD = (
    "proofs/__main__.py", "proofs/quotes.toml", "proofs/machinery/page.py", "proofs/machinery/quotes.py",
    "proofs/machinery/records.py", "proofs/machinery/run.py", "proofs/frozen/",
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


def digest(folders: Sequence[str]) -> str:
    """SHA-256 of every file in folders that can change a result; records of the same digest may be pooled."""
    total = hashlib.sha256()
    names = git("ls-files", "-z", "--cached", "--others", "--exclude-standard", *folders).split("\0")
    for name in sorted(set(names)):
        if name and not name.startswith((*WRITTEN, *TOLD)) and (ROOT / name).is_file():
            total.update(f"{name}\0{hashlib.sha256((ROOT / name).read_bytes()).hexdigest()}\n".encode())
    return total.hexdigest()
