"""Cuts of windows, as people see them: listed, lifted where somebody knows better, and restored."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from lbacal_core.validity import Instant
from service.errors import ConflictError
from service.storage.cuts import LIFTED, RESTORED, Decision, KeptCut
from service.storage.database import Database
from service.wire.bodies import ReasonBody


@dataclass(frozen=True)
class Cuts:
    """Lists cuts and takes decisions about them; the next look for due work finds the windows that these change."""

    database: Database
    clock: Callable[[], Instant]

    def list_all(self, station: str | None) -> list[KeptCut]:
        """All cuts on record, of all stations or of one."""
        with self.database.read() as stores:
            return stores.cuts.kept(station)

    def lift(self, number: int, body: ReasonBody, by: str) -> KeptCut:
        """Leave the windows of an antenna whole at a date, although the watch finds a change there."""
        return self._decide(number, LIFTED, body.reason, by)

    def restore(self, number: int, body: ReasonBody, by: str) -> KeptCut:
        """Cut the windows of an antenna again where they were cut before a person lifted the cut."""
        return self._decide(number, RESTORED, body.reason, by)

    def _decide(self, number: int, act: str, reason: str, by: str) -> KeptCut:
        with self.database.write() as stores:
            cut = stores.cuts.get(number)
            if cut.ended is not None:
                raise ConflictError(f"cut {number} has ended: the watch no longer finds its change")
            if cut.stands == (act == RESTORED):
                raise ConflictError(f"cut {number} {'stands' if cut.stands else 'is lifted'} already")
            return stores.cuts.decide(number, Decision(act, self.clock(), by, reason))
