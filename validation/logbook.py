"""Faults that really happened, and who can say them: `logbook.toml` as a page of the docs.

python -m validation.logbook writes docs/logbook.md anew.
"""

from __future__ import annotations

import tomllib
from collections import Counter
from pathlib import Path
from typing import Any

from lbacal_core.causes.grammar import as_equation, in_words, sentence
from validation.machinery.tables import write_table

PAGE = Path(__file__).parents[1] / "docs" / "logbook.md"
SAID_BY = {
    "catalogue": "a cause of the catalogue",
    "grammar": "a sentence",
    "audit": "the audit",
    "input": "nobody: it is told",
    "nobody": "nobody",
}


def read_logbook() -> list[dict[str, Any]]:
    """The faults, in the order of the file."""
    faults: list[dict[str, Any]] = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))[
        "fault"
    ]
    return faults


def who_says(fault: dict[str, Any]) -> str:
    """Who can say a fault, and how; or why nobody can."""
    if fault["by"] == "catalogue":
        return f"`{fault['cause']}`"
    if fault["by"] == "grammar":
        template = sentence(fault["place"], tuple(fault["law"]), tuple(fault["course"]))
        return f"{in_words(template)}: {as_equation(template)}"
    return str(fault.get("why", SAID_BY[fault["by"]]))


def describe_logbook() -> str:
    """The page."""
    faults = read_logbook()
    counts = Counter(fault["by"] for fault in faults)
    said = ", ".join(f"{counts[key]} by {words}" for key, words in SAID_BY.items())
    rows = [
        [fault["when"], f"[{fault['instrument']}]({fault['source']})", fault["seen"], fault["was"], who_says(fault)]
        for fault in faults
    ]
    return "\n".join(
        [
            "# Logbook: faults that really happened",
            "",
            f"{len(faults)} faults of antennas and arrays like those here, from public logs: {said}.",
            "What nobody can say must be declined. A sentence names place, law along frequency and course in time",
            "([how](explanation/what-the-simulation-gets-wrong.md)).",
            "",
            *write_table(["when", "where", "seen", "was", "who says it, and how"], rows),
            "",
        ]
    )


if __name__ == "__main__":
    PAGE.write_text(describe_logbook(), encoding="utf-8")
