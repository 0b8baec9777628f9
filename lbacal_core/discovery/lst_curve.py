"""The search of a band-averaged LST curve for what its simulation gets wrong: one axis, but published of real data.

The model is the band power of P_sky relative to its level at LST 0, with a free offset for each dipole. Sets of causes
are fitted together. What is proposed to `grow` adds one more cause to each of the best sets of a size, because the best
pair need not contain the best single cause.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import f as f_distribution
from threadpoolctl import threadpool_limits

from lbacal_core.discovery.curve_fit import CurveFit, CurveFitter
from lbacal_core.discovery.curve_station import GRID_HOURS, Choice, gather_curve, list_choices, why_not
from lbacal_core.discovery.growth import grow
from lbacal_core.discovery.policy import CURVE_POLICY, Policy
from lbacal_core.discovery.trials import p_of, sigma_of
from lbacal_core.grids import Floats, require_same_grid
from lbacal_core.instrument import Instrument
from lbacal_core.lstcurve.compare import AS_RECORDED, band_weights
from lbacal_core.lstcurve.curve import LstCurve
from lbacal_core.lstcurve.noise import PointNoise, estimate_noise
from lbacal_core.skypower.differences import model_difference_modes
from lbacal_core.skypower.table import SkyPower


@dataclass(frozen=True)
class Rival:
    """Another cause in the place of one that was named.

    Attributes
    ----------
    correlation
        Correlation of the two signatures at the sizes found.
    is_excluded
        Whether the data exclude it.
    """

    choice: Choice
    fit: CurveFit
    correlation: float
    is_excluded: bool


@dataclass(frozen=True)
class CurveFinding:
    """One cause of the best set: the fit without it, and with it replaced by each other cause.

    Attributes
    ----------
    place
        Index of the cause in the set.
    rivals
        Every other cause in its place, best first.
    z
        Standard deviations before the look-elsewhere correction.
    """

    choice: Choice
    place: int
    without: CurveFit
    rivals: list[Rival]
    z: float
    p_value: float
    held_out_gain: float


@dataclass(frozen=True)
class CurveInvestigation:
    """The result of a search of an LST curve.

    Attributes
    ----------
    findings
        Most significant first.
    single
        Every cause fitted by itself, best first.
    alternatives
        Other sets, no more than one cause larger, that fit as well as the one named, best first.
    trials
        Trials factor of the catalogue: number of kinds of causes.
    structure_p
        Probability by which the points scatter as much about the model found.
    unidentifiable
        Causes that a curve can never show, with the reason.
    """

    fitter: CurveFitter
    band_mhz: tuple[float, float]
    first: CurveFit
    last: CurveFit
    findings: list[CurveFinding]
    single: list[CurveFit]
    alternatives: list[CurveFit]
    trials: float
    structure_p: float
    unidentifiable: Mapping[str, str]
    policy: Policy

    def is_open(self, fit: CurveFit) -> bool:
        """Whether the data leave open a set other than the best one."""
        rivals = [rival for finding in self.findings for rival in finding.rivals if not rival.is_excluded]
        return any(fit.labels == one.labels for one in [*self.alternatives, *(rival.fit for rival in rivals)])


def investigate_curve(
    curve: LstCurve,
    sky_power: SkyPower,
    instrument: Instrument,
    band_mhz: tuple[float, float],
    *,
    is_own_sky: bool,
    weights: str = AS_RECORDED,
    noise: PointNoise | None = None,
) -> CurveInvestigation:
    """Find what a simulated sky power gets wrong in an LST curve.

    Parameters
    ----------
    is_own_sky
        Whether the spread of sky and antenna models counts as noise. A sky power from a file is taken as exact.
    weights
        How channels weigh in the band: one of `lstcurve.compare.WEIGHTS`.
    noise
        Noise of the points; estimated where it is not given.
    """
    policy = CURVE_POLICY
    require_same_grid(sky_power.origin, sky_power.frequency_mhz, instrument.frequency_mhz, instrument.name)
    of_channels = band_weights(instrument, weights, band_mhz)
    modes = model_difference_modes(instrument.frequency_mhz, GRID_HOURS, instrument.dipole_azimuth_deg)
    with threadpool_limits(1):  # the arrays are small: threads cost ten times what they gain
        station = gather_curve(instrument, sky_power, of_channels)
        fitter = CurveFitter(curve, station, noise or estimate_noise(curve), modes if is_own_sky else None)
        choices = list_choices(station)
        search = _Search(fitter, choices, policy)
        steps = grow(search.first, search, policy.most_findings)
        last = steps[-1].candidate if steps else search.first
        findings = [search.finding(last, place) for place in range(len(last.choices))]
    return CurveInvestigation(
        fitter,
        band_mhz,
        search.first,
        last,
        sorted(findings, key=lambda finding: -finding.z),
        sorted((fit for fit in search.fits.values() if len(fit.choices) == 1), key=_by_chi2),
        search.alternatives(last),
        search.trials,
        float(f_distribution.sf(last.chi2 / last.dof, last.dof, fitter.noise.free)),
        why_not(station, choices),
        policy,
    )


def best_without(found: CurveInvestigation, kind: str, most: int = 3) -> CurveFit:
    """The best set of up to `most` causes without any of the kind `kind`: a finding of that kind must fit better."""
    choices = list_choices(found.fitter.station)
    with threadpool_limits(1):
        search = _Search(found.fitter, [choice for choice in choices if kind not in choice.kinds], found.policy)
        parents = [search.first]
        for _ in range(most):
            children = (fit for parent in parents for fit in search.children(parent))
            parents = sorted(children, key=_by_chi2)[: found.policy.beam]
    return min(search.fits.values(), key=lambda fit: fit.chi2)


class _Search:
    """Sets of causes fitted to one curve, each once."""

    def __init__(self, fitter: CurveFitter, choices: Sequence[Choice], policy: Policy) -> None:
        self.fitter, self.choices, self.policy = fitter, choices, policy
        self.trials = float(len({kind for choice in choices for kind in choice.kinds}))
        self.first = fitter.fit([])
        self.fits = {frozenset[str](): self.first}
        self.parents = [self.first]

    def extended(self, parent: CurveFit, choice: Choice) -> CurveFit:
        """The parent's set with one cause more, fitted from where the parent ended."""
        labels = frozenset([*parent.labels, choice.label])
        if labels not in self.fits:
            known = dict(zip(parent.labels, parent.sizes.tolist(), strict=True))
            chosen = [one for one in self.choices if one.label in labels]
            starts = [[known.get(one.label, start) for one in chosen] for start in choice.sizes.starts]
            self.fits[labels] = self.fitter.fit(chosen, starts=starts)
        return self.fits[labels]

    def children(self, parent: CurveFit) -> list[CurveFit]:
        """The parent's set with each cause whose kinds it does not contain."""
        taken = {kind for choice in parent.choices for kind in choice.kinds}
        return [self.extended(parent, choice) for choice in self.choices if not taken & choice.kinds]

    def propose(self, before: CurveFit) -> list[CurveFit]:
        """The best sets of the next size that are named and better than chance over the whole catalogue allows."""
        children = {fit.labels: fit for parent in self.parents for fit in self.children(parent)}
        grown = sorted(children.values(), key=_by_chi2)
        self.parents = grown[: self.policy.beam]
        named = [fit for fit in grown if not (fit.is_at_edge or any(choice.is_alias for choice in fit.choices))]
        return [
            fit for fit in named[: self.policy.rivals] if self.p_value(before, fit)[1] < self.policy.catalogue_alpha
        ]

    def model_of(self, candidate: CurveFit) -> CurveFit:
        """A candidate is its own model."""
        return candidate

    def held_out_gain(self, before: CurveFit, candidate: CurveFit) -> float:
        """Gain in log-likelihood on blocks of LST that were not fitted."""
        return self.fitter.held_out_gain(before, candidate)

    def p_value(self, fewer: CurveFit, more: CurveFit) -> tuple[float, float]:
        """Significance of one cause more, standard deviations, and its p-value over the whole catalogue.

        The noise level comes from the scatter of the points, or from the residuals of the larger set: the gain in
        chi^2 follows an F, not a chi^2 distribution.
        """
        gain = max(fewer.chi2 - more.chi2, 0.0) / more.scale
        z = sigma_of(float(f_distribution.sf(gain, 1, self.fitter.noise.free)))
        return z, p_of(z, self.trials)

    def finding(self, last: CurveFit, place: int) -> CurveFinding:
        """One cause of the set, with its gain in chi^2 and the causes that could replace it."""
        choice = last.choices[place]
        others = [one for one in last.choices if one is not choice]
        known = dict(zip(last.labels, last.sizes.tolist(), strict=True))
        without = self.fits.get(frozenset(one.label for one in others))
        if without is None:
            without = self.fitter.fit(others, starts=[[known[one.label] for one in others]] if others else ())
        own = self.fitter.signature(without, last)
        separable = (without.chi2 - last.chi2) / last.scale
        rivals = []
        for fit in sorted(self.children(without), key=_by_chi2):
            (new,) = set(fit.labels) - set(without.labels)
            if new == choice.label:
                continue
            r = _correlation(own, self.fitter.signature(without, fit))
            is_excluded = (
                min((fit.chi2 - last.chi2) / last.scale, separable * (1 - r**2)) >= self.policy.indistinguishable
            )
            rivals.append(Rival(fit.choices[fit.labels.index(new)], fit, r, is_excluded))
        z, p_value = self.p_value(without, last)
        gain = self.fitter.held_out_gain(without, last)
        return CurveFinding(choice, place, without, rivals, z, p_value, gain)

    def alternatives(self, last: CurveFit) -> list[CurveFit]:
        """Sets that fit as well, at most one cause larger, and that do not contain the whole best set."""
        return sorted(
            (
                fit
                for labels, fit in self.fits.items()
                if fit.chi2 < last.chi2 + self.policy.indistinguishable * last.scale
                and len(fit.choices) <= len(last.choices) + 1
                and fit.choices
                and labels != frozenset(last.labels)
            ),
            key=_by_chi2,
        )


def _by_chi2(fit: CurveFit) -> tuple[int, float]:
    """Sets of equal chi^2 keep the order of the catalogue."""
    return len(fit.choices), round(fit.chi2, 2)


def _correlation(one: Floats, other: Floats) -> float:
    scale = float(np.sqrt((one @ one) * (other @ other)))
    return float(one @ other) / scale if scale > 0 else 0.0
