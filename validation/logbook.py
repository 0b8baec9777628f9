"""Faults that really happened, and who can say them: `logbook.toml` as a page of the docs.

python -m validation.logbook writes docs/logbook.md anew.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from lbacal_core.causes.grammar import in_words, sentence

PAGE = Path(__file__).parents[1] / "docs" / "logbook.md"
SAID_BY = {
    "catalogue": "By a cause of the catalogue",
    "grammar": "By a sentence",
    "audit": "By the audit",
    "input": "By nobody, because it is an input",
    "nobody": "By nobody",
}


def read_logbook() -> list[dict[str, Any]]:
    """The faults, in the order of the file."""
    faults: list[dict[str, Any]] = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))[
        "fault"
    ]
    return faults


def who_says(fault: dict[str, Any]) -> str:
    """How a fault is found, or why nobody can find it; empty for the audit, whose checks have names of their own."""
    if fault["by"] == "catalogue":
        return f"`{fault['cause']}`"
    if fault["by"] == "grammar":
        return in_words(sentence(fault["place"], tuple(fault["law"]), tuple(fault["course"])))
    return str(fault.get("why", ""))


def describe_logbook() -> str:
    """Write the page as text."""
    faults = read_logbook()
    lines = [
        "# Which faults that really happened can be found?",
        f"{len(faults)} faults of antennas and arrays like those here, from public logs. A sentence names [place, law",
        "along frequency and course in time](explanation/what-the-simulation-gets-wrong.md#what-no-catalogue-lists).",
    ]
    for key, title in SAID_BY.items():
        own = [fault for fault in faults if fault["by"] == key]
        lines += ["", f"## {title}: {len(own)}", *map(_describe, own)]
    return "\n".join([*lines, ""])


def _describe(fault: dict[str, Any]) -> str:
    how = who_says(fault)
    seen = f"- {fault['when']}, [{fault['instrument']}]({fault['source']}): {fault['seen']}"
    return f"{seen}. *Cause:* {fault['was']}.{f' *Here:* {how}.' if how else ''}"


if __name__ == "__main__":
    PAGE.write_text(describe_logbook(), encoding="utf-8")
