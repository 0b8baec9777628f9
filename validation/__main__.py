"""Run a proof, keep what it found in validation/records and write docs/validation.md anew."""

from __future__ import annotations

import argparse
import importlib
import sys
import tomllib
from collections.abc import Callable
from datetime import date
from functools import partial
from pathlib import Path

from validation.machinery.claims import REFUTED
from validation.machinery.ledger import read_ledger
from validation.machinery.page import draw_figures, renew_page
from validation.machinery.parts import SHARED, parts_of, proof_names
from validation.machinery.quotes import read_quotes, renew_pages
from validation.machinery.records import Record, read_history, read_records, without_result
from validation.machinery.run import Order, RefusedError, run_and_record

STANDING = Path(__file__).with_name("standing.toml")
HELP = """\
Every proof is made of parts; a part draws a data set from each seed of a block. The block is entered in
validation/ledger.jsonl, and the entry committed, before the first trial; started again, an interrupted run goes on.
"""


def main(arguments: list[str]) -> int:
    """Run what is asked; 1 where a claim is refuted, 2 where the run is refused."""
    parser = argparse.ArgumentParser(prog="./dev prove", description=HELP)
    parser.add_argument("name", nargs="?", help="the proof; without it they are listed")
    parser.add_argument("--part", action="append", help="only this part; may be given several times")
    parser.add_argument("--count", type=int, help="seeds of each part")
    parser.add_argument("--workers", type=int, default=2, help="processes beside each other (2)")
    parser.add_argument("--scratch", action="store_true", help="enter and record nothing, on seeds for debugging")
    parser.add_argument("--first", type=int, default=0, help="with --scratch: the first seed, or one that was entered")
    parser.add_argument(
        "--standing",
        metavar="DATE",
        type=_day,
        help="run the parts of validation/standing.toml of which no block entered since that day has a result",
    )
    parser.add_argument("--page", action="store_true", help="write docs/validation.md and the figures of texts anew")
    parser.add_argument("--mended", default="", help="what was mended since the last block: the record begins anew")
    chosen = parser.parse_args(arguments)
    if chosen.first and not chosen.scratch:
        parser.error("seeds of a recorded run follow from the ledger: leave out --first, or say --scratch")
    if chosen.mended and (chosen.scratch or chosen.name is None):
        parser.error("--mended begins the record of a proof anew: name it, and leave out --scratch")
    if chosen.name is None and not (chosen.page or chosen.standing):
        return _list_proofs()
    verdicts: list[str] = []
    steps: list[Callable[[], None]] = [lambda: _prove(chosen, verdicts)] * bool(chosen.name)
    if chosen.standing:
        for name, part, count in standing_since(chosen.standing):
            one = argparse.Namespace(**vars(chosen) | {"name": name, "part": [part], "count": count})
            steps.append(partial(_prove, one, verdicts))
    steps += [_write_pages] * (not chosen.scratch)  # what was recorded before a part was refused stands in the page
    code = 0
    for step in steps:
        try:
            step()
        except (RefusedError, ValueError) as error:
            print(f"./dev prove: {error}", file=sys.stderr)
            code = 2
    return code or int(REFUTED in verdicts)


def read_standing() -> dict[str, dict[str, int]]:
    return tomllib.loads(STANDING.read_text(encoding="utf-8"))


def standing_since(day: str) -> list[tuple[str, str, int]]:
    """Proof, part and count of the standing validation where no block entered since a day has a result."""
    entries = [entry for entry in read_ledger() if entry.entered_at >= day]
    lost = without_result([*read_records(), *read_history()], entries)
    held = {(entry.proof, entry.part) for entry in entries if entry not in lost}
    return [
        (proof, part, count)
        for proof, counts in read_standing().items()
        for part, count in counts.items()
        if (proof, part) not in held
    ]


def _day(text: str) -> str:
    try:
        return f"{date.fromisoformat(text)}"
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected a day as YYYY-MM-DD, got {text}") from None


def _list_proofs() -> int:
    for name in proof_names():
        title = (importlib.import_module(f"validation.{name}").__doc__ or "").partition("\n\n")[0]
        print(f"{name:14} {', '.join(parts_of(name))}\n    {' '.join(title.split())}")
    return 0


def _prove(chosen: argparse.Namespace, verdicts: list[str]) -> None:
    if chosen.name not in proof_names():
        raise RefusedError(f"no proof {chosen.name}; there are {', '.join(proof_names())}")
    parts = parts_of(chosen.name)
    unknown = set(chosen.part or []) - set(parts)
    if unknown:
        raise RefusedError(f"{chosen.name} has no part {', '.join(sorted(unknown))}; it has {', '.join(parts)}")
    order = Order(chosen.count, chosen.workers, chosen.scratch, chosen.first, chosen.mended)
    for name in chosen.part or parts:
        if parts[name].needs_shared and not SHARED.is_dir() and not chosen.part:
            print(
                f"{chosen.name} {name} is left out: it needs the folder ../shared beside the project", file=sys.stderr
            )
            continue
        record = run_and_record(chosen.name, parts[name], order)
        print("\n".join([*_told(record, chosen.scratch), *parts[name].tell(record.rows), ""]), flush=True)
        verdicts += [claim.verdict for claim in record.claims if not chosen.scratch]


def _told(record: Record, is_scratch: bool) -> list[str]:
    standing = "scratch: decides nothing" if is_scratch else f"block {record.look} of its part"
    seeds = f"{sum(block.count for block in record.blocks)} trials, {standing}"
    lines = [f"{record.name} at {record.commit}: {seeds}, {record.hours:.3g} h of one core"]
    return lines + [
        f"  {claim.verdict:9} {claim.asked.says}: {claim.words_found}, asked {claim.words_asked}"
        for claim in record.claims
    ]


def _write_pages() -> None:
    records = read_records()
    draw_figures(records)
    renew_page()
    for path, text in renew_pages(read_quotes(), records).items():
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
