"""Differences between two sets of frozen numbers, by JSON path."""

from __future__ import annotations

import gzip
import json
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

RELATIVE = 1e-6
"""Largest difference of two numbers over the larger of them (issue: every structural commit keeps them to this)."""
ABSOLUTE = 1e-9
"""Differences below this are none: probabilities so small are held by their significance, sums cancel to this."""
WIDER: tuple[tuple[str, set[str] | None, float], ...] = (
    # Fits of causes that an LST curve does not name stop at 1e-8 of chi^2, where sizes are still loose (4e-3 seen).
    (r"^report/hypotheses/|^report/scores/\d+/size$", None, 1e-2),
    # A share is 1 less a ratio of two informations that are small themselves where the sky's differences are free.
    (r"/taken/", None, 1e-5),
)
"""Places whose numbers rounding moves by more than `RELATIVE`: path, causes (all where None), largest relative
difference. Seen when the power of every data set was changed by a random 1e-12, or factors of the chain changed their
order; nothing else moved by `RELATIVE`."""
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
    old, new = ({path: (value, cause) for path, value, cause in _leaves(one)} for one in (before, after))
    found = []
    for path in old | new:
        (was, cause), (now, _) = old.get(path, (ABSENT, "")), new.get(path, (ABSENT, ""))
        if _differ(was, now, _tolerance(path, cause)):
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
    """Values as they were stored."""
    numbers: dict[str, Any] = json.loads(gzip.decompress(path.read_bytes()))
    return numbers


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, Mapping):
        return {key: _rounded(one) for key, one in value.items()}
    return [_rounded(one) for one in value] if isinstance(value, (list, tuple)) else value


def _leaves(value: Any, path: str = "", cause: str = "") -> Iterator[tuple[str, Any, str]]:
    """Every value that holds no others, and every empty list or object: path, value, cause of the object around it."""
    items: Iterable[tuple[Any, Any]] = ()
    if isinstance(value, Mapping):
        items, cause = value.items(), value.get("cause", cause)
    elif isinstance(value, (list, tuple)):
        items = enumerate(value)
    if not items or not value:
        yield path.removeprefix("/"), [] if isinstance(value, tuple) else value, cause
        return
    for key, one in items:
        if key not in PROSE:
            yield from _leaves(one, f"{path}/{key}", cause)


def _tolerance(path: str, cause: str) -> float:
    wider = [width for where, causes, width in WIDER if re.search(where, path) and (causes is None or cause in causes)]
    return max(wider, default=RELATIVE)


def _differ(before: Any, after: Any, tolerance: float) -> bool:
    if _is_number(before) and _is_number(after):
        return bool(abs(after - before) > max(ABSOLUTE, tolerance * max(abs(before), abs(after))))
    return bool(before != after or isinstance(before, bool) != isinstance(after, bool))


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _short(value: Any) -> str:
    text = f"{value:.10g}" if _is_number(value) else str(value)
    return text if len(text) <= 100 else text[:97] + "..."
