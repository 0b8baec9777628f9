"""The form of the chain: what enters in front of A(nu), by the odds that data give each of `instrument.chain.FORMS`.

The forms are compared on the lines (s, b) of the mean path of each polarisation. With the noise N(nu) = n F in front
the intercepts are b = N s + H q, so that z(n) = b - N s has the mean H q and the covariance

    S(n) = C_bb - N C_sb - C_bs N + N N^T C_ss,

where C is that of the lines. Slopes and q, of which nothing is known, are integrated out in closed form,

    ln p(s, b | n) = -chi^2 / 2 - ln|S(n)| / 2 - ln|H^T S(n)^-1 H| / 2,    chi^2 = min over q of |z - H q|^2 in S(n)^-1,

and n on a grid by its prior. ln|S| matters: at a large n the level of the sky, if it is free, explains any intercept.

Where the sky is free, d ln P_sky = sum_k a_k m_k with a_k ~ N(0, 1), the a_k that are left along LST beside the lines
(`chain_test`) tell what the lines are shifted by and how uncertain that is: C contains the freedom that remains. What
no form explains widens all: where the least chi^2 exceeds its degrees of freedom, it is divided by their ratio. Both
polarisations see one sky, and what it does to one it does to the other: the mean of their ln p counts, not the sum.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from lbacal_core.calibration.channels import solve_without_interference
from lbacal_core.calibration.lines import PathLines, fit_lines, look_beside, move_lines
from lbacal_core.calibration.paths import MIN_LST_BINS, Paths, paths_of_scope, require_one_cable_each
from lbacal_core.calibration.singles import chain_forms
from lbacal_core.data.tables import read_prior
from lbacal_core.grids import Floats
from lbacal_core.instrument.chain import BEHIND, FORMS, PUBLISHED, SLOPED, Intercepts, noise_constants
from lbacal_core.linear import invert_symmetric, solve_symmetric
from lbacal_core.simulation.prior import SKY_HARMONICS, SkyPrior
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.table import harmonics_at
from lbacal_core.spectra.blocks import Recorded

PRIOR: Mapping[str, float] = dict(zip(FORMS, read_prior()["chain_form"].sizes, strict=True))
"""Probability of each form before the data are asked."""
SLOPES = np.linspace(-1.0, 1.0, 9)
"""Changes of N_LNA by 25 MHz, as a fraction, all alike: beyond, it would be negative within the band."""
AMOUNTS = np.concatenate([[0.0], np.geomspace(0.02, 3.0, 16)])
"""Noise in front of A(nu) over the sky: what is below 2 % of it the lines do not tell from none."""
ALIKE = 1e-6
"""Share by which N / G_ant must differ from a constant for the data to know where the noise enters."""
FORM_OF_CHAIN = "form of the chain"
"""Under this name the notes of a report and a term of the budget hold it."""
OPEN, EXCLUDED = 0.05, 0.1
"""Least probability of an open form, or of the data in it over those in the preferred one (strong: Jeffreys 1961)."""
MEANING: Mapping[str, str] = {
    PUBLISHED: "noise enters in front of the antenna's resonance, as published",
    BEHIND: "noise enters behind the antenna's resonance, N / G_ant, beside N_LNA in front of it",
    SLOPED: "N_LNA has a slope along frequency",
}


@dataclass(frozen=True)
class ChainForm:
    """The form of the chain that data prefer.

    Attributes
    ----------
    probability
        Probability of each form that they can tell from the published one; the published one alone where they say
        nothing.
    """

    probability: Mapping[str, float]

    @property
    def name(self) -> str:
        """The most probable form."""
        return max(self.probability, key=lambda form: self.probability[form])

    def is_open(self, form: str) -> bool:
        """Whether one of `FORMS` is possible: probable, or not excluded by the data, whatever the prior is."""
        return self.probability.get(form, 0.0) >= OPEN or self.odds_by_data(form) > EXCLUDED

    def odds_by_data(self, form: str) -> float:
        """Probability of the data in one of `FORMS` over that in the preferred one."""
        return self.probability.get(form, 0.0) / self.probability[self.name] * PRIOR[self.name] / PRIOR[form]

    def __str__(self) -> str:
        """Which form is preferred, with which odds, and which others are open, in one sentence."""
        if len(self.probability) == 1:
            return f"{MEANING[self.name]}; not compared with other forms"
        ranking = sorted(self.probability, key=lambda form: -self.probability[form])
        odds = self.probability[ranking[0]] / max(self.probability[ranking[1]], 1e-300)
        told = f"{odds:.3g} to 1" if odds < 1e6 else "more than a million to 1"
        prior = f"of which {PRIOR[PUBLISHED] / (1.0 - PRIOR[PUBLISHED]):.3g} to 1 for the published one is prior"
        words = f"{MEANING[self.name]} ({told} against the next form, {prior})"
        others = [MEANING[form] for form in ranking[1:] if self.is_open(form)]
        return "; ".join([words, *(f"open: {one}" for one in others)])


PUBLISHED_FORM = ChainForm({PUBLISHED: 1.0})
"""What spectra that cannot tell say."""


def compare_forms(spectra: Recorded, simulation: Simulation) -> ChainForm:
    """The probability of each form of the chain, by the mean path of each polarisation."""
    found: ChainForm = simulation.made.get(
        (FORM_OF_CHAIN, spectra.digest()), lambda: _compare_forms(spectra, simulation.with_form(PUBLISHED))
    )
    return found


def list_forms(simulation: Simulation) -> Mapping[str, Intercepts]:
    """The noise constants of each form that an instrument leaves open, the published one first."""
    instrument = simulation.instrument
    published = noise_constants(instrument)
    if instrument.stages:
        return {PUBLISHED: published}
    is_flat = float(np.ptp(instrument.antenna_gain)) < ALIKE * float(instrument.antenna_gain.mean())
    return {form: noise_constants(instrument, form) for form in FORMS if not (form == BEHIND and is_flat)}


def _compare_forms(spectra: Recorded, simulation: Simulation) -> ChainForm:
    forms = list_forms(simulation)
    if len(forms) == 1 or len(spectra) == 0:
        return PUBLISHED_FORM
    cables = require_one_cable_each(spectra, simulation.instrument)
    found = []
    for read in paths_of_scope(spectra, simulation, "array", cables):
        paths = read()
        if paths.members and paths.count_lst_bins()[0] >= MIN_LST_BINS:
            found.append(_weigh_forms(paths, simulation, forms))
    if not found:
        return PUBLISHED_FORM
    weight = np.mean(found, axis=0) + np.log([PRIOR[form] for form in forms])
    probability = np.exp(weight - logsumexp(weight))
    return ChainForm(dict(zip(forms, probability.tolist(), strict=True)))


def _weigh_forms(paths: Paths, simulation: Simulation, forms: Mapping[str, Intercepts]) -> list[float]:
    """Ln p of the lines of one path in each form."""
    dipole, is_present = paths.owners[0][2], np.isfinite(paths.relative_variance[0])
    sky = simulation.sky_power.at(dipole, paths.lst_hours)
    lines = fit_lines(paths.power, sky, paths.relative_variance, chain_forms(simulation.instrument))
    # interference is what stands out in every form
    known = lines.slope, lines.intercept, lines.information
    is_free = reduce(np.logical_and, [solve_without_interference(*known, one)[1][0] for one in forms.values()])
    sky = sky[is_present]
    path = PathLines.of(paths.power[0, is_present], sky, paths.relative_variance[0, is_present], lines)
    shift, covariance = free_sky(path, paths.lst_hours[is_present], simulation.prior, dipole)
    measured = np.concatenate([path.slope, path.intercept]) - shift
    amounts = [list_amounts(form, one, sky.mean(axis=0)) for form, one in forms.items()]
    design = forms[PUBLISHED].design
    tried = [integrate_lines(measured, covariance, before, design, ~is_free) for before, _ in amounts]
    dof = np.sum(~is_free) - forms[PUBLISHED].free_count
    excess = max(min(float(chi2.min()) for chi2, _ in tried) / max(dof, 1), 1.0)
    return [
        float(logsumexp(-chi2 / (2.0 * excess) - volume, b=weight))
        for (chi2, volume), (_, weight) in zip(tried, amounts, strict=True)
    ]


def free_sky(path: PathLines, lst_hours: Floats, prior: SkyPrior | None, dipole: str) -> tuple[Floats, Floats]:
    """Shift of the lines by a sky that is free within its prior and by the residuals along LST, and its covariance.

    Returns
    -------
    Shape (2 freq,) and (2 freq, 2 freq), all slopes first.
    """
    covariance = invert_symmetric(path.information)
    if prior is None:
        return np.zeros(len(covariance)), covariance
    series, basis = prior.series(dipole), harmonics_at(lst_hours, SKY_HARMONICS)
    look = look_beside(path.power / path.model - 1.0, path.of_sky, path.of_constant, basis)
    moved = move_lines(path, path.slope, basis, series)
    beside = look.respond(path.slope * path.of_sky, path.of_sky, path.of_constant, basis, series, moved)
    # look = beside^T a + N(0, 1), a ~ N(0, 1)
    left = invert_symmetric(np.eye(len(series)) + beside @ beside.T)
    return left @ beside @ look.value @ moved, covariance + moved.T @ left @ moved


def list_amounts(form: str, terms: Intercepts, sky: Floats) -> tuple[Floats, Floats]:
    """Noise in front of A(nu) in one of `FORMS`, shape (amount, freq), in the unit of P_sky, and the weight of each.

    An amount is half-normal about 0, of one mean sky power r.m.s. along frequency, as the weak prior of the fit is.
    """
    weight = np.gradient(AMOUNTS) * np.exp(-0.5 * AMOUNTS**2)
    weight /= weight.sum()
    amount = AMOUNTS / np.sqrt(np.mean((terms.front / sky) ** 2, axis=1, keepdims=True))
    flat = amount[0, :, None] * terms.front[0]
    if form == BEHIND:
        both = flat[:, None] + amount[1, :, None] * terms.front[1]
        return both.reshape(-1, sky.size), np.outer(weight, weight).ravel()
    slopes = SLOPES if form == SLOPED else np.zeros(1)
    sloped = flat[:, None] * (1.0 + slopes[:, None] * terms.front[-1])
    return sloped.reshape(-1, sky.size), np.repeat(weight / slopes.size, slopes.size)


def integrate_lines(
    measured: Floats, covariance: Floats, before: Floats, design: Floats, is_tested: NDArray[np.bool_]
) -> tuple[Floats, Floats]:
    """Chi^2, and (ln|S| + ln|H^T S^-1 H|) / 2 up to a constant, of each noise in front; shape (amount,) each.

    Parameters
    ----------
    measured, covariance
        (s, b), shape (2 freq,), and C, shape (2 freq, 2 freq).
    before
        N, shape (amount, freq).
    design
        H, shape (freq, k).
    is_tested
        Channels whose intercept counts, shape (freq,).
    """
    at, channels = np.flatnonzero(is_tested), is_tested.size
    row, column, cross = before[:, at, None], before[:, None, at], covariance[np.ix_(at, channels + at)]
    total = covariance[np.ix_(channels + at, channels + at)] - row * cross - cross.T * column
    total += row * column * covariance[np.ix_(at, at)]
    left = measured[channels + at] - before[:, at] * measured[at]
    # columns that are one in a flat receiver count once
    axes, size, _ = np.linalg.svd(design[at] / np.linalg.norm(design[at], axis=0), full_matrices=False)
    columns = np.concatenate(
        [np.broadcast_to(axes[:, size > ALIKE], (len(left), *axes[:, size > ALIKE].shape)), left[:, :, None]], axis=2
    )
    products = np.swapaxes(columns, 1, 2) @ solve_symmetric(total, columns)
    of_design, along = products[:, :-1, :-1], products[:, :-1, -1:]
    chi2 = products[:, -1, -1] - (along * solve_symmetric(of_design, along)).sum(axis=(1, 2))
    # data without noise leave nothing, to rounding
    volume = 0.5 * (np.linalg.slogdet(total)[1] + np.linalg.slogdet(of_design)[1])
    return np.maximum(chi2, 0.0), volume
