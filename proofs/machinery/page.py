"""docs/validation.md, written from the records: what is claimed, what was found, and what is not shown."""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from proofs.machinery.claims import REFUTED, SHOWN, UNDECIDED, Claim
from proofs.machinery.code import ROOT
from proofs.machinery.parts import parts_of, proof_names
from proofs.machinery.records import FRESH, NO_CHANCE, Record, newest

PAGE = ROOT / "docs" / "validation.md"
IMAGES = ROOT / "docs" / "images"

INTRODUCTION = """\
# Validation
What `lbacal` claims of itself, and what was found when it was tried: on simulated data, by killing its processes, and
on what has been published. `./dev prove NAME` runs a proof, keeps every trial in
[`proofs/records`](../proofs/records) and writes this page; nothing here is typed by hand.

A claim is decided by the 95 % interval of the figure against what is asked. **Shown**: the whole interval is within
what is asked. **Refuted**: none of it is. **Undecided**: it reaches over the limit, because there were too few trials,
or the data sets had been seen while the code was written. Seeds below 1,000,000 are for debugging, a block of seeds
that was recorded once is spent, and nothing is recorded from a changed tree. n counts independent trials. The rows are
the main claims; all others are in the records, and whatever is refuted or undecided, a row or not, is said at the end.
"""
LIMITS = """\
- The twin that makes the data is ours. It shares no code with what is tested, but its author has read both: a fault of
  nature of which nobody thought is in no row.
- This code has never calibrated the real instrument beside a lamp: no row compares C with an absolute measurement.
- Rates hold for the stations that were simulated (four to ten antennas, 150 to 250 events in a year).
"""


def write_page(records: Iterable[Record]) -> str:
    """The page of the newest record of every part."""
    latest = newest(records)
    lines = [INTRODUCTION]
    for proof in proof_names():
        chosen = [record for (name, _), record in latest.items() if name == proof]
        if chosen:
            lines += _section(proof, chosen)
    lines += ["## What is not shown", "", LIMITS.rstrip(), *_open_claims(latest.values()), ""]
    return "\n".join(lines)


def _section(proof: str, records: Sequence[Record]) -> list[str]:
    module = importlib.import_module(f"proofs.{proof}")
    order = [part.name for part in module.PARTS]
    title = (module.__doc__ or proof).strip().partition("\n\n")[0]
    lines = [f"## {proof}", "", " ".join(title.split()), ""]
    lines += ["| claim | asked | found (95 % interval) | n | verdict | command | commit |", "|" + "---|" * 7]
    for record in sorted(records, key=lambda r: order.index(r.part) if r.part in order else len(order)):
        lines += [_row(claim, record) for claim in record.claims if _is_headline(claim, record)]
    images = [name for name in getattr(module, "IMAGES", {}) if (IMAGES / name).is_file()]
    lines += [line for name in images for line in ("", f"![{module.IMAGES[name]}](images/{name})")]
    hours = sum(record.hours for record in records)
    lines += ["", f"{hours:.2g} hours of one core.", ""]
    return lines


def _is_headline(claim: Claim, record: Record) -> bool:
    headlines = parts_of(record.proof)[record.part].headlines
    return headlines is None or claim.key in headlines


def _row(claim: Claim, record: Record) -> str:
    verdict = f"**{claim.verdict}**" if claim.verdict != SHOWN else claim.verdict
    if not claim.is_fresh:
        verdict += f" ({record.seeds})"
    cells = (claim.claim, claim.words_asked, claim.words_found, str(claim.n), verdict)
    return f"| {' | '.join(cells)} | `{record.command}` | {record.commit} |"


def _open_claims(records: Iterable[Record]) -> list[str]:
    """What is not shown: one line a refuted claim or an undecided row, one a record for its other undecided claims.

    All records on data sets that had been seen share a line.
    """
    lines, seen = [], []
    for record in sorted(records, key=lambda r: r.name):
        if record.seeds not in (FRESH, NO_CHANCE):
            seen.append(record.name)
            continue
        details = []
        for claim in record.claims:
            if claim.verdict == REFUTED or (claim.verdict == UNDECIDED and _is_headline(claim, record)):
                found = f"Asked {claim.words_asked}, found {claim.words_found}"
                lines.append(f"- {claim.verdict.capitalize()}: {claim.claim}. {found} ({record.name}).")
            elif claim.verdict == UNDECIDED:
                details.append(f"{claim.claim} (asked {claim.words_asked}, found {claim.words_found})")
        if details:
            lines.append(f"- Undecided in {record.name}: {'; '.join(details)}.")
    if seen:
        lines.append(f"- Undecided whatever the figure, because the data sets had been seen before: {', '.join(seen)}.")
    return lines


def draw_figures(records: Iterable[Record], folder: Path = IMAGES) -> list[Path]:
    """The figures of every proof whose records hold the trials for it: module functions `draw(rows)`.

    Such a function takes the rows of every part by its name and returns a figure by the name of its file.
    """
    latest, written = newest(records), []
    for proof in proof_names():
        draw = getattr(importlib.import_module(f"proofs.{proof}"), "draw", None)
        rows = {part: list(record.rows) for (name, part), record in latest.items() if name == proof and record.rows}
        drawn: dict[str, Figure] = draw(rows) if draw and rows else {}
        for name, figure in drawn.items():
            figure.savefig(folder / name, dpi=110, metadata={"Software": None})
            written.append(folder / name)
    return written
