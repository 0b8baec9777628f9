"""What a version is a mean of, so that each path is told it through its own cable."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import sqlalchemy as sa
from alembic import op

from lbacal_core.calibration.spreads import SinglePaths, measure_spreads
from lbacal_core.instrument import Instrument, load_instrument
from lbacal_core.provenance import canonical_json
from lbacal_core.reference_chain import CableTable, GainSpreads

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None

_path = sa.table("path", *map(sa.column, ("id", "station", "antenna", "dipole")))
_event = sa.table("event", *map(sa.column, ("id", "flag")))
_spectrum = sa.table("spectrum", *map(sa.column, ("path", "event", "time_us")))

MIN_EVENTS = 60
"""A path with fewer events was not averaged (first release)."""
SHIPPED = "lofar-superterp"
FIRST_INSTRUMENT = "768c92a2ca41b4b930a19a6c99cb8c909b04ad621ea255eef3f1d63a5ff34eb3"
"""Hash of `SHIPPED` in the first release."""
FIRST_CABLES = "1b523d7195ccee2ad29c219a79e03e78826fa926f916ca73f5761ea460c47238"
"""Hash of its cable table."""


def upgrade() -> None:
    """To this revision."""
    op.create_table(
        "chain_part",
        sa.Column("sha256", sa.Text(), nullable=False),
        sa.Column(
            "content", sa.Text(), nullable=False, comment="canonical JSON of a cable table or of the spreads of A g"
        ),
        sa.PrimaryKeyConstraint("sha256", name=op.f("pk_chain_part")),
    )
    comment = "the reference chains by dipole, JSON; cables and spreads by hash in chain_part"
    op.add_column("calibration", sa.Column("reference", sa.Text(), nullable=True, comment=comment))
    configured = (op.get_context().config or _NoConfig()).attributes.get("instrument")
    _Filler(op.get_bind(), configured).fill()


def downgrade() -> None:
    """To the revision before."""
    op.drop_column("calibration", "reference")
    op.drop_table("chain_part")


class _NoConfig:
    attributes: dict[str, Any] = {}  # noqa: RUF012 - never written


class _Averaged(NamedTuple):
    """The paths of a mean: (station, antenna) of each, its cable, and how many events have any of them."""

    members: list[tuple[str, int]]
    cables: list[str]
    events: int


class _Filler:
    """Gives versions of the first release the chain that they are a mean of, as far as what is stored tells."""

    def __init__(self, connection: sa.Connection, configured: Callable[[], Instrument] | None) -> None:
        self._connection = connection
        self._configured = configured
        self._parts: set[str] = set()
        self.table_of = cache(self._find_table)

    def fill(self) -> None:
        rows = self._rows("SELECT id, station, antenna, since_us, until_us, inputs, curves FROM calibration")
        for row in list(rows):
            table = self.table_of(str(json.loads(row.inputs).get("instrument")))
            if table is None:
                continue
            curves = {curve["dipole"]: curve for curve in json.loads(row.curves) if curve["c"] is not None}
            make = self._of_mean if row.antenna is None else self._of_path
            chains = {dipole: chain for dipole, curve in curves.items() if (chain := make(row, curve, table))}
            if chains:
                update = sa.text("UPDATE calibration SET reference = :reference WHERE id = :id")
                self._connection.execute(update, {"reference": canonical_json(chains), "id": row.id})

    def _find_table(self, digest: str) -> CableTable | None:
        """The cables of an instrument that a version names."""
        shipped = load_instrument(SHIPPED)
        cables = CableTable.of(shipped)
        if shipped.digest() == digest or (digest, cables.digest) == (FIRST_INSTRUMENT, FIRST_CABLES):
            return cables
        configured = None if self._configured is None else self._configured()
        return CableTable.of(configured) if configured is not None and configured.digest() == digest else None

    def _of_path(self, row: Any, _: dict[str, Any], table: CableTable) -> dict[str, Any] | None:
        cable = _cable_over(table, row.station, row.antenna, row)
        return None if cable is None else self._chain([(row.station, row.antenna)], [cable], table, None, None)

    def _of_mean(self, row: Any, curve: dict[str, Any], table: CableTable) -> dict[str, Any] | None:
        averaged = self._averaged(row, curve["dipole"], table)
        if averaged is None:
            return None
        spreads = self._spreads(row, curve, averaged, table)
        doubt = None
        if averaged.events != curve["events"]:
            doubt = f"its members were counted among {averaged.events} events; it was made from {curve['events']}"
        return self._chain(averaged.members, averaged.cables, table, spreads, doubt)

    def _chain(
        self,
        members: list[tuple[str, int]],
        cables: list[str],
        table: CableTable,
        spreads: GainSpreads | None,
        doubt: str | None,
    ) -> dict[str, Any]:
        for part in (table,) if spreads is None else (table, spreads):
            if part.digest not in self._parts:
                self._parts.add(part.digest)
                insert = sa.text("INSERT INTO chain_part (sha256, content) VALUES (:sha256, :content)")
                self._connection.execute(insert, {"sha256": part.digest, "content": canonical_json(part.as_dict())})
        return {
            "members": [list(member) for member in members],
            "mean_cable_loss": np.mean([table.cables[cable] for cable in cables], axis=0).tolist(),
            "cables": table.digest,
            "spreads": None if spreads is None else spreads.digest,
            "doubt": doubt,
        }

    def _averaged(self, row: Any, dipole: str, table: CableTable) -> _Averaged | None:
        """The paths with enough usable spectra in the window of a version."""
        of_window = (
            sa.select(_path.c.id, _path.c.station, _path.c.antenna)
            .select_from(
                _spectrum.join(_path, _path.c.id == _spectrum.c.path).join(_event, _event.c.id == _spectrum.c.event)
            )
            .where(_spectrum.c.time_us >= row.since_us, _spectrum.c.time_us < row.until_us, _event.c.flag.is_(None))
            .where(_path.c.dipole == dipole, sa.true() if row.station is None else _path.c.station == row.station)
        )
        enough = of_window.group_by(_path.c.id, _path.c.station, _path.c.antenna).having(sa.func.count() >= MIN_EVENTS)
        paths = list(self._connection.execute(enough.order_by(_path.c.station, _path.c.antenna)))
        cables = [_cable_over(table, path.station, path.antenna, row) for path in paths]
        known = [cable for cable in cables if cable is not None]
        if not paths or len(known) < len(paths):
            return None
        of_members = of_window.where(_path.c.id.in_([path.id for path in paths]))
        events = of_members.with_only_columns(sa.func.count(sa.distinct(_spectrum.c.event)), maintain_column_froms=True)
        count = int(self._connection.execute(events).scalar_one())
        return _Averaged([(path.station, path.antenna) for path in paths], known, count)

    def _spreads(self, row: Any, curve: dict[str, Any], averaged: _Averaged, table: CableTable) -> GainSpreads | None:
        """The departures of the paths that were fitted by themselves from the same window and inputs."""
        inputs = json.loads(row.inputs)
        found = self._rows(
            """SELECT station, antenna, inputs, curves FROM calibration WHERE antenna IS NOT NULL AND dipole = :dipole
            AND since_us = :since AND until_us = :until ORDER BY made_us""",
            dipole=curve["dipole"], since=row.since_us, until=row.until_us,
        )  # fmt: skip
        cable_of = dict(zip(averaged.members, averaged.cables, strict=True))
        singles: dict[tuple[str, int], dict[str, Any]] = {}
        for single in found:
            own, (fitted,) = json.loads(single.inputs), json.loads(single.curves)
            is_same = all(own.get(name) == inputs.get(name) for name in ("instrument", "sky_power", "model_version"))
            if is_same and fitted["c"] is not None and (single.station, single.antenna) in cable_of:
                singles[single.station, single.antenna] = fitted
        if not singles:
            return None
        c, sigma = (np.array([one[name] for one in singles.values()]) for name in ("c", "c_sigma_stat"))
        cables = [cable_of[key] for key in singles]
        mean_loss = np.mean([table.cables[cable] for cable in averaged.cables], axis=0)
        paths = SinglePaths(
            stations=np.array([station for station, _ in singles]),
            cables=np.array(cables),
            # up to the antenna gain, which cancels
            slope=c**-2,
            sigma=2.0 * c**-3 * sigma,
            loss=np.array([table.cables[cable] for cable in cables]),
        )
        return measure_spreads(paths, np.array(curve["c"]) ** -2, mean_loss)

    def _rows(self, statement: str, **values: Any) -> Iterator[Any]:
        return iter(self._connection.execute(sa.text(statement), values))


def _cable_over(table: CableTable, station: str, antenna: int, window: Any) -> str | None:
    """The cable that an antenna had over all of a window; None where it had none or several."""
    ends = (window.since_us / 1e6, (window.until_us - 1) / 1e6)
    names = {table.cable_of(station, antenna, instant) for instant in ends}
    return names.pop() if len(names) == 1 else None
