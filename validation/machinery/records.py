"""What was measured: `validation/records/NAME.json` for each part of a proof; earlier ones are lines of a history."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from validation.frozen.comparison import frozen_digest
from validation.machinery.claims import Asked, Claim, decide, read_claims
from validation.machinery.ledger import Block, Entry, joined
from validation.machinery.parts import Part, Row, parts_of

RECORDS = Path(__file__).parents[1] / "records"
HISTORY = Path(__file__).parents[1] / "history.jsonl"


@dataclass(frozen=True)
class Record:
    """The results of one part of a proof at one state of the code.

    Attributes
    ----------
    made_at
        ISO 8601, UTC.
    frozen
        Digest of what the finder says of the frozen data sets: the record holds while it stays.
    look
        How many blocks of the part had been entered when its claims were decided; 1 where there is no chance.
    hours
        Processor time of all trials together; of blocks entered before 22 h of 2026-11-29 by the clock.
    rows
        The trials, where another block may join them, or the docs are made from them.
    mended
        What was mended in the code since the record before, where it does not go on with that.
    """

    proof: str
    part: str
    commit: str
    made_at: str
    frozen: str
    look: int
    blocks: tuple[Block, ...]
    hours: float
    claims: tuple[Claim, ...]
    rows: tuple[Row, ...] = field(default=(), repr=False)
    mended: str = ""

    @property
    def name(self) -> str:
        """Proof and part."""
        return name_of(self.proof, self.part)

    @property
    def holds(self) -> bool:
        """Whether the finder says of the frozen data sets what it said then."""
        return self.frozen == frozen_digest()

    def claim(self, key: str) -> Claim:
        """One of its claims."""
        return next(claim for claim in self.claims if claim.key == key)

    @property
    def summary(self) -> dict[str, Any]:
        """All but the trials, as stored."""
        return {
            "proof": self.proof, "part": self.part, "commit": self.commit, "made_at": self.made_at,
            "frozen": self.frozen, "look": self.look, "blocks": [[block.first, block.count] for block in self.blocks],
            "hours": round(self.hours, 4), **({"mended": self.mended} if self.mended else {}),
            "claims": [claim.as_dict() for claim in self.claims],
        }  # fmt: skip

    def write(self) -> Path:
        """Write it, a claim and a trial a line, in the place of an earlier one."""
        lines = []
        for name, value in {**self.summary, "rows": self.rows}.items():
            if name in ("claims", "rows") and value:
                items = (json.dumps(one, ensure_ascii=False, separators=(",", ":")) for one in value)
                lines.append(f'"{name}": [\n' + ",\n".join(items) + "\n]")
            else:
                lines.append(f'"{name}": {json.dumps(value, ensure_ascii=False)}')
        RECORDS.mkdir(exist_ok=True)
        path = path_of(self.proof, self.part)
        path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
        return path


def name_of(proof: str, part: str) -> str:
    return proof if part == proof else f"{proof}-{part}"


def path_of(proof: str, part: str) -> Path:
    return RECORDS / f"{name_of(proof, part)}.json"


def _from_dict(stored: dict[str, Any]) -> Record:
    claims = tuple(Claim.from_dict(claim) for claim in stored.pop("claims"))
    blocks = tuple(Block(*block) for block in stored.pop("blocks"))
    return Record(**stored | {"claims": claims, "blocks": blocks, "rows": tuple(stored.get("rows", ()))})


def read_record(path: Path) -> Record:
    return _from_dict(json.loads(path.read_text(encoding="utf-8")))


def read_records() -> list[Record]:
    """The record of every part that has one, oldest first."""
    return sorted(map(read_record, RECORDS.glob("*.json")), key=lambda record: (record.made_at, record.name))


def read_history() -> list[Record]:
    """Records that others took the place of, without their trials, in the order in which they were replaced."""
    lines = HISTORY.read_text(encoding="utf-8").splitlines() if HISTORY.is_file() else []
    return [_from_dict(json.loads(line)) for line in lines]


def enter_into_history(record: Record) -> None:
    """Keep a line of a record that another takes the place of."""
    with HISTORY.open("a", encoding="utf-8") as file:
        file.write(json.dumps(record.summary, ensure_ascii=False) + "\n")


def asked_of(proof: str, part: str) -> dict[str, Asked]:
    """The claims of a part by their keys."""
    return read_claims().get(proof, {}).get(part, {})


def claims_of(proof: str, part: str, rows: Sequence[Row], look: int = 1) -> tuple[Claim, ...]:
    """Judge trials of a part at its k-th look."""
    return decide(parts_of(proof)[part].judge(rows), asked_of(proof, part), look)


def verdicts_of(proof: str, part: str, rows: Sequence[Row]) -> dict[str, str]:
    """The verdict of every claim at a first look."""
    return {claim.key: claim.verdict for claim in claims_of(proof, part, rows)}


def take_in(record: Record, part: Part, rows: Sequence[Row]) -> Record:
    """Write what a block gave: pooled with the trials on record if these hold, else in the place of the record.

    They do not where the block says that something was mended since.

    Trials stay where another block may join them, or the docs are made from them.
    """
    path = path_of(record.proof, record.part)
    earlier = read_record(path) if path.is_file() else None
    is_same_code = earlier is not None and earlier.holds and not record.mended
    if earlier and is_same_code and part.has_chance and earlier.rows and earlier.rows[0].keys() == rows[0].keys():
        rows = sorted([*earlier.rows, *rows], key=lambda row: row["seed"])
        blocks, hours = joined([*earlier.blocks, *record.blocks]), earlier.hours + record.hours
        record = replace(record, blocks=blocks, hours=hours, mended=earlier.mended)
    elif earlier:
        enter_into_history(earlier)
    claims = decide(part.judge(rows), asked_of(record.proof, record.part), record.look)
    whole = replace(record, claims=claims, rows=tuple(rows))
    (whole if part.has_chance or part.has_figure else replace(whole, rows=())).write()
    return whole


def without_result(records: Sequence[Record], entries: Iterable[Entry]) -> list[Entry]:
    """Blocks that were entered and of which no record, past or present, holds the result."""

    def is_held(entry: Entry) -> bool:
        own = [record for record in records if (record.proof, record.part) == (entry.proof, entry.part)]
        return entry.is_held((block for one in own for block in one.blocks), {one.commit for one in own})

    return [entry for entry in entries if not is_held(entry)]
