"""The gate: which new versions go into effect by themselves, and why the others wait for a human.

A version passes if every curve converged, most channels are good and the statistical error of C in these is small
enough, the events see enough of the sidereal day, and the mean of C differs by less than the limit from the version of
the same scope that was in effect for the window, or else nearest to it in time, both through the same cable, or by what
the adoption or withdrawal of a cause announced, within its error, or by what is in force to have changed between the
two. An objection names the events of the window whose power is most anomalous.
The limits are settings; a jump beyond them is either a fault or news, and both deserve a look.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lbacal.instants import SECOND_US
from lbacal_core.calibration.channels import LARGEST_GOOD_ERROR, LEAST_LIKELY
from lbacal_core.calibration.singles import MIN_EVENTS
from lbacal_core.calibration.slow_changes import SlowChange
from lbacal_core.curves.curves import CONVERGED, MISFIT, OK, UNCERTAIN, CalibrationCurve
from lbacal_core.curves.reference_chain import ReferenceChain
from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.errors import BadInputError, write_change, write_percent
from lbacal_core.grids import Floats, require_same_grid
from service.storage.changes import RAMP, Change, Cut, KeptChange
from service.storage.database import Stores
from service.storage.models import ModelChange
from service.storage.versions import OF_OTHERS, OF_SIMULATION, Version, mean_over_band
from service.usecases.calibrations import find_slow, group_by_antenna
from service.usecases.retractions import find_retracted

# How far two calibration curves differ, channel by channel.


@dataclass(frozen=True)
class CurveChange:
    """Change of C from one curve to another, shape (freq,): as a fraction, and in standard deviations of both.

    NaN in a channel in which one of them has no value. `mean_c` are those of C over the channels that both have, before
    and after, V per ADC unit.
    """

    frequency_mhz: Floats
    fraction: Floats
    sigma: Floats
    mean_c: tuple[float, float]

    @property
    def max_fraction(self) -> float:
        """The largest change of any channel, as a fraction."""
        return float(np.nanmax(np.abs(self.fraction)))

    @property
    def max_sigma(self) -> float:
        """The largest change of any channel, in standard deviations."""
        return float(np.nanmax(np.abs(self.sigma)))


def compare_curves(before: CalibrationCurve, after: CalibrationCurve) -> CurveChange:
    """Compare two converged curves on the same channels; their errors, all that are known, count as independent."""
    if before.c is None or after.c is None:
        raise BadInputError("calibrations", "two converged curves", f"{before.status} and {after.status}")
    require_same_grid(after.name, after.frequency_mhz, before.frequency_mhz, before.name)
    sigma = np.hypot(_total_error(before), _total_error(after))
    is_known = np.isfinite(before.c) & np.isfinite(after.c)
    means = (float(before.c[is_known].mean()), float(after.c[is_known].mean()))
    return CurveChange(before.frequency_mhz, after.c / before.c - 1.0, (after.c - before.c) / sigma, means)


def compare_versions(first: Version, second: Version) -> list[tuple[str | None, CurveChange]]:
    """How the curves of two versions differ, by dipole, as one and the same path is served them.

    A dipole of which one version has no C is left out.
    If one of them is a path's own, the other is carried through that path's cable. Curves of two reference chains are
    compared through one and the same cable, C L_ref^1/2: a change of which antennas were averaged is no change.
    """
    path = next((one.scope for one in (first, second) if one.scope.antenna is not None), None)
    changes = []
    for curve in first.curves:
        other = next((c for c in second.curves if c.dipole == curve.dipole), None)
        if other is None or curve.c is None or other.c is None:
            continue
        if path is None:
            before, after = (through_common_cable(version, str(curve.dipole)) for version in (first, second))
        else:
            before, after = (version.serve(path, sum(version.window) // 2).curve for version in (first, second))
        changes.append((curve.dipole, compare_curves(before, after)))
    return changes


def find_shift(before: Version, after: Version) -> float | None:
    """By how much C moved from one fit of a scope to the next, in standard deviations: the largest of any channel.

    The fits share most of their events, so their errors do not add: the unit is the smaller `c_sigma_stat` of the two.
    None if anything but the spectra differs (model, instrument, sky power, members of a mean), a curve is missing, or a
    channel has a value in one of the two only: that is news however little the others move.
    """
    if _without_spectra(before) != _without_spectra(after) or before.window != after.window:
        return None
    if {curve.dipole for curve in before.curves} != {curve.dipole for curve in after.curves}:
        return None
    shifts = []
    for curve in after.curves:
        dipole = str(curve.dipole)
        chains = [version.chains.get(dipole) for version in (before, after)]
        old, new = (through_common_cable(version, dipole) for version in (before, after))
        if _members(chains[0]) != _members(chains[1]) or old.c is None or new.c is None:
            return None
        is_known = np.isfinite(new.c)
        if not np.array_equal(is_known, np.isfinite(old.c)) or not is_known.any():
            return None
        unit = np.minimum(np.asarray(old.c_sigma_stat), np.asarray(new.c_sigma_stat))
        shifts.append(float(np.max(np.abs(new.c - old.c)[is_known] / unit[is_known])))
    return max(shifts)


def _without_spectra(version: Version) -> dict[str, Any]:
    return {name: value for name, value in version.inputs.items() if name not in ("spectra", *OF_OTHERS)}


def _members(chain: ReferenceChain | None) -> frozenset[tuple[str, int]] | None:
    return None if chain is None else chain.member_set


def through_common_cable(version: Version, dipole: str) -> CalibrationCurve:
    """The curve of a version with its cable taken out, C L_ref^1/2; as it is where the cables are not known."""
    curve, chain = version.curve_of(dipole), version.chains.get(dipole)
    if chain is None or curve.c is None or curve.c_sigma_stat is None:
        return curve
    factor = np.sqrt(chain.mean_loss)
    return replace(curve, c=curve.c * factor, c_sigma_stat=curve.c_sigma_stat * factor)


def _total_error(curve: CalibrationCurve) -> Floats:
    """The error that curves do not share: that of the sky and of the antenna moves all of them alike."""
    of_noise = np.asarray(curve.c_sigma_stat, dtype=float)
    if curve.covariance is not None and curve.c is not None:
        return np.asarray(np.hypot(of_noise, curve.c * np.sqrt(np.sum(curve.covariance.own**2, axis=0))))
    return of_noise if curve.c_sigma_sys is None else np.hypot(of_noise, curve.c_sigma_sys)


# A change of C in words: in the mean over the band, as a tilt, as a curvature, and where along frequency each is felt.
#
# A change is found by all three together, and any of them may carry it. The most significant is told first, then the
# mean and what else is plain. Tilt and curvature are the Legendre polynomials 1 and 2 over the band
# (`lbacal_core.drift.events`): 1 at its top, where the bottom has -1 and 1, and the middle of the curvature -1/2.

PLAIN, LEAST_SHARE = 3.0, 1.0 / 3.0
"""A part beside the most significant one is told from so many standard deviations on, and from this share of it."""
TILT, CURVATURE = "tilt", "curvature"
Shape = Mapping[str, Mapping[str, float]]
"""Tilt and curvature of ln C by their names, each a `value` with its `sigma` where that is known."""


@dataclass(frozen=True)
class _Part:
    significance: float
    words: str


def tell_change(mean: float, sigma: float, shape: Shape, frequency_mhz: Floats) -> str:
    """By how much C changed, `mean` over the band with its error and along frequency: ``-3.10 ± 0.20 %``."""
    shapes = _rank_shapes(mean, sigma, shape, frequency_mhz)
    whole = _Part(abs(mean) / sigma, write_change(mean, sigma) + (" in the mean over the band" if shapes else ""))
    return " and by ".join(part.words for part in sorted([whole, *shapes], key=lambda part: -part.significance))


def tell_shapes(change: Mapping[str, Any], frequency_mhz: Floats) -> str:
    """Describe changes along frequency beside the mean over the band; empty where the mean describes them."""
    shapes = _rank_shapes(change["size"], change["sigma"], change["shape"], frequency_mhz)
    return " and ".join(part.words for part in shapes)


def tell_size(change: Change, frequency_mhz: Floats) -> str:
    """By how much C changed at a change on record, in the words of its alarm; empty where its size is not known."""
    size, sigma = change.size, change.size_sigma or 0.0
    if size is None:
        return ""
    shape = {name: {"value": value} for name in (TILT, CURVATURE) if (value := getattr(change, name)) is not None}
    told = tell_change(size, sigma, shape, frequency_mhz) if sigma else write_change(size, sigma)
    own = (
        f", {one.dipole} of antenna {one.antenna} by {tell_size(change.of(one.antenna, one.dipole), frequency_mhz)}"
        for one in change.own
    )
    return told + (" a year" if change.kind == RAMP else "") + "".join(own)


def _rank_shapes(mean: float, sigma: float, shape: Shape, frequency_mhz: Floats) -> list[_Part]:
    """The shapes that are told beside a mean with its error, the most significant first; without an error by that."""
    found = [
        _Part(
            abs(one["value"]) / one.get("sigma", sigma),
            _tell_shape(name, one["value"], one.get("sigma"), frequency_mhz),
        )
        for name, one in shape.items()
    ]
    most = max([abs(mean) / sigma, *(part.significance for part in found)])
    least = min(most, max(PLAIN, LEAST_SHARE * most))
    told = [part for part in found if part.significance >= least]
    return sorted(told, key=lambda part: -part.significance)


def _tell_shape(name: str, value: float, sigma: float | None, frequency_mhz: Floats) -> str:
    """A shape of ln C, with its error, if that is known, where it is largest."""
    bottom, top = f"{frequency_mhz[0]:.0f}", f"{frequency_mhz[-1]:.0f}"
    size = math.expm1(value)
    largest = write_percent(size) if sigma is None else write_change(size, math.exp(value) * sigma)
    if name == TILT:
        return f"a tilt ({largest} at {top} MHz, {write_percent(math.expm1(-value))} at {bottom} MHz)"
    return f"a curvature ({largest} at {bottom} and {top} MHz, {write_percent(math.expm1(-value / 2))} halfway)"


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

    def judge(self, stores: Stores, made: Sequence[Version], kept: Sequence[KeptChange]) -> dict[str, str | None]:
        """Objections to versions of one window by their ids, with the changes of their station as they are decided.

        A window that is whole again, as a person dismissed a change, holds its step, and its parts do not.
        """
        since, until = made[0].window
        before = find_predecessors(stores, [v.scope for v in made], (since + until) // 2)
        versions = stores.versions.get_many(before.values())
        model_change = stores.models.last_change(made[0].scope.station, since, until)
        steps = [step for one in kept for step in one.steps]
        dismissed = [step for one in kept for step in one.dismissed_steps]
        of_antenna, found = group_by_antenna(kept), dict[str, str | None]()
        for v in made:
            predecessor = versions.get(before.get(v.scope, ""))
            inside = [one for one in dismissed if predecessor and predecessor.is_over(one.date) < v.is_over(one.date)]
            slow = [one.slow for one in find_slow(v.scope, of_antenna) if one.slow]
            found[v.id] = self.objection(v, predecessor, model_change, [*steps, *inside], slow)
        return found

    def objection(
        self,
        version: Version,
        predecessor: Version | None,
        model_change: ModelChange | None = None,
        steps: Sequence[Cut] = (),
        slow: Sequence[SlowChange] = (),
    ) -> str | None:
        """Why a version may not go into effect by itself, with the worst of its events; None if it may.

        Where the predecessor was fitted with another model, a change of C passes that `model_change` announced; what is
        in force to have changed between the two (`steps`, and the `slow` changes of the scope) is no objection.
        """
        in_force = (0.0, 0.0) if predecessor is None else find_in_force(version, predecessor, steps, slow)
        reason = self._object(version, predecessor, model_change, in_force)
        worst = version.anomalies.name_worst(EVENTS_NAMED)
        return f"{reason}; worst events: {worst}" if reason and worst else reason

    def _object(
        self,
        version: Version,
        predecessor: Version | None,
        model_change: ModelChange | None,
        in_force: tuple[float, float],
    ) -> str | None:
        if predecessor and predecessor.made > version.made and predecessor.window == version.window:
            return f"{predecessor.id[:12]} was made from later data and is in effect"
        for curve in version.curves:
            weakness = self._weakness(curve, is_odd=version.anomalies.fitted > 0)
            if weakness is not None:
                return f"{curve.name}: {weakness}"
            moved = _list_changes(version, predecessor, str(curve.dipole)) if predecessor else []
            if not moved or any(in_force[0] - self.change <= one <= in_force[1] + self.change for one in moved):
                continue
            change = min(moved, key=abs)
            told = f"{curve.name}: mean C differs by {change:+.1%} from before, at most {self.change:.1%} passes"
            inputs, old = version.inputs, predecessor.inputs if predecessor else {}
            other = [words for name, words in OF_SIMULATION.items() if inputs.get(name) != old.get(name)]
            told += f"; it was made with {' and '.join(other)}" if other else ""
            if predecessor is None or model_change is None or predecessor.model == version.model:
                return told
            low, high = find_announced(model_change, version.scope, str(curve.dipole))
            if not low <= change <= high:
                return f"{told}, or {low:+.1%} to {high:+.1%} for the change of the model"
        return None

    def _weakness(self, curve: CalibrationCurve, *, is_odd: bool) -> str | None:
        """What a curve by itself lacks; None if nothing. With odd spectra in the fit no antenna is doubted."""
        if curve.status == MISFIT:
            return (
                f"misfit of this curve or of its station: chi2 per degree of freedom {curve.chi2_per_dof:.1f} with "
                f"noise alone and {curve.chi2_per_dof_profiled or np.nan:.1f} with sky and pattern free within what is "
                "known; clock, place, letters, antenna or unit may be wrong, and lbacal investigate says what is"
            )
        if curve.status != CONVERGED or curve.c is None or curve.c_sigma_stat is None:
            seen = f"that see {24 * curve.lst_coverage:.1f} h of the sidereal day"
            of_none = f"of antennas with the {MIN_EVENTS} that a fit needs"
            return f"{curve.status} with {curve.events} events {seen if curve.events else of_none}"
        is_lent = curve.repeated is not None and curve.repeated.windows > 1  # other windows saw the rest of the day
        if curve.lst_coverage < self.coverage and not is_lent:
            return (
                f"{curve.events} events see {24 * curve.lst_coverage:.1f} h of the sidereal day, "
                f"at least {24 * self.coverage:.1f} h pass"
            )
        is_good = curve.flags == OK
        if is_good.mean() < self.band:
            bad = curve.frequency_mhz[~is_good]
            told = (
                f"{is_good.sum()} of {is_good.size} channels are good, at least {self.band:.0%} pass; "
                f"bad ones lie between {bad[0]:g} and {bad[-1]:g} MHz"
            )
            doubted = (curve.flags == UNCERTAIN) & (curve.c_sigma_stat / curve.c <= LARGEST_GOOD_ERROR)
            if np.any(doubted) and not is_odd:
                told += (
                    f"; in {doubted.sum()} another antenna, likelier than {LEAST_LIKELY:.0%} by these spectra, moves C "
                    f"by more than {LARGEST_GOOD_ERROR:.0%}: lbacal budget says which it may be, and antenna_doubt of "
                    "the instrument file is 0 where the antenna was measured"
                )
            return told
        error = float(np.mean(curve.c_sigma_stat[is_good] / curve.c[is_good]))
        if error > self.error:
            return (
                f"error of C {error:.1%} in its {is_good.sum()} good channels with {curve.events} events, "
                f"at most {self.error:.1%} passes"
            )
        return None


def find_in_force(
    version: Version, predecessor: Version, steps: Sequence[Cut], slow: Sequence[SlowChange]
) -> tuple[float, float]:
    """The range of changes of C that changes in force allow between two versions; no limits where a size is unknown."""
    windows, scope = (version.window, predecessor.window), version.scope
    first, last = min(since for since, _ in windows), max(until for _, until in windows)
    own = [one for one in steps if one.station == scope.station and one.antenna in (None, scope.antenna)]
    moved = list[float]()
    for one in own:
        if not first < one.date < last:
            continue
        power, _ = one.step_of(scope.dipole)
        if power is None:
            return -math.inf, math.inf
        is_earlier = version.until <= one.date or version.since < one.date <= predecessor.since
        moved.append((0.5 if is_earlier else -0.5) * math.log(power))
    spans = [(since / SECOND_US, until / SECOND_US) for since, until in windows]
    # where it stands at one instant, beside its mean over one window and over the other
    moved += [one.size * (one.depart(0.0, spans[1]) - one.depart(0.0, spans[0])) for one in slow]
    return math.expm1(sum(min(one, 0.0) for one in moved)), math.expm1(sum(max(one, 0.0) for one in moved))


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
    """Change of the band mean of C through one cable, None without both: which antennas were averaged is no jump."""
    if not (version.serves(dipole) and predecessor.serves(dipole)):
        return None
    is_known = dipole in version.chains and dipole in predecessor.chains
    curves = [through_common_cable(v, dipole) if is_known else v.curve_of(dipole) for v in (version, predecessor)]
    now, before = (mean_over_band(curve) for curve in curves)
    return now[0] / before[0] - 1.0 if now and before else None


def _list_changes(version: Version, predecessor: Version, dipole: str) -> list[float]:
    """Change of the band mean of C through one cable, and, of C of a path itself, as it is.

    That rests on its own spectra: where the record of its cable is corrected, it stays what it is.
    """
    through_cable = find_change_of_mean(version, predecessor, dipole)
    if through_cable is None or version.scope.antenna is None:
        return [] if through_cable is None else [through_cable]
    now, before = (mean_over_band(one.curve_of(dipole)) for one in (version, predecessor))
    return [through_cable, *([now[0] / before[0] - 1.0] if now and before else [])]


def find_predecessors(stores: Stores, scopes: Collection[Scope], middle: Instant) -> dict[Scope, str]:
    """The version of each scope in effect at the middle of a window, or else the last before it, or the first after.

    One most of whose events were flagged since is no measure: what they gave was not right.
    """
    found = _without_retracted(stores, stores.ledger.versions_at(scopes, middle))
    silent = {scope: (scope,) for scope in scopes if scope not in found}
    nearest = {
        scope: before or after for scope, (before, after) in stores.ledger.neighbours(silent, middle, None).items()
    }
    names = {scope: str(one.promotion.calibration) for scope, one in nearest.items() if one is not None}
    return found | _without_retracted(stores, names)


def _without_retracted(stores: Stores, names: Mapping[Scope, str]) -> dict[Scope, str]:
    retracted = find_retracted(stores, stores.versions.summaries(set(names.values())))
    return {scope: name for scope, name in names.items() if name not in retracted}
