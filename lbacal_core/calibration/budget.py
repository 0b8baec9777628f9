"""The budget of C: every change of an input is put into a full refit of the same data.

The data are those of the reference chains, the mean of all paths for each polarisation, so that all refits together
take a second or two.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logit, logsumexp
from threadpoolctl import threadpool_limits

from lbacal_core.calibration.chain_form import FORM_OF_CHAIN, ChainForm, compare_forms, list_forms
from lbacal_core.calibration.chain_test import FittedPaths
from lbacal_core.calibration.channels import LARGEST_GOOD_ERROR, LEAST_LIKELY, solve_without_interference
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.calibration.lines import ChainForms, Lines, fit_lines
from lbacal_core.calibration.paths import MIN_LST_BINS, Paths, paths_of_scope, require_one_cable_each
from lbacal_core.calibration.separable import SeparableSolution
from lbacal_core.calibration.singles import chain_forms
from lbacal_core.curves.covariance import Budget, BudgetTerm
from lbacal_core.curves.curves import OK, UNCERTAIN, CalibrationCurve, FitReport
from lbacal_core.data.tables import read_prior
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.instrument.chain import Intercepts, noise_constants
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.simulation.prior import DEFAULT_SKY_BUDGET, PAPER_BUDGET, SkyPrior
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.sky_terms import SkyTerm
from lbacal_core.sky.table import read_at
from lbacal_core.spectra.blocks import Recorded
from lbacal_core.spectra.spectra import Spectra

OTHER_ANTENNA = "another antenna"
SMALLEST_DOUBT = 0.001
"""Another antenna that moves ln C by less than this is no term."""
SMALLEST_SHARE = 1e-4
"""Vectors of a term whose squares add less than this to its variance are left out."""


@dataclass(frozen=True)
class _Refit:
    """The mean path of one polarisation, and its fit."""

    paths: Paths
    sky: Floats
    terms: Intercepts
    forms: ChainForms
    log_c: Floats

    @classmethod
    def of(cls, paths: Paths, sky: Floats, terms: Intercepts, forms: ChainForms) -> _Refit:
        """The fit with the sky as it is."""
        plain = cls(paths, sky, terms, forms, np.zeros(sky.shape[1]))
        return replace(plain, log_c=plain.fit(paths.power, sky))

    def _fit_lines(self, power: Floats, sky: Floats) -> Lines:
        return fit_lines(power, sky, self.paths.relative_variance, self.forms)

    def _solve(self, lines: Sequence[Lines]) -> tuple[SeparableSolution, NDArray[np.bool_]]:
        """The chain fitted to several lines at once."""
        slope, intercept, information = (
            np.concatenate(values)
            for values in zip(*((one.slope, one.intercept, one.information) for one in lines), strict=True)
        )
        return solve_without_interference(slope, intercept, information, self.terms)

    def fit(self, power: Floats, sky: Floats) -> Floats:
        """Ln C up to a constant along time, shape (freq,); NaN where it is not determined."""
        return _log_c(self._solve([self._fit_lines(power, sky)])[0].x[0])

    def change_sky(self, change: SkyTerm) -> list[Lines]:
        """The lines with a change of ln P_sky, for both of its signs."""
        hours = self.paths.lst_hours - change.lst_hours[0]
        factor = np.exp(read_at(change.d_ln_p[self.paths.owners[0][2]], hours))
        return [self._fit_lines(self.paths.power, sky) for sky in (self.sky * factor, self.sky / factor)]

    def compare_signs(self, changed: Sequence[Sequence[Lines]]) -> Floats:
        """Change of ln C by each change of ln P_sky: half the difference of both signs, shape (change, freq)."""
        solution, _ = self._solve([one for both in changed for one in both])
        log_c = _log_c(solution.x).reshape(len(changed), 2, -1)
        return np.asarray((log_c[:, 0] - log_c[:, 1]) / 2.0)

    def try_antennas(self, prior: SkyPrior) -> tuple[Floats, Floats]:
        """Other antennas fitted to the same data.

        Returns
        -------
        Ln of the probability of the data with each over that with the instrument's own, shape (antenna,), and the
        change of ln C, shape (antenna, freq).
        """
        paths, dipole = self.paths, self.paths.owners[0][2]
        others = [self.sky * np.exp(read_at(one.change[dipole], paths.lst_hours)) for one in prior.antennas]
        lines = [self._fit_lines(paths.power, sky) for sky in (*others, self.sky)]
        solution, is_free = self._solve(lines)
        predictions, own = [], slice(-1, None)
        for k, sky in enumerate(others):
            slope, behind = solution.x[k], solution.q[k] @ self.terms.behind
            intercept = np.where(is_free[k], lines[k].intercept[0], self.terms.before(solution.n[k]) * slope + behind)
            predictions.append(slope * sky + intercept)
        fitted = FittedPaths(
            paths.power, self.sky, paths.relative_variance, paths.lst_hours, lines[-1], solution.n[own],
            solution.x[own], self.terms, is_free[own], prior, dipole,
        )  # fmt: skip
        return np.nan_to_num(fitted.compare(np.array(predictions)), nan=-np.inf), _log_c(solution.x[:-1]) - self.log_c

    def exchange_form(self, terms: Intercepts) -> Floats:
        """Change of ln C by other noise constants."""
        return replace(self, terms=terms).fit(self.paths.power, self.sky) - self.log_c

    def add_power(self, fraction: float) -> Floats:
        """Change of ln C by power that is recorded at all times, a fraction of the mean."""
        is_present = np.isfinite(self.paths.relative_variance[0])
        mean = self.paths.power[:, is_present].mean(axis=1, keepdims=True)
        return self.fit(self.paths.power + fraction * mean, self.sky) - self.log_c


def compute_budget(spectra: Recorded, simulation: Simulation, sky_budget: str = DEFAULT_SKY_BUDGET) -> Budget:
    """The systematic terms of C that all curves of these data share.

    Parameters
    ----------
    sky_budget
        Where the error of the sky is taken from: a name of `SKY_BUDGETS`.
    """
    cables = require_one_cable_each(spectra, simulation.instrument)
    noise, forms = simulation.noise, chain_forms(simulation.instrument)
    # threads of BLAS cost more than they give for matrices as small as these
    with threadpool_limits(1), ThreadPoolExecutor(os.cpu_count()) as pool:
        changes, prior = simulation.changes(sky_budget), simulation.prior
        means = pool.map(lambda read: read(), paths_of_scope(spectra, simulation, "array", cables))
        refits = {
            paths.owners[0][2]: _Refit.of(
                paths, simulation.sky_power.at(paths.owners[0][2], paths.lst_hours), noise, forms
            )
            for paths in means
            for letter in [paths.owners[0][2]]
            if paths.members and paths.count_lst_bins()[0] >= MIN_LST_BINS  # else no curve has values
        }
        found = {
            polarisation: refit.compare_signs(list(pool.map(refit.change_sky, changes)))
            for polarisation, refit in refits.items()
            if changes
        }
        terms = [
            BudgetTerm(change.name, change.source, {p: _finite(vectors[k])[None] for p, vectors in found.items()})
            for k, change in enumerate(changes)
        ]
        if sky_budget != PAPER_BUDGET:
            interference = read_prior()["interference"]
            left = {p: _finite(refit.add_power(interference.size))[None] for p, refit in refits.items()}
            terms.append(BudgetTerm("interference left", interference.source, left))
            terms += _gain_terms(simulation.instrument, list(refits))
        unsure: Mapping[str, NDArray[np.bool_]] = {}
        if prior is not None and prior.antennas and refits:
            of_antennas, unsure = _doubt_antenna(refits, prior, simulation.instrument.antenna_doubt)
            terms += of_antennas
        terms += _doubt_instrument(refits, simulation)
        if refits:
            terms += _doubt_form(refits, simulation, compare_forms(spectra, simulation))
        return Budget(simulation.instrument.frequency_mhz, tuple(_gather(terms)), unsure)


def _doubt_antenna(
    refits: Mapping[str, _Refit], prior: SkyPrior, doubt: float | None
) -> tuple[list[BudgetTerm], dict[str, NDArray[np.bool_]]]:
    """What C would be with other antennas, each by the root of the probability that it is that one.

    And the channels that one moves by more than C of a good channel may be off, all that do so together likely enough.
    """
    tried = {p: refit.try_antennas(prior) for p, refit in refits.items()}
    gain = np.sum([one for one, _ in tried.values()], axis=0)
    of_any = read_prior()["other_antenna"].size if doubt is None else doubt
    log_odds = gain + np.log([one.share for one in prior.antennas]) + logit(of_any)
    probability = np.exp(log_odds - np.logaddexp(0.0, logsumexp(log_odds)))
    changes = {p: np.array([_finite(one) for one in found]) for p, (_, found) in tried.items()}
    unsure = {p: probability @ (np.abs(one) > LARGEST_GOOD_ERROR) > LEAST_LIKELY for p, one in changes.items()}
    vectors = {p: np.sqrt(probability)[:, None] * one for p, one in changes.items()}
    if max(float(np.max(np.sum(one**2, axis=0))) for one in vectors.values()) < SMALLEST_DOUBT**2:
        return [], unsure
    likely = prior.antennas[int(np.argmax(probability))].name
    source = f"probability {probability.sum():.1g} by these data, most likely {likely}"
    return [BudgetTerm(OTHER_ANTENNA, source, vectors)], unsure


def _doubt_instrument(refits: Mapping[str, _Refit], simulation: Simulation) -> list[BudgetTerm]:
    """What C would be with the gains and stages that the instrument may have instead.

    C^2 = G_ant / s (eq. cal_equation): G_ant enters by itself, all else by how it refers noise to the sky.
    """
    own, terms = simulation.instrument, []
    for name, others in own.alternatives.items():
        of_gain = np.array([0.5 * np.log(one.antenna_gain / own.antenna_gain) for one in others])
        noise = [noise_constants(one, simulation.form) for one in others]
        vectors = {
            dipole: of_gain + [_finite(refit.exchange_form(one)) for one in noise] for dipole, refit in refits.items()
        }
        is_of_gain = all(np.allclose(one, of_gain) for one in vectors.values())
        terms.append(BudgetTerm(name, "alternatives of the instrument, a refit each", vectors, is_of_gain))
    return terms


def _doubt_form(refits: Mapping[str, _Refit], simulation: Simulation, found: ChainForm) -> list[BudgetTerm]:
    """What C would be in the other forms of the chain, each by the root of its probability.

    Their squares add to the variance of ln C between the forms, about the form that C is of.
    """
    forms = list_forms(simulation)
    rivals = {form: p for form, p in found.probability.items() if form != simulation.form}
    vectors = {
        dipole: np.array([p**0.5 * _finite(refit.exchange_form(forms[form])) for form, p in rivals.items()])
        for dipole, refit in refits.items()
    }
    if not rivals or max(float(np.max(np.sum(one**2, axis=0))) for one in vectors.values()) < SMALLEST_DOUBT**2:
        return []
    return [BudgetTerm(FORM_OF_CHAIN, str(found), vectors)]


def add_budget(report: FitReport, budget: Budget) -> FitReport:
    """The report with the systematic errors of a budget.

    A curve whose `chi2_per_dof` is above what noise makes of it, without being a misfit, has one more term of its own:
    its statistical error times (chi^2 per degree of freedom - 1)^1/2, fully correlated along frequency. A channel is
    `uncertain` where another antenna moves C by more than the paper's total error, with more than `LEAST_LIKELY`.
    """
    curves = [_with_errors(curve, budget) if curve.c is not None else curve for curve in report.curves]
    return replace(report, curves=tuple(curves), budgets={budget.digest: budget})


def largest_chi2_per_dof(channels: int) -> float:
    """The largest chi^2 per degree of freedom that noise makes: three of its standard deviations above 1."""
    return 1.0 + 3.0 * float(np.sqrt(2.0 / (channels - 3)))


def _with_errors(curve: CalibrationCurve, budget: Budget) -> CalibrationCurve:
    if curve.c is None or curve.c_sigma_stat is None or curve.covariance is None:
        return curve
    covariance = replace(curve.covariance, budget=budget.digest)
    variance = budget.variance(str(curve.dipole))
    excess = (curve.chi2_per_dof or 1.0) - 1.0
    if 1.0 + excess > largest_chi2_per_dof(curve.frequency_mhz.size):
        own = np.sqrt(excess) * curve.c_sigma_stat / curve.c
        covariance = covariance.with_own(own)
        variance = variance + own**2
    is_unsure = budget.unsure.get(str(curve.dipole), np.zeros(curve.frequency_mhz.size, dtype=bool))
    flag = np.where((curve.flags == OK) & is_unsure, UNCERTAIN, curve.flags)
    return replace(
        curve,
        flag=tuple(flag.tolist()),
        c_sigma_sys=np.where(curve.has_value, curve.c * np.sqrt(variance), np.nan),
        covariance=covariance,
    )


def _gain_terms(instrument: Instrument, polarisations: Sequence[str]) -> list[BudgetTerm]:
    """Errors of G_ant: C^2 is proportional to it. The unit of a relative one is a convention and no error."""
    gain = instrument.gain_provenance
    if gain is None:
        return []
    sizes = {"shape of the antenna gain": gain.shape_error}
    if gain.kind == "absolute" and gain.scale_error is not None:
        sizes["level of the antenna gain"] = np.full(instrument.frequency_mhz.size, gain.scale_error)
    return [
        BudgetTerm(name, gain.source, dict.fromkeys(polarisations, size[None] / 2.0), is_of_gain=True)
        for name, size in sizes.items()
        if size is not None
    ]


def _gather(terms: Sequence[BudgetTerm]) -> list[BudgetTerm]:
    """Terms whose names are alike up to a bracket, as one with several vectors; those that add nothing are left out."""
    groups: dict[str, list[BudgetTerm]] = {}
    for term in terms:
        groups.setdefault(term.name.partition(" (")[0], []).append(term)
    return [
        BudgetTerm(
            name,
            "; ".join(term.source for term in group),
            _strongest({p: np.concatenate([term.vectors[p] for term in group]) for p in group[0].vectors}),
            group[0].is_of_gain,
        )
        for name, group in groups.items()
    ]


def _strongest(vectors: Mapping[str, Floats]) -> dict[str, Floats]:
    """The principal axes of a few vectors, shape (vector, freq) for each polarisation.

    The axes are those of both polarisations together: a vector is one error, which moves X and Y alike.
    """
    if all(len(of_one) == 1 for of_one in vectors.values()):
        return dict(vectors)
    _, size, axes = np.linalg.svd(np.concatenate(list(vectors.values()), axis=1), full_matrices=False)
    keep: NDArray[np.bool_] = size**2 > SMALLEST_SHARE * np.sum(size**2)
    keep[0] = True
    # the sign of an axis is free; this one is the same on every machine
    scaled = (size * np.where(axes.sum(axis=1) < 0, -1.0, 1.0))[keep, None] * axes[keep]
    return dict(zip(vectors, np.split(scaled, len(vectors), axis=1), strict=True))


def _log_c(slope: Floats) -> Floats:
    """Ln C up to a constant; NaN where the slope is not positive."""
    return np.where(slope > 0, -0.5 * np.log(np.where(slope > 0, slope, 1.0)), np.nan)


def _finite(vector: Floats) -> Floats:
    """A vector with channels that have no value as those beside them."""
    at = np.isfinite(vector)
    channel = np.arange(vector.size)
    return np.asarray(np.interp(channel, channel[at], vector[at])) if np.any(at) else np.zeros(vector.size)


def measure_electronics(spectra: Spectra, simulation: Simulation) -> BudgetTerm | None:
    """The departure of single antennas from their mean, each through its own cable; None for fewer than three paths.

    What a curve of a station or of the array has beside the shared terms when it is used for one antenna; the curve of
    a path by itself has its statistical error instead.
    """
    report = fit_calibration(spectra, simulation, "array")
    chains = zip(report.curves, report.chains, strict=True)
    found = {curve.dipole: chain.spreads for curve, chain in chains if chain is not None and chain.spreads is not None}
    if not found:
        return None
    vectors = {str(p): 0.5 * np.sqrt(one.all_paths.variance)[None] for p, one in found.items()}
    paths = max(one.all_paths.paths for one in found.values())
    return BudgetTerm("electronics between antennas", f"{paths} paths fitted by themselves", vectors)


# How well a fit knows what an antenna records without the sky.


def electronics_sigma(curve: CalibrationCurve, simulation: Simulation) -> Floats:
    """Standard deviation of `Simulation.electronics`, shape (freq,), ADC^2/Ohm/MHz.

    The mean recorded power is known far better than its split: what the sky is given too much, the electronics get too
    little. With s = G_ant/C^2 the sky's part is s P_sky, and an error of ln C changes it by -2 s P_sky. A sky that is
    brighter than the model changes C and leaves s P_sky as it is.
    """
    if curve.c is None or curve.c_sigma_stat is None or curve.dipole is None:
        raise BadInputError(curve.name, "a curve of one polarisation with its statistical error", curve.status)
    slope, sky = simulation.instrument.antenna_gain / curve.c**2, simulation.sky_power.of_station(curve.station)
    return np.asarray(2.0 * curve.c_sigma_stat / curve.c * slope * sky.power[curve.dipole].mean(axis=0))
