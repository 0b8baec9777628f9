"""What was measured, for good: one file `validation/records/NAME-COMMIT.json` for a part of a proof and a commit."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from validation.machinery.claims import Claim
from validation.machinery.parts import Part, Row
from validation.machinery.seeds import Block, joined

RECORDS = Path(__file__).parents[1] / "records"
LOOKED_AT = RECORDS / "looked_at.json"
FRESH, REPETITION, SEEN, NO_CHANCE = "fresh", "repetition", "seen before", "no chance"
"""Standing of data sets: never seen before; those of an earlier record; used while the code was written; not drawn."""


@dataclass(frozen=True)
class Record:
    """What one part of a proof gave at one state of the code.

    Attributes
    ----------
    made_at
        ISO 8601, UTC.
    code
        Digest of the code; empty for records that were made before there were digests.
    seeds
        Whether the data sets were fresh.
    hours
        Time of all trials together, each on one core.
    remark
        What else a reader has to know.
    """

    proof: str
    part: str
    commit: str
    made_at: str
    code: str
    blocks: tuple[Block, ...]
    seeds: str
    hours: float
    claims: tuple[Claim, ...]
    rows: tuple[Row, ...] = field(default=(), repr=False)
    remark: str = ""

    @property
    def name(self) -> str:
        """Proof and part."""
        return self.proof if self.part == self.proof else f"{self.proof}-{self.part}"

    @property
    def file_name(self) -> str:
        """The file it is kept in."""
        return f"{self.name}-{self.commit}{'-repetition' if self.seeds == REPETITION else ''}.json"

    @property
    def commands(self) -> tuple[str, ...]:
        """What repeats it, a block of seeds each."""
        command = f"./dev prove {self.proof}" + ("" if self.part == self.proof else f" --part {self.part}")
        if not self.blocks or self.seeds == NO_CHANCE or not self.code:
            return (command,)
        return tuple(f"{command} --first {block.first} --count {block.count}" for block in self.blocks)

    def claim(self, key: str) -> Claim:
        """One of its claims."""
        return next(claim for claim in self.claims if claim.key == key)

    def write(self, folder: Path = RECORDS) -> Path:
        """Write the file, one row a line."""
        head: dict[str, Any] = {
            "proof": self.proof, "part": self.part, "commit": self.commit, "made_at": self.made_at,
            "code": self.code, "blocks": [[block.first, block.count] for block in self.blocks],
            "seeds": self.seeds, "hours": round(self.hours, 4), "remark": self.remark,
        }  # fmt: skip
        lines = [f'"{name}": {json.dumps(value, ensure_ascii=False)}' for name, value in head.items()]
        for name, values in (("claims", [claim.as_dict() for claim in self.claims]), ("rows", self.rows)):
            items = ",\n".join(json.dumps(value, ensure_ascii=False, separators=(",", ":")) for value in values)
            lines.append(f'"{name}": [\n{items}\n]' if items else f'"{name}": []')
        folder.mkdir(exist_ok=True)
        path = folder / self.file_name
        path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
        return path


def read_record(path: Path) -> Record:
    """Read a file."""
    stored = json.loads(path.read_text(encoding="utf-8"))
    claims = tuple(Claim.from_dict(claim) for claim in stored.pop("claims"))
    blocks = tuple(Block(*block) for block in stored.pop("blocks"))
    return Record(**stored | {"claims": claims, "blocks": blocks, "rows": tuple(stored["rows"])})


def read_records(folder: Path = RECORDS) -> list[Record]:
    """Every record, oldest first."""
    paths = [path for path in folder.glob("*.json") if path.name != LOOKED_AT.name]
    return sorted((read_record(path) for path in paths), key=lambda record: (record.made_at, record.name))


def of_part(records: Iterable[Record], proof: str, part: str) -> list[Record]:
    """The records of one part of a proof."""
    return [record for record in records if (record.proof, record.part) == (proof, part)]


def make_claims(part: Part, rows: Sequence[Row], seeds: str) -> tuple[Claim, ...]:
    """What rows show, as far as the data sets may show anything."""
    claims = part.judge(rows)
    return tuple(claim if seeds in (FRESH, NO_CHANCE) else claim.seen_before() for claim in claims)


def pool(records: Sequence[Record], part: Part) -> Record:
    """One record of several that were made with the same code; hours are summed and the claims judged again.

    Raises ValueError where the code differs or a seed is in two of them.
    """
    first, last = records[0], max(records, key=lambda record: record.made_at)
    if any((r.proof, r.part, r.code) != (first.proof, first.part, first.code) for r in records) or not first.code:
        raise ValueError(f"records of {first.name} are of different code and cannot be pooled")
    if len({record.seeds for record in records}) > 1:
        raise ValueError(f"records of {first.name} with fresh and with other seeds cannot be pooled")
    blocks = joined(block for record in records for block in record.blocks)
    rows = tuple(sorted((row for record in records for row in record.rows), key=lambda row: row["seed"]))
    claims = make_claims(part, rows, last.seeds)
    return replace(last, blocks=blocks, rows=rows, hours=sum(r.hours for r in records), claims=claims)


def newest(records: Iterable[Record]) -> dict[tuple[str, str], Record]:
    """The record of every part of every proof that counts: the newest that may decide, else the newest."""
    return {
        (record.proof, record.part): record
        for record in sorted(records, key=lambda r: (r.seeds in (FRESH, NO_CHANCE), r.made_at))
    }
