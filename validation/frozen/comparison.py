"""Frozen numbers: how they are stored, their differences by JSON path, and what they say in one word.

Records hold while the finder says of the frozen data sets what it said when they were made: while that word stays.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

NUMBERS = Path(__file__).parent / "numbers"
RELATIVE = 1e-4
"""Largest difference of two numbers over the larger of them: kernels of linear algebra move some by 2e-5."""
OF_SIGMA = 1e-3
"""Largest difference of what has a standard deviation, in units of it: a finding, and a score or significance."""
ABSOLUTE = 1e-9
"""Differences below this are none: probabilities so small are held by their significance, sums cancel to this."""
WIDER = (("report/hypotheses/", 1e-2), ("/size$", 1e-2), ("p_value$", 5e-2), ("/(seen|mean_ln_sigma|trials)$", 2e-2))
"""Places whose relative difference may be larger. Fits of causes that an LST curve does not name stop at 1e-8 of chi^2,
where sizes are loose (4e-3 seen), as are sizes in a scan; a probability moves by z times what its z moves; a template
at the limit of what free parameters leave is counted or not."""
SIGMAS = re.compile("_sigma$|^scan/.*/(sum|square|largest)$")
"""Places of numbers in units of a standard deviation."""
PROSE = {"confirm", "description", "note", "sentence", "why", "would_decide"}
"""Fields of a report that are sentences: words may change while every number stays."""
DIGITS = 12
"""Significant digits that are stored."""


@dataclass(frozen=True)
class Difference:
    """One value that differs, at a place such as ``report/findings/0/size/value``; absent values are `ABSENT`."""

    data_set: str
    path: str
    before: Any
    after: Any

    @property
    def relative(self) -> float:
        """The difference of two numbers over the larger; infinite for anything else."""
        if not (_is_number(self.before) and _is_number(self.after)):
            return float("inf")
        return float(abs(self.after - self.before) / max(abs(self.before), abs(self.after)))

    def __str__(self) -> str:
        size = f" ({self.relative:.1e})" if self.relative < float("inf") else ""
        return f"{self.data_set}: {self.path}: {_short(self.before)} -> {_short(self.after)}{size}"


ABSENT = "(absent)"


def list_differences(data_set: str, before: Any, after: Any) -> list[Difference]:
    """Every place where two JSON values differ; numbers beyond their tolerance, anything else at all."""
    old, new = ({path: (value, share) for path, value, share in _leaves(one)} for one in (before, after))
    found = []
    for path in old | new:
        (was, share), (now, _) = old.get(path, (ABSENT, 0.0)), new.get(path, (ABSENT, 0.0))
        if _differ(was, now, path, share):
            found.append(Difference(data_set, path, was, now))
    return found


def summarise(differences: Iterable[Difference]) -> list[str]:
    """One line for each kind of place (numbers in paths replaced by `*`): how many, the largest, in which data sets."""
    kinds: dict[str, list[Difference]] = defaultdict(list)
    for one in differences:
        kinds[re.sub(r"(?<=/)\d+(?=/|$)", "*", one.path)].append(one)
    lines = []
    for kind, here in sorted(kinds.items()):
        names = list(dict.fromkeys(one.data_set for one in here))
        largest = max(one.relative for one in here)
        shown = ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
        lines.append(f"{kind}: {len(here)}, largest {largest:.1e}, in {shown}")
    return lines


def write_numbers(path: Path, numbers: Mapping[str, Any]) -> None:
    """Store JSON values compressed, the same bytes for the same values."""
    text = json.dumps(_rounded(numbers), sort_keys=True, separators=(",", ":"), allow_nan=False)
    path.write_bytes(gzip.compress(text.encode(), mtime=0))


def read_numbers(path: Path) -> dict[str, Any]:
    numbers: dict[str, Any] = json.loads(gzip.decompress(path.read_bytes()))
    return numbers


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, Mapping):
        return {key: _rounded(one) for key, one in value.items()}
    return [_rounded(one) for one in value] if isinstance(value, (list, tuple)) else value


def _leaves(value: Any, path: str = "", share: float = 0.0) -> Iterator[tuple[str, Any, float]]:
    """Every value that holds no others, and every empty list or object: path, value, relative error of its finding."""
    items: Iterable[tuple[Any, Any]] = ()
    if isinstance(value, Mapping):
        items, size = value.items(), value.get("size")
        if isinstance(size, Mapping) and size.get("sigma") and size.get("value"):
            share = abs(size["sigma"] / size["value"])
    elif isinstance(value, (list, tuple)):
        items = enumerate(value)
    if not items or not value:
        yield path.removeprefix("/"), [] if isinstance(value, tuple) else value, share
        return
    for key, one in items:
        if key not in PROSE:
            yield from _leaves(one, f"{path}/{key}", share)


def _differ(before: Any, after: Any, path: str, share: float) -> bool:
    if not (_is_number(before) and _is_number(after)):
        return bool(before != after or isinstance(before, bool) != isinstance(after, bool))
    if "_vectors/" in path:
        before, after = abs(before), abs(after)  # a vector has no sign
    relative = max(RELATIVE, OF_SIGMA * share, *(width for where, width in WIDER if re.search(where, path)))
    absolute = OF_SIGMA if SIGMAS.search(path) else ABSOLUTE
    return bool(abs(after - before) > max(absolute, relative * max(abs(before), abs(after))))


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _short(value: Any) -> str:
    text = f"{value:.10g}" if _is_number(value) else str(value)
    return text if len(text) <= 100 else text[:97] + "..."


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
