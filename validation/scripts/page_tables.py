"""Tables of a page of the docs that a script writes, each between two markers."""

from __future__ import annotations


def replace_tables(page: str, tables: dict[str, str]) -> str:
    for name, table in tables.items():
        start, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->"
        before, rest = page.split(start)
        page = f"{before}{start}{table}\n{end}{rest.split(end)[1]}"
    return page
