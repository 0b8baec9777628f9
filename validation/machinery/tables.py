"""Tables in Markdown: of the trials of a part, a line a field of the rows, a column a group of trials; and of pages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

MOST_TEXTS = 8
"""Different texts of a field that are told."""


def by(*keys: str) -> Callable[[Sequence[Mapping[str, Any]]], list[str]]:
    """`tabulate` with these keys."""
    return partial(tabulate, keys=keys)


def tabulate(rows: Sequence[Mapping[str, Any]], keys: Sequence[str] = ()) -> list[str]:
    """Means of numbers, and counts of texts with the first seed of each, by the values of some fields."""
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault(", ".join(str(row[key]) for key in keys) or "all", []).append(row)
    names = sorted(groups)
    found: dict[str, dict[str, list[tuple[int, Any]]]] = {}
    for name in names:
        for row in groups[name]:
            for field, value in _leaves({k: v for k, v in row.items() if k not in ("seed", "seconds", *keys)}):
                found.setdefault(field, {}).setdefault(name, []).append((row.get("seed", 0), value))
    table = [["trials", *(str(len(groups[name])) for name in names)]]
    table += [[field, *(_cell(of.get(name, [])) for name in names)] for field, of in found.items()]
    return write_table(["", *names], table)


def write_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """The lines of a table in Markdown."""
    first, *rest = (f"| {' | '.join(cells)} |" for cells in (head, *rows))
    return [first.replace("|  |", "| |"), "|" + "---|" * len(head), *rest]


def replace_tables(page: str, tables: Mapping[str, Sequence[str]]) -> str:
    """A page with its tables, each between two markers."""
    for name, lines in tables.items():
        start, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->"
        before, rest = page.split(start)
        page = before + start + "\n".join([*lines, end]) + rest.split(end)[1]
    return page


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every value that holds no others; numbers of a list by their place, all else of a list together."""
    if isinstance(value, Mapping):
        for key, one in value.items():
            yield from _leaves(one, f"{path}.{key}" if path else str(key))
    elif isinstance(value, Sequence) and not isinstance(value, str):
        for k, one in enumerate(value):
            yield from _leaves(one, f"{path}.{k}" if isinstance(one, int | float) else path)
    else:
        yield path, value


def _cell(values: Sequence[tuple[int, Any]]) -> str:
    numbers = [value for _, value in values if isinstance(value, int | float)]
    texts = [(seed, str(value)) for seed, value in values if value and not isinstance(value, int | float)]
    counts = Counter(text for _, text in texts)
    first = {text: seed for seed, text in reversed(texts)}
    told = [f"{sum(numbers) / len(numbers):.4g}"] if numbers else []
    told += [f"{text} {count} (seed {first[text]})" for text, count in counts.most_common(MOST_TEXTS)]
    return ", ".join(told)
