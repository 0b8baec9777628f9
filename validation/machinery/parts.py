"""A part of a proof: what one trial does, and what the trials show together."""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from validation.machinery.claims import Found
from validation.machinery.tables import tabulate

Row = dict[str, Any]
"""Inputs and outcome of one trial, as JSON stores them; `seed` is added to it."""


@dataclass(frozen=True)
class Part:
    """One family of trials and what is claimed of it. A proof is a module with a tuple `PARTS` of these.

    A part that draws or counts something else than before is another part and gets another name: blocks of one name
    are pooled.

    Attributes
    ----------
    name
        One word, joined by hyphens.
    trial
        Draws the data set of a seed, asks, and returns the row: a function of a module, which needs nothing else.
    judge
        The figures of its claims, from rows in the order of their seeds; `validation/claims.toml` says what is asked.
    count
        Trials, unless said otherwise.
    tell
        Tables of the single outcomes, in Markdown, for who runs the proof.
    headlines
        Keys of the claims that are rows of the page: one, or none where another part says the same. The others stay in
        the record, and what is not shown of them is told below the rows.
    has_chance
        Whether trials are drawn by chance; else the numbers 0 to count - 1 name fixed cases and no seeds are spent.
    is_parallel
        Whether trials may run beside each other.
    needs_shared
        Whether it reads the folder ../shared beside the project.
    has_figure
        Whether the docs have a figure or a table of its trials, which then stay in its record.
    """

    name: str
    trial: Callable[[int], Row]
    judge: Callable[[Sequence[Row]], list[Found]]
    count: int
    tell: Callable[[Sequence[Row]], list[str]] = tabulate
    headlines: tuple[str, ...] = ()
    has_chance: bool = True
    is_parallel: bool = True
    needs_shared: bool = False
    has_figure: bool = False


def proof_names() -> list[str]:
    """The proofs, by name: the modules beside the packages that have parts."""
    files = Path(__file__).parents[1].glob("*.py")
    return sorted(file.stem for file in files if re.search(r"^PARTS\b", file.read_text(encoding="utf-8"), re.MULTILINE))


def parts_of(proof: str) -> dict[str, Part]:
    """The parts of a proof, by name."""
    parts: tuple[Part, ...] = importlib.import_module(f"validation.{proof}").PARTS
    return {part.name: part for part in parts}


SHARED = Path(__file__).parents[3] / "shared"
"""Measured data beside the project, which not everybody has."""
