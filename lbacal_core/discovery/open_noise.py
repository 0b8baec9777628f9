"""Sizes where the data hardly tell the noise in front of the receiver from that behind it.

A gain in front of N_RCU acts on the sky and on N_LNA, not on the noise behind: by how much it must have changed depends
on how the noise is shared. Where the fit leaves that open, a size is averaged over noise constants as the fit knows
them, weighed by how well each describes the effect that was found, and its error contains their scatter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr, ndtri

from lbacal_core.causes.cause import signature
from lbacal_core.chain.terms import ChainTerms
from lbacal_core.discovery.hypothesis import Hypothesis
from lbacal_core.discovery.refit import FittedModel, Noise, can_be_told_apart, refit, with_noise
from lbacal_core.grids import Floats
from lbacal_core.linear import invert_symmetric, solve_symmetric

OPEN_FROM = 0.05
"""Share of the power by which a noise constant must be uncertain: below, it moves a size by less than this share."""
HARDLY_KNOWN = 0.5
"""Relative error of a constant from which only its order of magnitude is known: its distribution is that of |N(0, s)|,
as the weak prior of the fit is."""
DRAWS, SEED = 64, 0
ENOUGH, NARROWER, MOST_ROUNDS = 12.0, 0.3, 5
"""Draws that must count: with fewer, an effect that itself says how noise is shared is looked at more closely, so much
at a time."""


@dataclass(frozen=True)
class OpenNoise:
    """The noise constants as the fit knows them on some paths, none below 0.

    Attributes
    ----------
    front, behind
        Typical constants, shape (r,) and (k,).
    covariance
        That of (front, behind), shape (r + k, r + k).
    """

    front: Floats
    behind: Floats
    covariance: Floats

    def draw(self, u: Floats) -> list[Noise]:
        """Constants in front and behind, for standard normal numbers of shape (draw, r + k)."""
        count = len(self.front)
        sigma = np.sqrt(np.diag(self.covariance))[:count]
        n = np.where(
            sigma > HARDLY_KNOWN * self.front,
            np.hypot(self.front, sigma) * -ndtri(ndtr(-u[:, :count]) / 2.0),
            np.maximum(self.front + sigma * u[:, :count], 0.0),
        )
        # what lies behind follows from what lies in front: the data determine their sum
        of_front, across = self.covariance[:count, :count], self.covariance[:count, count:]
        onto = solve_symmetric(of_front, across)
        values, turned = np.linalg.eigh(self.covariance[count:, count:] - across.T @ onto)
        scatter = u[:, count:] @ (turned * np.sqrt(np.maximum(values, 0.0))).T
        return list(zip(n, np.maximum(self.behind + (n - self.front) @ onto + scatter, 0.0), strict=True))


@dataclass(frozen=True)
class AveragedSize:
    """A size averaged over the noise constants that the fit leaves open.

    Attributes
    ----------
    size, sigma
        Mean and standard deviation.
    noise
        Mean constants, by which the cause acts with the mean size.
    gain
        2 ln of the likelihood averaged over these constants in units of that with the fitted ones: the gain in chi^2 of
        a cause whose template has the form of the effect with another share of the noise.
    """

    size: float
    sigma: float
    noise: Noise
    gain: float


def average_size(model: FittedModel, number: int) -> AveragedSize | None:
    """Average a size over the noise constants that the fit leaves open; None where it leaves none open.

    Parameters
    ----------
    number
        Which of the hypotheses of the model.
    """
    one = model.hypotheses[number]
    noise = open_noise(model, one)
    if noise is None:
        return None
    from scipy.stats import qmc  # half a second to import

    normal = ndtri(qmc.Sobol(len(noise.covariance), seed=SEED).random(DRAWS))
    centre, scale = np.zeros(normal.shape[1]), 1.0
    for _ in range(MOST_ROUNDS):
        u = centre + scale * normal
        drawn = noise.draw(u)
        size, gain = _fit_sizes(model, one, drawn)
        if not np.any(np.isfinite(gain)):
            return None
        # by likelihood and prior over the density of the draws
        gain += 0.5 * (np.sum(normal**2, axis=1) - np.sum(u**2, axis=1)) + normal.shape[1] * np.log(scale)
        weight = np.exp(gain - gain.max())
        evidence = float(gain.max() + np.log(weight.mean()))
        weight /= weight.sum()
        if 1.0 / np.sum(weight**2) >= ENOUGH:
            break
        centre, scale = weight @ u, scale * NARROWER
    mean, relative = float(weight @ size), one.uncertainty / one.size
    sigma = float(np.sqrt(weight @ ((relative * size) ** 2 + (size - mean) ** 2)))
    front, behind = (weight @ np.stack(part) for part in zip(*drawn, strict=True))
    return AveragedSize(mean, sigma, (front, behind), 2.0 * evidence)


def refit_over_noise(before: FittedModel, new: Hypothesis) -> tuple[FittedModel, float] | None:
    """Fit everything with a hypothesis more, by the noise constants that it prefers where the fit leaves them open.

    Returns
    -------
    The fitted model, and what its chi^2 gains on average over such constants; None as in `refit`.
    """
    model = refit(before, new)
    if model is None:
        return None
    averaged = average_size(model, len(model.hypotheses) - 1)
    if averaged is None:
        return model, 0.0
    again = refit(before, replace(new, size=averaged.size), averaged.noise)
    averaged = None if again is None else average_size(again, len(again.hypotheses) - 1)
    return (model, 0.0) if again is None or averaged is None else (again, averaged.gain)


def open_noise(model: FittedModel, one: Hypothesis) -> OpenNoise | None:
    """The noise constants of the paths of a hypothesis; None where all of them are known."""
    constants, covariance = model.baseline.noise_of(one.target.is_member)
    sigma, terms, intercepts = np.sqrt(np.diag(covariance)), model.baseline.terms, model.station.conditions.intercepts
    count, power = len(intercepts.front), terms.power()
    forms = [*(form * terms.front for form in intercepts.front), *intercepts.behind]
    if all(np.mean(s * form / power) < OPEN_FROM for s, form in zip(sigma, forms, strict=True)):
        return None
    return OpenNoise(constants[:count], constants[count:], covariance)


def _fit_sizes(model: FittedModel, one: Hypothesis, drawn: Sequence[Noise]) -> tuple[Floats, Floats]:
    """The size with each noise, and by how much ln L is larger than with the fitted noise, shape (draw,).

    Hypotheses on the same paths move with it.
    """
    conditions, fitted_terms = model.station.conditions, model.baseline.terms
    there = [one, *(h for h in model.hypotheses if h is not one and np.any(h.target.is_member & one.target.is_member))]
    targets = [h.target for h in there]
    fitted = _log_ratio(there, fitted_terms, model)
    size, gain = np.zeros(len(drawn)), np.full(len(drawn), -np.inf)  # no more noise of a stage that has none
    for k, (n, q) in enumerate(drawn):
        terms = with_noise(model.station, fitted_terms, (n, q))
        templates = [signature(h.cause, terms, conditions, h.template, h.size) for h in there]
        missed = fitted - _log_ratio(there, terms, model)
        score, information = model.linear.products([*templates, missed], [*targets, one.target])
        if can_be_told_apart(information[:-1, :-1]):
            inverse = invert_symmetric(information[:-1, :-1])
            onto = score[:-1] + information[:-1, -1]
            size[k] = one.size + inverse[0] @ onto
            gain[k] = 0.5 * (onto @ inverse @ onto - information[-1, -1]) - score[-1]
    return size, gain


def _log_ratio(hypotheses: Sequence[Hypothesis], terms: ChainTerms, model: FittedModel) -> Floats:
    """Ln of the power with the hypotheses over power without, shape (class, event, freq)."""
    changed = terms
    for one in hypotheses:
        changed = one.cause.apply(changed, model.station.conditions, one.template, one.size)
    return np.asarray(np.log(changed.power() / terms.power()))
