"""Windows beside windows: what the fits of other years keep, and the pieces of one that changes cut."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lbacal_core.calibration.fit import SHARE_OF_MISFITS
from lbacal_core.calibration.years import Beside
from lbacal_core.curves.curves import CONVERGED, MISFIT, CalibrationCurve
from lbacal_core.curves.kept_lines import KeptLines, Owner
from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.grids import Floats
from lbacal_core.provenance import hash_content
from service.storage.sums import KeptPiece
from service.storage.versions import BESIDE, Version


@dataclass(frozen=True)
class Neighbours:
    """The other windows of a scope, and when antennas, or (None) all of a station changed, in any year.

    `behind` is what is added behind N_RCU in single paths, shape (freq,), for means from which changes are taken out,
    and the hash of the spectra that say so.
    """

    windows: Sequence[KeptPiece]
    changes: Mapping[tuple[str, int | None], Sequence[Instant]]
    behind: Mapping[Owner, tuple[Floats, str]]

    def beside(self, since: Instant, until: Instant) -> list[tuple[KeptPiece, Beside]]:
        """The windows that are fitted together with a window, the nearest first."""
        # the time between two windows, 0 where they touch
        ranked = sorted(self.windows, key=lambda one: (max(since - one.until, one.since - until), one.since))
        return [(one, Beside(of, self._is_same(of, one, since, until))) for one in ranked for of in one.lines]

    def _is_same(self, of: KeptLines, one: KeptPiece, since: Instant, until: Instant) -> NDArray[np.bool_]:
        """Whether nothing is known to have changed between two windows; of a mean what single ones do is taken out."""
        first, last = min(one.until, until), max(one.since, since)
        asked = [{(str(station), None), (str(station), antenna)} for station, antenna, _ in of.owners]
        dates = [[date for key in keys for date in self.changes.get(key, ())] for keys in asked]
        return np.array([not any(first <= date <= last for date in found) for found in dates])

    def changes_of(self, scope: Scope) -> list[Instant]:
        """When hardware is known to have changed, rising: that of a path, or behind a mean."""
        own = (None, scope.antenna)
        is_own = {
            key: scope.station in (None, key[0]) and (scope.antenna is None or key[1] in own) for key in self.changes
        }
        return sorted(date for key, dates in self.changes.items() if is_own[key] for date in dates)

    def and_also(self, window: KeptPiece) -> Neighbours:
        """Add one window."""
        return replace(self, windows=[*self.windows, window])


ALONE = Neighbours((), {}, {})
AWAY = "members of both windows, with their errors"
"""Part of the name of a mean beside other windows: when these lent by other rules the same input gave another C."""
APART = "changed between"
"""Part of the name of a window that a change parts from the own: it lends less, and C is another."""


def name_beside(
    scope: Scope, curves: Sequence[CalibrationCurve], beside: Sequence[tuple[KeptPiece, Beside]]
) -> dict[str, str]:
    """Name the windows that a version was fitted together with."""
    repeated = {curve.path: curve.repeated.windows for curve in curves if curve.repeated}
    same = Counter(
        owner for _, of in beside for k, owner in enumerate(of.lines.owners) if of.lines.is_good[k] and of.is_same[k]
    )
    apart = [owner for owner, windows in repeated.items() if windows <= 1 + same[owner]]
    return {BESIDE: name_windows(scope, beside, apart)} if repeated else {}


def name_windows(scope: Scope, beside: Sequence[tuple[KeptPiece, Beside]], apart: Collection[Owner] = ()) -> str:
    """The hash of a scope's spectra in the windows that lend to it; to owners `apart` those of the same hardware."""
    named = sorted(
        [one.since, one.until, str(of.lines.spectra[k]), *([] if of.is_same[k] else [APART])]
        for one, of in beside
        for k, owner in enumerate(of.lines.owners)
        if scope == scope_of(owner) and of.lines.is_good[k] and (of.is_same[k] or owner not in apart)
    )
    return hash_content([*named, AWAY] if scope.antenna is None and named else named)


def scope_of(owner: Owner) -> Scope:
    """The scope of the version that has the curve of an owner."""
    station, antenna, dipole = owner
    return Scope(station, antenna, None if antenna is None else dipole)


def share_misfits(versions: Sequence[Version]) -> list[Version]:
    """Versions of the pieces of a window with the misfit of their station.

    A fit of a piece judges the paths of the piece alone: an antenna whose window is cut would escape what is wrong with
    clock, sky or pattern of all.
    """
    groups: dict[tuple[str | None, str | None], list[bool]] = {}
    for version in versions:
        for curve in version.curves:
            if curve.c is not None:
                groups.setdefault((curve.station, curve.dipole), []).append(curve.status == MISFIT)
    wrong = {station for (station, _), misfits in groups.items() if np.mean(misfits) >= SHARE_OF_MISFITS}
    return [
        replace(one, curves=tuple(curve.as_misfit() if curve.status == CONVERGED else curve for curve in one.curves))
        if one.scope.station in wrong
        else one
        for one in versions
    ]
