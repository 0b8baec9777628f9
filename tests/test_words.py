"""The words of the house: whole sentences in docstrings, and one word for one thing (docs/glossary.md)."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

FRAGMENT = re.compile(r"(?:\A|[.:;]\s|\n\s*)Of\s")
"""The beginning of a docstring, of one of its lines or of a sentence with "Of": a fragment without subject and verb."""


def docstrings(source: str) -> Iterator[str]:
    """Every string that stands by itself: of modules, classes and functions, and below constants."""
    for node in ast.walk(ast.parse(source)):
        for statement in getattr(node, "body", []) if isinstance(node, ast.Module | ast.stmt) else []:
            if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
                yield str(statement.value.value)


def comments(source: str) -> list[str]:
    """Every comment that has a line of its own, without its sign."""
    return re.findall(r"^\s*# (.*)$", source, re.MULTILINE)


def test_the_search_for_fragments_finds_one() -> None:
    source = '"""A module.\n\nAttributes\n----------\nname\n    Of the station.\n"""\nEDGE = 1\n"""Of a range."""\n'
    assert [len(FRAGMENT.findall(text)) for text in docstrings(source)] == [1, 1]
    assert [len(FRAGMENT.findall(text)) for text in comments("x = 1\n    # Of a range.\n# A range.\n")] == [1, 0]


PLACES = ("lbacal", "lbacal_core", "lbacal_paper", "lbacal_twin", "service", "validation")


def test_no_docstring_and_no_comment_has_a_fragment_that_begins_with_of(repository: Path, tracked: list[Path]) -> None:
    sources = {
        path: (repository / path).read_text() for path in tracked if path.suffix == ".py" and path.parts[0] in PLACES
    }
    found = [
        f"{path}: {text.strip()[:80]}"
        for path, source in sources.items()
        for text in (*docstrings(source), *comments(source))
        if FRAGMENT.search(text)
    ]
    assert found == []


BARE = re.compile(r"(What|Those|It|Its|That|These|This|Who)\b")
"""A first word that stands for a noun which the line does not say."""
NOT_YET = ("lbacal_core/causes/", "lbacal_core/discovery/")


def first_lines(source: str) -> Iterator[tuple[str, str]]:
    """Every public class and function with the first line of its docstring."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield node.name, (ast.get_docstring(node) or "").partition("\n")[0]


def test_the_search_for_first_lines_without_a_noun_finds_one() -> None:
    source = 'def a():\n    """What is found."""\n\n\ndef b():\n    """Whatever."""\n\n\nclass _C:\n    """Those."""\n'
    assert [name for name, line in first_lines(source) if BARE.match(line)] == ["a"]


def test_every_public_first_line_names_its_subject(repository: Path, tracked: list[Path]) -> None:
    found = [
        f"{path}: {name}: {line}"
        for path in tracked
        if path.suffix == ".py" and path.parts[0] in PLACES and not str(path).startswith(NOT_YET)
        for name, line in first_lines((repository / path).read_text())
        if BARE.match(line)
    ]
    assert found == []


EXCEPTIONS = {
    "find_excess": "the excess power of an interference line",
    "find_station_excess": "the excess power of an interference line",
    **dict.fromkeys(("law_of", "list_laws", "rough_laws"), "the law along frequency of a sentence"),
    **dict.fromkeys(("course_of", "list_courses"), "the course in time of a sentence"),
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


def test_the_table_of_words_that_are_not_used_is_read(repository: Path) -> None:
    assert {"law", "course", "shape", "evidence", "left over", "letter", "excess", "stale"} <= words_not_used(
        repository
    )
    assert "law" in words_of("fit_laws")
    assert "shape" in words_of("StaticShape")
    assert "law" not in words_of("lawn_of")


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


def test_no_heading_has_a_word_that_the_glossary_refuses(repository: Path, tracked: list[Path]) -> None:
    refused = words_not_used(repository)
    found = [
        f"{path}: {heading}"
        for path in tracked
        if path.suffix == ".md" and path.parts[0] == "docs"
        for heading in re.findall(r"^#+ (.*)$", (repository / path).read_text(), re.MULTILINE)
        if refused & set(words_of(heading))
    ]
    assert found == []


SPELT_OTHERWISE = {
    "chain test": "chi2_per_dof",
    "systematic error": "c_sigma_sys",
    "withdrawal": "withdraw",
    "rollback": "promote",
}
"""Entries of the glossary that the code spells in another way, or does with a more general thing."""
OF_OTHERS = {"CoREAS simulation"}
"""Entries that keep another thing apart from ours."""


def test_the_code_knows_every_entry_of_the_glossary(repository: Path, tracked: list[Path]) -> None:
    """An entry that no name, docstring, page or table uses describes something that does not exist."""
    texts = (
        (repository / path).read_text()
        for path in tracked
        if path.suffix in (".py", ".html") and path.parts[0] in PLACES
    )
    known = re.sub(r"[\s_-]+", " ", "\n".join(texts).lower())
    page = (repository / "docs/glossary.md").read_text().split("## Words that are not used")[0]
    entries = {entry for bold in re.findall(r"\*\*(.+?)\*\*", page) for entry in re.split(r", | / ", bold)}
    assert SPELT_OTHERWISE.keys() | OF_OTHERS <= entries
    unknown = set()
    for entry in entries - OF_OTHERS:
        in_code = SPELT_OTHERWISE.get(entry) or re.sub(r" ?[A-Z]\(.*\)", "", entry)
        if re.sub(r"[\s_-]+", " ", in_code.lower()) not in known:
            unknown.add(entry)
    assert unknown == set()


ORDINARY = {"averaged", "difference", "kind", "missing", "point", "ratio", "report", "seen", "shift"}
"""Words that mean in a name of a class what they mean elsewhere."""


def central_words(sources: Iterable[str]) -> set[str]:
    """Words of at least two public classes, in singular."""
    names = {name for source in sources for name in public_names(source) if name[0].isupper()}
    counts = Counter(word for name in names for word in {word.removesuffix("s") for word in words_of(name)})
    return {word for word, count in counts.items() if count > 1}


def test_central_words_are_those_of_several_classes() -> None:
    sources = (
        "class SkyModel:\n    pass\n",
        "class _Sky:\n    pass\n",
        "class Skies:\n    pass\nclass SkyModels:\n    pass\n",
    )
    assert central_words(sources) == {"sky", "model"}


def test_the_glossary_has_every_central_word_of_a_name(repository: Path, tracked: list[Path]) -> None:
    page = (repository / "docs/glossary.md").read_text().lower()
    sources = [
        (repository / path).read_text() for path in tracked if path.suffix == ".py" and path.parts[0] == "lbacal_core"
    ]
    missing = {word for word in central_words(sources) if not re.search(rf"\b{word}", page)}
    assert missing == ORDINARY & missing
    assert len(central_words(sources)) > 40


WORDS_OF_ALL_PAGES = 40_000
"""README and docs together; 76,000 when each page told what another one had told."""


def test_all_pages_together_have_no_more_words_than_are_read(repository: Path, tracked: list[Path]) -> None:
    pages = [path for path in tracked if path.suffix == ".md" and path.parts[0] in ("README.md", "docs")]
    assert len(pages) > 60
    assert sum(len((repository / path).read_text().split()) for path in pages) <= WORDS_OF_ALL_PAGES


def test_a_decision_has_at_most_twenty_lines(repository: Path) -> None:
    lines = {path.name: path.read_text().splitlines() for path in (repository / "docs/decisions").glob("*.md")}
    assert len(lines) > 20
    assert {name for name, said in lines.items() if len(said) > 20 or max(map(len, said)) > 120} == set()
