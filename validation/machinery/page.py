"""docs/validation.md, written from the records: what is claimed, what was found, and what is not shown."""

from __future__ import annotations

import importlib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from validation.machinery import code
from validation.machinery.claims import MEASURED, REFUTED, SHOWN, UNDECIDED, Claim
from validation.machinery.ledger import Entry, read_ledger
from validation.machinery.parts import parts_of, proof_names
from validation.machinery.records import Record, name_of, read_history, read_records, without_result

PAGE = "docs/validation.md"
IMAGES = code.ROOT / "docs" / "images"

INTRODUCTION = """\
# Validation
What `lbacal` claims of itself, and what was found. `./dev prove NAME` runs a proof, keeps what it gave in
[`validation/records`](../validation/records) and writes this page; sentences and limits stand in
[`claims.toml`](../validation/claims.toml).

The interval of a figure decides ([how](explanation/how-discovery-is-proven.md#when-a-claim-is-shown)). **Shown**: all
of it is within what is asked. **Refuted**: none is. **Undecided**: it reaches over the limit. n counts independent
trials and, in brackets, how often seeds were entered in the [ledger](../validation/ledger.jsonl), whatever became of
them. A record is old (†) where the finder says of the [frozen data sets](../validation/frozen) something else since.
The rows are main claims.
"""
TABLE = ("| claim | asked | found (interval) | n | verdict | proof |", "|" + "---|" * 6)
OPEN = "Undecided claims (their records have sentence, limit and interval): "
LIMITS = """\
- The twin that makes the data is ours. It shares no code with what is tested, but its author has read both: a fault of
  nature that nobody thought of is in none.
- This code has never calibrated the real instrument beside a reference source: no row compares C with an absolute
  measurement.
- Rates hold for the stations that were simulated (four to 48 antennas, 150 to 900 events in a year).
"""


def write_page(records: Iterable[Record], history: Sequence[Record], entries: Sequence[Entry]) -> str:
    """The page of the record of every part, of those before it, and of the ledger."""
    by_proof: dict[str, list[Record]] = {}
    for proof in proof_names():
        order = list(parts_of(proof))
        own = [record for record in records if record.proof == proof]
        if own:
            by_proof[proof] = sorted(own, key=lambda r: order.index(r.part) if r.part in order else len(order))
    rows = [
        _row(claim, one, history, entries)
        for own in by_proof.values()
        for one in own
        for claim in one.claims
        if _is_headline(claim, one)
    ]
    hours = sum(record.hours for own in by_proof.values() for record in own)
    lines = [INTRODUCTION, *TABLE, *rows, "", f"`./dev prove` lists the proofs: {hours:.0f} hours of one core.", ""]
    for proof in by_proof:
        images: dict[str, str] = getattr(importlib.import_module(f"validation.{proof}"), "IMAGES", {})
        lines += [
            line for name in images if (IMAGES / name).is_file() for line in (f"![{images[name]}](images/{name})", "")
        ]
    lines += ["## What is not shown", "", LIMITS.rstrip(), "", *_open_claims(by_proof), ""]
    lines += _tell_refuted_before(by_proof, history)
    lines += ["## Entered, no result", "", *_tell_blocks(without_result([*records, *history], entries)), ""]
    return "\n".join(lines)


def renew_page() -> Path:
    """Write the page anew, from the records and the ledger as they are now; its path."""
    path: Path = code.ROOT / PAGE
    path.parent.mkdir(exist_ok=True)
    path.write_text(write_page(read_records(), read_history(), read_ledger()), encoding="utf-8")
    return path


def _tell_refuted_before(by_proof: Mapping[str, Sequence[Record]], history: Sequence[Record]) -> list[str]:
    """What the record before refuted and this one does not, with what was mended between them."""
    lines = []
    for record in (one for own in by_proof.values() for one in own):
        before = [claim for one in [one for one in history if one.name == record.name][-1:] for claim in one.claims]
        now = {claim.key for claim in record.claims if claim.verdict != REFUTED}
        refuted = [claim for claim in before if claim.verdict == REFUTED and claim.key in now]
        told = "; ".join(f"`{claim.key}` {claim.words_found} of {claim.n}" for claim in refuted)
        if told:
            lines.append(f"- {record.name}: {told}.{f' Mended since: {record.mended}.' * bool(record.mended)}")
    return ["## Refuted by the record before", "", *lines, ""] if lines else []


def _tell_blocks(entries: Iterable[Entry]) -> list[str]:
    """Every part that has blocks without a result, and how many; the ledger has seeds, dates and commits."""
    blocks = Counter(name_of(one.proof, one.part) for one in entries)
    told = "; ".join(name if count == 1 else f"{name} ({count} blocks)" for name, count in blocks.items())
    return [f"The ledger has the seeds: {told}."] if told else []


def _is_headline(claim: Claim, record: Record) -> bool:
    part = parts_of(record.proof).get(record.part)
    return part is not None and claim.key in part.headlines


def _row(claim: Claim, record: Record, history: Sequence[Record], entries: Sequence[Entry]) -> str:
    verdict = f"**{claim.verdict}**" if claim.verdict not in (SHOWN, MEASURED) else claim.verdict
    verdict += tell_change(claim, record, history)
    blocks = sum((one.proof, one.part) == (record.proof, record.part) for one in entries)
    proof = f"`{record.proof if record.part == record.proof else f'{record.proof} {record.part}'}`"
    n, where = f"{claim.n} ({blocks})", proof if record.holds else f"{proof}†"
    return f"| {claim.asked.says} | {claim.words_asked} | {claim.words_found} | {n} | {verdict} | {where} |"


def tell_change(claim: Claim, record: Record, history: Sequence[Record]) -> str:
    """Describe the limit of the same claim before, if it had been refuted; empty where nothing was."""
    told = [claim.asked.changed] if claim.asked.changed else []
    earlier = [
        (one.made_at, other)
        for one in history
        if (one.proof, one.part) == (record.proof, record.part)
        for other in one.claims
        if other.key == claim.key and other.words_asked != claim.words_asked and other.verdict == REFUTED
    ]
    if earlier:
        made_at, other = max(earlier, key=lambda one: one[0])
        told.append(f"limit changed after {made_at[:10]}, when {other.words_asked} was *refuted*")
    return "".join(f"; {one}" for one in told)


def _open_claims(by_proof: Mapping[str, Sequence[Record]]) -> list[str]:
    """What is not shown: a line a part with its refuted claims, then the number of its other undecided ones."""
    refuted, undecided = [], []
    for record in (one for records in by_proof.values() for one in records):
        against = [claim for claim in record.claims if claim.verdict == REFUTED]
        told = [
            f"{_without_beginning(claim, before)} (asked {claim.words_asked}, found {claim.words_found})"
            for claim, before in zip(against, [None, *against], strict=False)
        ]
        if told:
            refuted.append(f"- {record.name}: **refuted** {'; '.join(told)}.")
        more = sum(claim.verdict == UNDECIDED and not _is_headline(claim, record) for claim in record.claims)
        if more:
            undecided.append(record.name if more == 1 else f"{record.name} ({more})")
    return [*refuted, "", f"{OPEN}{'; '.join(undecided)}."] if undecided else refuted


def _without_beginning(claim: Claim, before: Claim | None) -> str:
    """The sentence of a claim; without its words before a colon where the claim before began with the same."""
    beginning, colon, rest = claim.asked.says.partition(": ")
    is_same = bool(colon) and before is not None and before.asked.says.startswith(f"{beginning}: ")
    return rest if is_same else claim.asked.says


def draw_figures(records: Iterable[Record], folder: Path = IMAGES) -> list[Path]:
    """The figures of every proof whose records hold the trials for it: module functions `draw(rows)`.

    Such a function takes the rows of every part by its name and returns a figure by the name of its file.
    """
    records, written = list(records), list[Path]()
    for proof in proof_names():
        draw = getattr(importlib.import_module(f"validation.{proof}"), "draw", None)
        rows = {record.part: list(record.rows) for record in records if record.proof == proof and record.rows}
        drawn: dict[str, Figure] = draw(rows) if draw and rows else {}
        for name, figure in drawn.items():
            figure.savefig(folder / name, dpi=110, metadata={"Software": None})
            written.append(folder / name)
    return written
