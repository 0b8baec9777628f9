"""What is kept of the spectra of a block of time, so that later events are added to it: one table, one row a block.

A block is a window of a scope. For a fit the lines of its paths and their information matrices are kept, which add over
events; for drift each event's change of C. It is a cache: the spectra are the truth, and a block whose other inputs
changed is read again.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

import numpy as np
from sqlalchemy import delete, select

from lbacal_core.curves.kept_lines import KeptLines, read_lines, write_lines
from lbacal_core.curves.validity import Instant, Scope, parse_scope
from lbacal_core.grids import Floats
from lbacal_core.provenance import hash_content
from service.schema.tables import sums
from service.storage.rows import Store, equal, from_row, put_rows, to_row

DRIFT = "drift"
"""The kind of the blocks of drift."""


@dataclass(frozen=True)
class Sums:
    """Stored sums of a block, and the inputs that they were made from.

    Attributes
    ----------
    kind
        What was made: calibrations of a scope (``array``, ``station``, ``antenna``), or ``drift``.
    scope, since, until
        Whose spectra it was made from, and the window.
    inputs
        Hash of all inputs but the spectra.
    spectra, flag, event
        The count of usable spectra, the last flag that was set in the window and the newest event.
    whole
        The count of usable spectra when all were read last.
    arrays
        What is kept, by name.
    """

    kind: str
    scope: Scope
    since: Instant
    until: Instant
    inputs: str
    spectra: int
    flag: int
    event: int
    whole: int
    arrays: Mapping[str, Any]


def _pack(arrays: Mapping[str, Any]) -> bytes:
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, **arrays)
    return file.getvalue()


_NOTHING = sha256(_pack({})).hexdigest()
"""The hash of a block without an array: a station-year in which no path has a reference is measured, and is empty."""


class SumStore(Store):
    """Blocks by their kind, scope and window."""

    def put(self, block: Sums, name: str | None = None) -> None:
        """Keep a block in place of the one before; its name is the hash of what it holds if it has no other."""
        content = _pack(block.arrays)
        digest = name or sha256(content).hexdigest()
        put_rows(self._connection, sums, [to_row(block, sums, scope=block.scope.key, arrays=content, sha256=digest)])

    def forget(self, scope: Scope, since: Instant, until: Instant, kind: str | None = None) -> None:
        """Drop what is kept of a scope in a window, of a kind or of all: its spectra are no longer used."""
        inside = sums.c.since_us >= since, sums.c.until_us <= until
        self._connection.execute(delete(sums).where(sums.c.scope == scope.key, *inside, *equal(sums, kind=kind)))

    def get(self, kind: str, scope: Scope, since: Instant, until: Instant) -> Sums | None:
        """The block of a kind (as in `Sums`), scope and window; None where it is not kept."""
        is_it = (sums.c.scope == scope.key) & (sums.c.since_us == since) & (sums.c.until_us == until)
        return next(self.of_kind(kind, is_it), None)

    def beside(self, kind: str, scope: Scope, since: Instant, until: Instant) -> list[Sums]:
        """The blocks of a scope that hold nothing of a window, in order of theirs."""
        is_apart = (sums.c.until_us <= since) | (sums.c.since_us >= until)
        return list(self.of_kind(kind, (sums.c.scope == scope.key) & is_apart))

    def names_beside(self, kind: str, scope: Scope, since: Instant, until: Instant) -> list[list[Any]]:
        """The names of the lines of these blocks: others where a path was fitted from other spectra, and then only.

        So the fits of two windows do not call for each other for ever.
        """
        named = sums.c.since_us, sums.c.inputs, sums.c.sha256
        is_apart = (sums.c.until_us <= since) | (sums.c.since_us >= until)
        is_it = (sums.c.kind == kind) & (sums.c.scope == scope.key) & is_apart
        return [list(row) for row in self._connection.execute(select(*named).where(is_it).order_by(*named))]

    def of_kind(self, kind: str, is_wanted: Any = True) -> Iterator[Sums]:
        """All blocks of a kind, in order of scope and window, one at a time."""
        statement = select(sums).where(sums.c.kind == kind, is_wanted).order_by(sums.c.scope, sums.c.since_us)
        with self._connection.execute(statement, execution_options={"yield_per": 1}) as rows:
            for row in rows:
                with np.load(io.BytesIO(row.arrays), allow_pickle=False) as arrays:
                    yield from_row(Sums, row, scope=parse_scope(row.scope), arrays=dict(arrays))

    def during(self, kind: str, since: Instant, until: Instant) -> Iterator[Sums]:
        """The blocks of a kind whose windows have a part in [since, until)."""
        return self.of_kind(kind, (sums.c.until_us > since) & (sums.c.since_us < until))

    def digests(self, kind: str) -> list[str]:
        """Hashes of all blocks of a kind that hold something, in order of scope and window."""
        statement = (
            select(sums.c.sha256)
            .where(sums.c.kind == kind, sums.c.sha256 != _NOTHING)
            .order_by(sums.c.scope, sums.c.since_us)
        )
        return list(self._connection.execute(statement).scalars())


# A fit: its lines, and what each of its scopes is served.

ServedKey = tuple[Scope, Instant, Instant]
"""Who is served something, from when until when."""


@dataclass(frozen=True)
class Served:
    """The curves that a scope is served after a fit: the version, whether it is in effect, and its curves.

    `curves` holds C and its statistical error by dipole, shape (freq,) each; none where the version has no C.
    `changes` are the known changes of the hardware, in any year; None in blocks that do not say.
    """

    scope: Scope
    calibration: str
    is_in_effect: bool
    curves: Mapping[str, tuple[Floats, Floats]]
    changes: Sequence[Instant] | None = None


@dataclass(frozen=True)
class KeptPiece:
    """A window that no hardware change cuts, the lines of its paths and the curves that these are served."""

    since: Instant
    until: Instant
    lines: Sequence[KeptLines]
    served: Sequence[Served] = ()


def write_pieces(pieces: Sequence[KeptPiece]) -> dict[str, Any]:
    """Write the pieces of a fit as arrays by name."""
    head, arrays = [], dict[str, Any]()
    for k, piece in enumerate(pieces):
        served = [
            [one.scope.key, one.calibration, one.is_in_effect, sorted(one.curves), one.changes] for one in piece.served
        ]
        head.append([piece.since, piece.until, served])
        arrays[f"{k}.told"] = np.array([one.curves[dipole] for one in piece.served for dipole in sorted(one.curves)])
        arrays |= {f"{k}.{name}": values for name, values in write_lines(piece.lines).items()}
    return {"pieces": np.array(json.dumps(head)), **arrays}


def name_pieces(pieces: Sequence[KeptPiece]) -> str:
    """The hash of the spectra that the lines of pieces are of."""
    lines = [(piece, one) for piece in pieces for one in piece.lines]
    named = [
        [piece.since, piece.until, *map(str, (*owner, spectra))]
        for piece, one in lines
        for owner, spectra in zip(one.owners, one.spectra, strict=True)
    ]
    return hash_content(sorted(named))


def read_pieces(arrays: Mapping[str, Any]) -> list[KeptPiece]:
    """Read what `write_pieces` wrote."""
    pieces = []
    for k, (since, until, listed) in enumerate(json.loads(str(arrays["pieces"]))):
        curves = iter(arrays[f"{k}.told"])
        served = [
            Served(parse_scope(key), calibration, is_in_effect, {of: tuple(next(curves)) for of in dipoles}, *changes)
            for key, calibration, is_in_effect, dipoles, *changes in listed
        ]
        own = {name.removeprefix(f"{k}."): values for name, values in arrays.items() if name.startswith(f"{k}.")}
        pieces.append(KeptPiece(since, until, read_lines(own), served))
    return pieces
