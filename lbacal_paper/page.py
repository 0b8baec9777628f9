"""The claims as Markdown, for the documentation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from lbacal_paper.statements import BY_CONSTRUCTION, DISAGREE, UNDECIDED, UNTESTED, describe_verdicts

TITLES = {
    DISAGREE: "Where we disagree",
    UNDECIDED: "What our numbers leave undecided",
    UNTESTED: "What cannot be tested here",
    BY_CONSTRUCTION: "What follows by construction",
}
BEGIN, END = "<!-- claims: written by validation/scripts/write_paper_page.py -->", "<!-- end of claims -->"


def describe_claims(claims: Sequence[Mapping[str, Any]]) -> str:
    """The table of all claims, then what stands behind those that do not simply agree."""
    rows = [
        f"| `{one['id']}` | {one['section']} | {one['claim']} | {_published(one)} | {_ours(one)} | {one['verdict']} |"
        for one in claims
    ]
    head = ["| id | section | statement | published | ours | verdict |", "|---|---|---|---|---|---|"]
    parts = [f"**{describe_verdicts(claims)}.**", "\n".join([*head, *rows])]
    for verdict, title in TITLES.items():
        chosen = [f"- `{one['id']}`: {one['how'].rstrip('.')}." for one in claims if one["verdict"] == verdict]
        if chosen:
            parts.append(f"## {title}\n" + "\n".join(chosen))
    return "\n\n".join(parts) + "\n"


def insert_claims(page: str, claims: Sequence[Mapping[str, Any]]) -> str:
    """A page with the claims between its two marks written anew."""
    before, rest = page.split(BEGIN)
    return f"{before}{BEGIN}\n{describe_claims(claims)}{END}{rest.split(END)[1]}"


def _published(one: Mapping[str, Any]) -> str:
    relation = "" if one["relation"] == "equal" else f"{one['relation']} "
    return f"{relation}{one['published']:g} {one['unit']}".strip()


def _ours(one: Mapping[str, Any]) -> str:
    if one["ours"] is None:
        return "-"
    error = f" ± {one['sigma']:g}" if one["sigma"] else ""
    return f"{one['ours']:g}{error} {one['unit']}".strip()
