"""Cuts of windows, as people see them: listed, lifted where somebody knows better, and restored.

A cut is refitted once its pieces are in effect: until then one C answers on both sides of a change that was found.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

from lbacal.instants import format_instant
from lbacal_core.curves.validity import Instant, Promotion, Scope
from lbacal_core.errors import name_path
from service.errors import ConflictError
from service.storage.database import Database, Stores
from service.storage.drift import LIFTED, RESTORED, Cut, Decision, KeptCut
from service.wire.bodies import ReasonBody

NOT_REFITTED = "found, not yet refitted"


def is_over(promotion: Promotion, cut: Cut) -> bool:
    """Whether a version answers on both sides of a cut."""
    ends_later = promotion.valid_to is None or promotion.valid_to > cut.date
    return promotion.calibration is not None and promotion.valid_from < cut.date and ends_later


def tell_not_refitted(cut: Cut) -> str:
    """What to know of C while one version answers on both sides of a cut."""
    who, day = name_path(cut.station, cut.antenna), format_instant(cut.date)[:10]
    return f"{who} changed on {day} ({NOT_REFITTED}): C in effect is the mean over the change"


def mark_refitted(stores: Stores, cuts: Sequence[KeptCut], dipoles: Collection[str]) -> list[KeptCut]:
    """Cuts with whether they are refitted: those that stand, and whose antenna has a version in effect, may not be."""
    asked = {
        (Scope(one.cut.station, one.cut.antenna, dipole), at): one.number
        for one in cuts if one.stands for dipole in dipoles for at in (one.cut.date - 1, one.cut.date)
    }  # fmt: skip
    of_number = {one.number: one.cut for one in cuts}
    said = stores.ledger.decisive_at(asked)
    waiting = {number for key, number in asked.items() if key in said and is_over(said[key], of_number[number])}
    return [replace(one, is_refitted=one.number not in waiting) for one in cuts]


@dataclass(frozen=True)
class Cuts:
    """Lists cuts and takes decisions about them; the next look for due work finds the windows that these change."""

    database: Database
    dipoles: Collection[str]
    clock: Callable[[], Instant]

    def list_all(self, station: str | None) -> list[KeptCut]:
        """All cuts on record, of all stations or of one."""
        with self.database.read() as stores:
            return mark_refitted(stores, stores.cuts.kept(station), self.dipoles)

    def waiting(self) -> list[KeptCut]:
        """The cuts that stand and are not yet refitted."""
        return [one for one in self.list_all(None) if not one.is_refitted]

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
            decided = stores.cuts.decide(number, Decision(act, self.clock(), by, reason))
            return mark_refitted(stores, [decided], self.dipoles)[0]
