"""The words of the house: one word for one thing (docs/glossary.md)."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

EXCEPTIONS = {
    "find_excess": "the excess power of an interference line",
    "find_station_excess": "the excess power of an interference line",
}
"""Names with a word that is not used, and what they mean."""


def section(repository: Path, title: str) -> str:
    page = (repository / "docs/glossary.md").read_text()
    return page.split(f"## {title}\n")[1].split("\n## ")[0]


def words_not_used(repository: Path) -> set[str]:
    """The first column of the glossary's last table."""
    rows = re.findall(r"^\| (?!not \|)([a-z ,]+) \|", section(repository, "Words that are not used"), re.MULTILINE)
    return {word.strip() for row in rows for word in row.split(",")}


def words_of(name: str) -> list[str]:
    """Words of an identifier in singular and lower case: `SpectralFamilies` and `spectral_family` have two."""
    words = [word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)]
    return words + [word.removesuffix("s") for word in words]


def public_names(source: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield node.name


@pytest.mark.long
def test_no_public_name_has_a_word_that_the_glossary_refuses(repository: Path, tracked: list[Path]) -> None:
    refused = words_not_used(repository)
    found = {
        name: str(path)
        for path in tracked
        if path.suffix == ".py" and path.parts[0] == "lbacal_core"
        for name in (path.stem, *public_names((repository / path).read_text()))
        if refused & set(words_of(name))
    }
    assert found.keys() == EXCEPTIONS.keys()
