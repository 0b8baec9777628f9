"""Spectra of several files as one: the same channels, every spectrum once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats, require_same_grid
from lbacal_core.spectra import Spectra


def join_spectra(parts: Sequence[Spectra]) -> Spectra:
    """Join spectra of one experiment, such as one file a month.

    A spectrum that stands in two files is taken once if it is the same in both, and is an error if it is not. A
    covariate that a file lacks is unknown there.
    """
    if len(parts) == 1:
        return parts[0]
    first = parts[0]
    for one in parts[1:]:
        require_same_grid(one.origin, one.frequency_mhz, first.frequency_mhz, first.origin)
        if one.resistance_ohm != first.resistance_ohm:
            raise BadInputError(
                f"{one.origin}: resistance_ohm",
                f"{first.resistance_ohm:g} as in {first.origin}",
                f"{one.resistance_ohm:g}",
            )
        if not np.array_equal(one.channel_widths(), first.channel_widths()):
            raise BadInputError(f"{one.origin}: width_mhz", f"those of {first.origin}", "others")
        if (one.duration_s is None) != (first.duration_s is None):
            has, lacks = (one, first) if first.duration_s is None else (first, one)
            raise BadInputError(f"{lacks.origin}: duration_s", f"durations as in {has.origin}", "none")
    parts = _without_repetitions(parts)
    names = sorted({name for part in parts for name in part.environment})
    durations = [part.duration_s for part in parts if part.duration_s is not None]
    return Spectra(
        first.frequency_mhz,
        np.concatenate([part.power for part in parts]),
        np.concatenate([part.event_id for part in parts]),
        np.concatenate([part.time_unix for part in parts]),
        np.concatenate([part.station for part in parts]),
        np.concatenate([part.antenna for part in parts]),
        np.concatenate([part.dipole for part in parts]),
        np.concatenate([part.blocks for part in parts]),
        first.resistance_ohm,
        {name: np.concatenate([_covariate(part, name) for part in parts]) for name in names},
        f"{first.origin} and {len(parts) - 1} more",
        first.width_mhz,
        np.concatenate(durations) if durations else None,
        left_out={flag: sum(part.left_out.get(flag, 0) for part in parts) for part in parts for flag in part.left_out},
    )


def _covariate(part: Spectra, name: str) -> Floats:
    return part.environment.get(name, np.full(len(part), np.nan))


def _without_repetitions(parts: Sequence[Spectra]) -> list[Spectra]:
    """The parts without the rows that an earlier one has."""
    sizes = [len(part) for part in parts]
    keys = np.zeros(sum(sizes), dtype=np.int64)
    for name in ("station", "antenna", "dipole", "event_id"):
        found, codes = np.unique(np.concatenate([getattr(part, name) for part in parts]), return_inverse=True)
        keys = keys * found.size + codes
    order = np.argsort(keys, kind="stable")
    repeats = order[1:][keys[order[1:]] == keys[order[:-1]]]
    first_of = dict(zip(keys[order[::-1]].tolist(), order[::-1].tolist(), strict=True)) if repeats.size else {}
    starts = np.concatenate([[0], np.cumsum(sizes)])
    keep = np.ones(keys.size, dtype=bool)
    for at in repeats.tolist():
        (one, row), (other, other_row) = (
            (int(part := np.searchsorted(starts, k, side="right") - 1), int(k - starts[part]))
            for k in (at, first_of[int(keys[at])])
        )
        _require_same(parts[one], row, parts[other], other_row)
        keep[at] = False
    chosen = np.split(keep, starts[1:-1])
    return [part if np.all(rows) else part.select(rows) for part, rows in zip(parts, chosen, strict=True)]


def _require_same(part: Spectra, row: int, other: Spectra, other_row: int) -> None:
    """Refuse two spectra of one path in one event that differ."""
    is_same = part.time_unix[row] == other.time_unix[other_row] and part.blocks[row] == other.blocks[other_row]
    if not (is_same and np.array_equal(part.power[row], other.power[other_row])):
        raise BadInputError(
            f"{part.origin}: row {row}",
            f"{part.name_row(row)} as in {other.origin}, row {other_row}",
            "another spectrum",
        )
