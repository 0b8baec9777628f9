"""The gate: which new versions go into effect by themselves, and why the others wait for a human.

A version passes if every curve converged, most channels are good and the statistical error of C in these is small
enough, the events see enough of the sidereal day, and the mean of C differs by less than the limit from the version of
the same scope that was in effect for the window, or else nearest to it in time, both through the same cable, or by what
the adoption or withdrawal of a cause announced, within its error. An
objection names the events of the window whose power is most anomalous.
The limits are settings; a jump beyond them is either a fault or news, and both deserve a look.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from lbacal_core.curves.curves import CONVERGED, MISFIT, OK, CalibrationCurve
from lbacal_core.curves.validity import Instant, Scope
from service.storage.ledger import LedgerStore
from service.storage.models import ModelChange
from service.storage.versions import Version, mean_over_band
from service.usecases.comparison import through_common_cable

ANNOUNCED_SIGMA = 3.0
"""Standard deviations by which a change of C may depart from what the adoption of a cause announced."""
EVENTS_NAMED = 3
"""An objection names so many anomalous events, the worst first."""


@dataclass(frozen=True)
class Gate:
    """Limits.

    Attributes
    ----------
    change, error
        Largest change of the mean of C, and largest error in the good channels, as fractions of C.
    coverage
        Smallest share of the 15-minute bins of the sidereal day with an event.
    band
        Smallest share of good channels.
    """

    change: float
    error: float
    coverage: float
    band: float

    def objection(
        self, version: Version, predecessor: Version | None, model_change: ModelChange | None = None
    ) -> str | None:
        """Why a version may not go into effect by itself, with the worst of its events; None if it may.

        Where the predecessor was fitted with another model, a change of C passes that `model_change` announced.
        """
        reason = self._object(version, predecessor, model_change)
        worst = version.anomalies.name_worst(EVENTS_NAMED)
        return f"{reason}; worst events: {worst}" if reason and worst else reason

    def _object(self, version: Version, predecessor: Version | None, model_change: ModelChange | None) -> str | None:
        if predecessor and predecessor.made > version.made and predecessor.window == version.window:
            return f"{predecessor.id[:12]} was made from later data and is in effect"
        for curve in version.curves:
            weakness = self._weakness(curve)
            if weakness is not None:
                return f"{curve.name}: {weakness}"
            change = find_change_of_mean(version, predecessor, str(curve.dipole)) if predecessor else None
            if change is None or abs(change) <= self.change:
                continue
            told = f"{curve.name}: mean C differs by {change:+.1%} from before, at most {self.change:.1%} passes"
            if predecessor is None or model_change is None or predecessor.model == version.model:
                return told
            low, high = find_announced(model_change, version.scope, str(curve.dipole))
            if not low <= change <= high:
                return f"{told}, or {low:+.1%} to {high:+.1%} for the change of the model"
        return None

    def _weakness(self, curve: CalibrationCurve) -> str | None:
        """What a curve by itself lacks; None if nothing."""
        if curve.status == MISFIT:
            return (
                f"misfit of this curve or of its station: chi2 per degree of freedom {curve.chi2_per_dof:.1f} with "
                f"noise alone and {curve.chi2_per_dof_profiled:.1f} with sky and pattern free within what is known; "
                "clock, place, letters, antenna or unit may be wrong, and lbacal investigate says what is"
            )
        if curve.status != CONVERGED or curve.c is None or curve.c_sigma_stat is None:
            seen = f"{24 * curve.lst_coverage:.1f} h of the sidereal day"
            return f"{curve.status} with {curve.events} events that see {seen}"
        if curve.lst_coverage < self.coverage:
            return (
                f"{curve.events} events see {24 * curve.lst_coverage:.1f} h of the sidereal day, "
                f"at least {24 * self.coverage:.1f} h pass"
            )
        is_good = curve.flags == OK
        if is_good.mean() < self.band:
            bad = curve.frequency_mhz[~is_good]
            return (
                f"{is_good.sum()} of {is_good.size} channels are good, at least {self.band:.0%} pass; "
                f"bad ones lie between {bad[0]:g} and {bad[-1]:g} MHz"
            )
        error = float(np.mean(curve.c_sigma_stat[is_good] / curve.c[is_good]))
        if error > self.error:
            return (
                f"error of C {error:.1%} in its {is_good.sum()} good channels with {curve.events} events, "
                f"at most {self.error:.1%} passes"
            )
        return None


def find_announced(change: ModelChange, scope: Scope, dipole: str) -> tuple[float, float]:
    """The range of changes of mean C that a change of the model announced for a scope.

    The mean of an array moves by at most what the mean of the one station does.
    """
    one = change.announced.get(f"{scope.key} {dipole}")
    if one is not None:
        return one.fraction - ANNOUNCED_SIGMA * one.sigma, one.fraction + ANNOUNCED_SIGMA * one.sigma
    of_station = change.announced.get(f"{change.station} {dipole}")
    if of_station is None or scope != Scope():
        return 0.0, 0.0
    reach = ANNOUNCED_SIGMA * of_station.sigma
    return min(of_station.fraction, 0.0) - reach, max(of_station.fraction, 0.0) + reach


def find_change_of_mean(version: Version, predecessor: Version, dipole: str) -> float | None:
    """Change of the band mean of C through one and the same cable: which antennas were averaged is not a jump."""
    is_known = dipole in version.chains and dipole in predecessor.chains
    curves = [through_common_cable(v, dipole) if is_known else v.curve_of(dipole) for v in (version, predecessor)]
    now, before = (mean_over_band(curve) for curve in curves)
    return now[0] / before[0] - 1.0 if now and before else None


def find_predecessors(ledger: LedgerStore, scopes: Collection[Scope], middle: Instant) -> dict[Scope, str]:
    """The version of each scope in effect at the middle of a window, or else the last before it, or the first after."""
    found = {
        scope: promotion.calibration
        for scope, promotion in ledger.decisive(scopes, middle, None).items()
        if promotion.calibration is not None
    }
    silent = [scope for scope in scopes if scope not in found]
    for scope, (before, after) in ledger.neighbours_of_scopes(silent, middle, None).items():
        nearest = before or after
        if nearest is not None:
            found[scope] = str(nearest.promotion.calibration)
    return found
