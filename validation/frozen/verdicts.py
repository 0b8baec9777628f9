"""What the finder says of the frozen data sets, in one word: records hold while it stays."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from validation.frozen.comparison import read_numbers

NUMBERS = Path(__file__).parent / "numbers"


def verdict_of(numbers: Mapping[str, Any]) -> list[Any]:
    """Verdict, and the sets of names of the findings in their order."""
    report = numbers["report"]
    return [report["verdict"], [sorted([one["cause"], *one["indistinguishable"]]) for one in report["findings"]]]


def digest_of(verdicts: Mapping[str, list[Any]]) -> str:
    """Twelve digits of the SHA-256 of the verdict of every data set."""
    return hashlib.sha256(json.dumps(verdicts, sort_keys=True).encode()).hexdigest()[:12]


@cache
def frozen_digest(folder: Path = NUMBERS) -> str:
    """The digest of the numbers that are stored, which the suite compares with what the code gives."""
    return digest_of({path.name: verdict_of(read_numbers(path)) for path in folder.glob("*.json.gz")})
