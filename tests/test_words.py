"""The words of the house: whole sentences in docstrings, and one word for one thing (docs/glossary.md)."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

FRAGMENT = re.compile(r"(?:\A|[.:;]\s|\n\s*)Of\s")
"""The beginning of a docstring, of one of its lines or of a sentence with "Of": a fragment without subject and verb."""


def docstrings(source: str) -> Iterator[str]:
    """Every string that stands by itself: of modules, classes and functions, and below constants."""
    for node in ast.walk(ast.parse(source)):
        for statement in getattr(node, "body", []) if isinstance(node, ast.Module | ast.stmt) else []:
            if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
                yield str(statement.value.value)


def test_the_search_for_fragments_finds_one() -> None:
    source = '"""A module.\n\nAttributes\n----------\nname\n    Of the station.\n"""\nEDGE = 1\n"""Of a range."""\n'
    assert [len(FRAGMENT.findall(text)) for text in docstrings(source)] == [1, 1]


def test_no_docstring_has_a_fragment_that_begins_with_of(repository: Path, tracked: list[Path]) -> None:
    found = [
        f"{path}: {text.strip()[:80]}"
        for path in tracked
        if path.suffix == ".py" and path.parts[0] in ("lbacal_core", "service")
        for text in docstrings((repository / path).read_text())
        if FRAGMENT.search(text)
    ]
    assert found == []
