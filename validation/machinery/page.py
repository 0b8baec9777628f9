"""docs/validation.md, written from the records: what is claimed, what was found, and what is not shown."""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from validation.machinery.claims import MEASURED, REFUTED, SHOWN, UNDECIDED, Claim
from validation.machinery.code import ROOT
from validation.machinery.parts import parts_of, proof_names
from validation.machinery.records import FRESH, NO_CHANCE, Record, newest

PAGE = ROOT / "docs" / "validation.md"
IMAGES = ROOT / "docs" / "images"

INTRODUCTION = """\
# Validation
What `lbacal` claims of itself, and what was found when it was tried: on simulated data, by killing its processes, and
on what has been published. `./dev prove NAME` runs a proof, keeps every trial in
[`validation/records`](../validation/records) and writes this page; nothing here is typed by hand.

A claim is decided by the 95 % interval of the figure against what is asked. **Shown**: the whole interval is within
what is asked. **Refuted**: none of it is. **Undecided**: it reaches over the limit, because there were too few trials,
or the data sets had been seen while the code was written. **Measured**: nothing is asked, the figure is stated. Seeds
below 1,000,000 are for debugging, a block of seeds that was recorded once is spent, and nothing is recorded from a
changed tree. n counts independent trials. The rows are the main claims, which each proof names itself (`headlines`);
all others are in the records, and whatever is refuted or undecided, a row or not, is said at the end.
"""
TABLE = ("| claim | asked | found (95 % interval) | n | verdict | command | commit |", "|" + "---|" * 7)
TOLD_BELOW = """\
By part of a proof, refuted claims in full and undecided ones by their names in the record:
"""
LIMITS = """\
- The twin that makes the data is ours. It shares no code with what is tested, but its author has read both: a fault of
  nature of which nobody thought is in no row.
- This code has never calibrated the real instrument beside a lamp: no row compares C with an absolute measurement.
- Rates hold for the stations that were simulated (four to 48 antennas, 150 to 900 events in a year).
"""


def write_page(records: Iterable[Record]) -> str:
    """The page of the newest record of every part."""
    latest = newest(records)
    by_proof: dict[str, list[Record]] = {}
    for proof in proof_names():
        order = list(parts_of(proof))
        own = [record for (name, _), record in latest.items() if name == proof]
        if own:
            by_proof[proof] = sorted(own, key=lambda r: order.index(r.part) if r.part in order else len(order))
    rows = [
        _row(claim, one) for own in by_proof.values() for one in own for claim in one.claims if _is_headline(claim, one)
    ]
    proofs = [_introduce(proof, own) for proof, own in by_proof.items()]
    lines = [INTRODUCTION, *TABLE, *rows, "", "## The proofs", "", *proofs, ""]
    for proof in by_proof:
        images: dict[str, str] = getattr(importlib.import_module(f"validation.{proof}"), "IMAGES", {})
        lines += [
            line for name in images if (IMAGES / name).is_file() for line in (f"![{images[name]}](images/{name})", "")
        ]
    lines += ["## What is not shown", "", LIMITS.rstrip(), "", TOLD_BELOW, *_open_claims(by_proof), ""]
    return "\n".join(lines)


def _introduce(proof: str, records: Sequence[Record]) -> str:
    title = (importlib.import_module(f"validation.{proof}").__doc__ or proof).strip().partition("\n\n")[0]
    hours = sum(record.hours for record in records)
    return f"- `{proof}`: {' '.join(title.split())} ({hours:.2g} hours of one core)"


def _is_headline(claim: Claim, record: Record) -> bool:
    part = parts_of(record.proof).get(record.part)
    return part is not None and claim.key in part.headlines


def _row(claim: Claim, record: Record) -> str:
    verdict = f"**{claim.verdict}**" if claim.verdict not in (SHOWN, MEASURED) else claim.verdict
    if not claim.is_fresh:
        verdict += f" ({record.seeds})"
    cells = (claim.claim, claim.words_asked, claim.words_found, str(claim.n), verdict)
    command, *others = record.commands
    further = f" (further blocks of seeds, in its record: {len(others)})" if others else ""
    return f"| {' | '.join(cells)} | `{command}`{further} | {record.commit} |"


def _open_claims(by_proof: Mapping[str, Sequence[Record]]) -> list[str]:
    """What is not shown: a line a proof and part, its refuted claims in full, its undecided ones by their keys.

    All records on data sets that had been seen share a line.
    """
    lines, seen = [], []
    for record in (one for records in by_proof.values() for one in records):
        if record.seeds not in (FRESH, NO_CHANCE):
            seen.append(record.name)
            continue
        told = [
            f"**refuted** {claim.claim} (asked {claim.words_asked}, found {claim.words_found})"
            for claim in record.claims
            if claim.verdict == REFUTED
        ]
        open_keys: dict[str, list[str]] = {}
        for claim in record.claims:
            if claim.verdict == UNDECIDED:
                open_keys.setdefault(claim.words_asked, []).append(f"`{claim.key}` {claim.words_found}")
        told += [f"undecided, asked {asked}: {', '.join(keys)}" for asked, keys in open_keys.items()]
        if told:
            lines.append(f"- {record.name}: {'; '.join(told)}.")
    if seen:
        lines.append(f"- Undecided whatever the figure, because the data sets had been seen before: {', '.join(seen)}.")
    return lines


def draw_figures(records: Iterable[Record], folder: Path = IMAGES) -> list[Path]:
    """The figures of every proof whose records hold the trials for it: module functions `draw(rows)`.

    Such a function takes the rows of every part by its name and returns a figure by the name of its file.
    """
    latest, written = newest(records), []
    for proof in proof_names():
        draw = getattr(importlib.import_module(f"validation.{proof}"), "draw", None)
        rows = {part: list(record.rows) for (name, part), record in latest.items() if name == proof and record.rows}
        drawn: dict[str, Figure] = draw(rows) if draw and rows else {}
        for name, figure in drawn.items():
            figure.savefig(folder / name, dpi=110, metadata={"Software": None})
            written.append(folder / name)
    return written
