"""The search of a band-averaged LST curve for what its simulation gets wrong: one axis, but published of real data.

The model is the band power of P_sky and electronic noise relative to its level at LST 0, with a free offset for each
dipole. It grows by one cause at a time, as that of spectra does (`lbacal_core.discovery.growth`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc
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
from lbacal_core.lstcurve.noise_share import NoisePrior, noise_prior
from lbacal_core.skypower.differences import FULL_MAPS, model_difference_modes
from lbacal_core.skypower.table import SkyPower


@dataclass(frozen=True)
class Rival:
    """The last fit with another cause in the place of one that was found.

    Attributes
    ----------
    cause
        Identifier of the other cause.
    correlation
        Correlation of the two signatures at the sizes found.
    is_excluded
        Whether the data exclude it.
    """

    cause: str
    fit: CurveFit
    correlation: float
    is_excluded: bool


@dataclass(frozen=True)
class CurveFinding:
    """A cause that was found: the fit without it, and with it replaced by each other cause.

    Attributes
    ----------
    place
        Index of the cause in the last fit.
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
    trials: float
    structure_p: float
    unidentifiable: Mapping[str, str]
    policy: Policy

    @property
    def open(self) -> list[CurveFit]:
        """Sets that the data leave open beside the one named: one of its causes is replaced by another, best first."""
        rivals = [rival.fit for finding in self.findings for rival in finding.rivals if not rival.is_excluded]
        return sorted(rivals, key=lambda fit: fit.chi2)


def investigate_curve(
    curve: LstCurve,
    sky_power: SkyPower,
    instrument: Instrument,
    band_mhz: tuple[float, float],
    *,
    is_own_sky: bool,
    weights: str = AS_RECORDED,
    noise: PointNoise | None = None,
    prior: NoisePrior | None = None,
    without: str | None = None,
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
    prior
        What is known of the electronic noise; what is published, where it is not given.
    without
        A kind of cause that is left out: a finding of that kind must fit better than all others.
    """
    policy = CURVE_POLICY
    require_same_grid(sky_power.origin, sky_power.frequency_mhz, instrument.frequency_mhz, instrument.name)
    of_channels = band_weights(instrument, weights, band_mhz)
    modes = model_difference_modes(instrument, GRID_HOURS, FULL_MAPS)
    with threadpool_limits(1):  # the arrays are small: threads cost ten times what they gain
        station = gather_curve(
            instrument, sky_power, of_channels, prior or noise_prior(instrument, band_mhz, of_channels)
        )
        fitter = CurveFitter(curve, station, noise or estimate_noise(curve), modes if is_own_sky else None)
        choices = list_choices(station)
        search = _Search(fitter, [choice for choice in choices if without not in choice.kinds], policy)
        first = fitter.fit([])
        single = search.extended(first)
        steps = grow(first, search, policy.most_findings)
        last = steps[-1].candidate if steps else first
        findings = [search.finding(last, place) for place in range(len(last.choices))]
    return CurveInvestigation(
        fitter,
        band_mhz,
        first,
        last,
        sorted(findings, key=lambda finding: -finding.z),
        single,
        search.trials,
        float(fdtrc(last.dof, fitter.noise.free, last.chi2 / last.dof)),
        why_not(station, choices),
        policy,
    )


class _Search:
    """The search of one curve as `grow` wants it."""

    def __init__(self, fitter: CurveFitter, choices: Sequence[Choice], policy: Policy) -> None:
        self.fitter, self.choices, self.policy = fitter, choices, policy
        self.trials = float(len({kind for choice in choices for kind in choice.kinds}))

    def extended(self, before: CurveFit) -> list[CurveFit]:
        """The causes of a fit with each one more whose kinds it does not contain, fitted, best first."""
        taken = {kind for choice in before.choices for kind in choice.kinds}
        start = dict(zip(before.labels, before.sizes.tolist(), strict=True))
        fits = []
        for new in self.choices:
            if not taken & new.kinds:
                chosen = {*before.labels, new.label}
                fits.append(self.fitter.fit([one for one in self.choices if one.label in chosen], start=start))
        # Fits of equal chi^2 keep the order of the catalogue.
        return sorted(fits, key=lambda fit: round(fit.chi2, 2))

    def propose(self, before: CurveFit) -> list[CurveFit]:
        """The best fits with one cause more that are named and better than chance over the whole catalogue allows."""
        named = [
            fit
            for fit in self.extended(before)
            if not (fit.is_at_edge or any(choice.is_alias for choice in fit.choices))
        ]
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
        z = sigma_of(float(fdtrc(1, self.fitter.noise.free, gain)))
        return z, p_of(z, self.trials)

    def finding(self, last: CurveFit, place: int) -> CurveFinding:
        """One cause of the set, with its gain in chi^2 and the causes that could replace it."""
        choice = last.choices[place]
        others = [one for one in last.choices if one is not choice]
        without = self.fitter.fit(others, start=dict(zip(last.labels, last.sizes.tolist(), strict=True)))
        own = self.fitter.signature(without, last)
        separable = (without.chi2 - last.chi2) / last.scale
        rivals = []
        for fit in self.extended(without):
            (new,) = set(fit.labels) - set(without.labels)
            if new == choice.label:
                continue
            r = _correlation(own, self.fitter.signature(without, fit))
            is_excluded = (
                min((fit.chi2 - last.chi2) / last.scale, separable * (1 - r**2)) >= self.policy.indistinguishable
            )
            rivals.append(Rival(fit.choices[fit.labels.index(new)].cause.identifier, fit, r, is_excluded))
        z, p_value = self.p_value(without, last)
        gain = self.fitter.held_out_gain(without, last)
        return CurveFinding(choice, place, without, rivals, z, p_value, gain)


def _correlation(one: Floats, other: Floats) -> float:
    scale = float(np.sqrt((one @ one) * (other @ other)))
    return float(one @ other) / scale if scale > 0 else 0.0
