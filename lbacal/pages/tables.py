"""Rows of text as lines for a terminal."""

from __future__ import annotations

from collections.abc import Sequence


def align(rows: Sequence[Sequence[str]], words: int = 1) -> list[str]:
    """The rows as lines of equal columns, words flush left and numbers flush right.

    Parameters
    ----------
    words
        How many columns are words, from the first on.
    """
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    cells = (
        [cell.ljust(widths[k]) if k < words else cell.rjust(widths[k]) for k, cell in enumerate(row)] for row in rows
    )
    return ["  ".join(line).rstrip() for line in cells]
