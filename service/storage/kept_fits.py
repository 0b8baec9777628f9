"""The newest fit of every window, kept so that later events can continue it: a cache, the spectra are the truth."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from sqlalchemy import Connection, select
from sqlalchemy.dialects.postgresql import insert as postgresql_insert
from sqlalchemy.dialects.sqlite import insert as sqlite_insert

from lbacal_core.curves.curves import list_numbers
from lbacal_core.curves.kept_lines import KeptLines, read_lines, write_lines
from lbacal_core.curves.validity import Instant, Scope, parse_scope
from lbacal_core.grids import Floats
from lbacal_core.provenance import canonical_json
from service.schema.tables import examined, kept_fit


@dataclass(frozen=True)
class Told:
    """What a scope is told after a fit: the version, whether it is in effect, and its curves.

    `curves` holds C and its statistical error by dipole, shape (freq,) each; none where the version has no C.
    """

    scope: Scope
    calibration: str
    is_in_effect: bool
    curves: Mapping[str, tuple[Floats, Floats]]


@dataclass(frozen=True)
class KeptPiece:
    """A window that no hardware change cuts, the lines of its paths and what these are told."""

    since: Instant
    until: Instant
    lines: Sequence[KeptLines]
    told: Sequence[Told]


@dataclass(frozen=True)
class KeptFit:
    """A fit and the spectra behind it.

    Attributes
    ----------
    kind, scope, since, until
        The scope of its versions, whose spectra they were made from, and the whole window.
    inputs
        Hash of all inputs but the spectra.
    spectra, flag, event
        The count of usable spectra, the last flag that was set in the window and the newest event.
    """

    kind: str
    scope: Scope
    since: Instant
    until: Instant
    inputs: str
    spectra: int
    flag: int
    event: int
    pieces: Sequence[KeptPiece]


class KeptFitStore:
    """One row for each window and scope."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._insert: Any = sqlite_insert if connection.dialect.name == "sqlite" else postgresql_insert

    def put(self, fit: KeptFit) -> None:
        """Keep a fit in place of the one before."""
        lines = [write_lines(piece.lines) for piece in fit.pieces]
        told = [
            {
                "since": piece.since, "until": piece.until, "bytes": len(content),
                "told": [
                    [
                        one.scope.key, one.calibration, one.is_in_effect,
                        {dipole: [list_numbers(c), list_numbers(sigma)] for dipole, (c, sigma) in one.curves.items()},
                    ]
                    for one in piece.told
                ],
            }
            for piece, content in zip(fit.pieces, lines, strict=True)
        ]  # fmt: skip
        row = {
            "kind": fit.kind, "scope": fit.scope.key, "since_us": fit.since, "until_us": fit.until,
            "inputs": fit.inputs, "spectra": fit.spectra, "flag": fit.flag, "event": fit.event,
            "told": canonical_json(told), "lines": b"".join(lines),
        }  # fmt: skip
        insert = self._insert(kept_fit).values(row)
        keys = ["kind", "scope", "since_us", "until_us"]
        changed = {name: insert.excluded[name] for name in row if name not in keys}
        self._connection.execute(insert.on_conflict_do_update(index_elements=keys, set_=changed))

    def get(self, kind: str, scope: Scope, since: Instant, until: Instant) -> KeptFit | None:
        """The fit that is kept of a window; None where there is none."""
        is_it = (kept_fit.c.kind == kind) & (kept_fit.c.scope == scope.key)
        is_it &= (kept_fit.c.since_us == since) & (kept_fit.c.until_us == until)
        row = self._connection.execute(select(kept_fit).where(is_it)).one_or_none()
        if row is None:
            return None
        pieces, start = [], 0
        for piece in json.loads(row.told):
            lines = read_lines(row.lines[start : start + piece["bytes"]])
            start += piece["bytes"]
            told = [
                Told(
                    parse_scope(key), calibration, is_in_effect,
                    {dipole: (np.array(c, float), np.array(sigma, float)) for dipole, (c, sigma) in curves.items()},
                )
                for key, calibration, is_in_effect, curves in piece["told"]
            ]  # fmt: skip
            pieces.append(KeptPiece(piece["since"], piece["until"], lines, told))
        return KeptFit(kind, scope, since, until, row.inputs, row.spectra, row.flag, row.event, pieces)


# Inputs that a scheduled fit looked at without storing a curve, because C hardly moved.


@dataclass(frozen=True)
class Examined:
    """The fit of a scope's window whose C is that of the version in effect, but for `shift` standard deviations.

    `inputs` is the id that its version would have; where an earlier fit was continued, the hash of its version and of
    the spectra that came since.
    """

    scope: Scope
    since: Instant
    until: Instant
    inputs: str
    calibration: str
    shift: float
    made: Instant


class ExaminedStore:
    """One row for each scope and window: the inputs examined last."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._insert: Any = sqlite_insert if connection.dialect.name == "sqlite" else postgresql_insert

    def put(self, found: Sequence[Examined]) -> None:
        """Write what was examined, in place of what was before."""
        rows = [
            {
                "scope": one.scope.key, "since_us": one.since, "until_us": one.until, "inputs": one.inputs,
                "calibration": one.calibration, "shift": one.shift, "made_us": one.made,
            }
            for one in sorted(found, key=lambda one: one.scope.key)
        ]  # fmt: skip
        if rows:
            insert = self._insert(examined)
            keys = ["scope", "since_us", "until_us"]
            changed = {name: insert.excluded[name] for name in rows[0] if name not in keys}
            self._connection.execute(insert.on_conflict_do_update(index_elements=keys, set_=changed), rows)

    def of_calibration(self, calibration: str) -> Examined | None:
        """The fit that confirmed a version last."""
        statement = select(examined).where(examined.c.calibration == calibration)
        row = self._connection.execute(statement.order_by(examined.c.made_us.desc()).limit(1)).one_or_none()
        if row is None:
            return None
        window = row.since_us, row.until_us
        return Examined(parse_scope(row.scope), *window, row.inputs, row.calibration, row.shift, row.made_us)
