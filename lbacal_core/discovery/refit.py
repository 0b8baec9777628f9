"""The fitted model: chain and hypotheses fitted together, not linearised, and the gain on held-out data.

Each round divides the recorded power by the ratio of power with and without the hypotheses, fits the chain again, and
moves the sizes by Newton's step. The rounds end at the joint maximum of the likelihood of chain and sizes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from lbacal_core.causes.cause import Template, signature, spectral_signature
from lbacal_core.discovery.baseline import Baseline, fit_baseline
from lbacal_core.discovery.hypothesis import Hypothesis
from lbacal_core.discovery.noise import NoiseLevels, mean_of_paths, split_residuals
from lbacal_core.discovery.project import EventGains, LinearModel
from lbacal_core.discovery.scan import group_templates
from lbacal_core.discovery.station import SkyModes, Station
from lbacal_core.discovery.view import SMALLEST_SHARE
from lbacal_core.grids import Floats
from lbacal_core.instrument.chain import ChainTerms
from lbacal_core.linear import invert_symmetric, solve_symmetric

MAX_ROUNDS = 8
"""Newton steps: causes that are close to linear need two or three."""
CHAIN_FITS = 8
CHAIN_STANDS_STILL = 1e-3
"""Fits of the chain beside hypotheses, at most, and the share of what these do to the power by which that may still
move with the chain: less than `STANDS_STILL` for effects of 20 standard deviations."""
STANDS_STILL = 0.02
"""Standard deviations by which a size may still move when the fit counts as converged."""
LARGEST_CHANGE = 50.0
"""Factor on the power beyond which a fit has run away."""
SMALLEST_RATIO = 1e-3
"""Floor of power with causes over power without: a power cannot be negative."""
SMALLEST_DIFFERENCE = 1e-3
"""Smallest eigenvalue of the correlations of hypotheses that are fitted together: 1 - r^2 of one against the others."""
DATE_BLOCKS, LST_BLOCKS, FOLDS = 8, 12, 4
"""Folds of the held-out test are made of eighths of the time and of 2 h of LST."""


Noise = tuple[Floats, Floats]
"""Noise constants in front of A(nu), shape (r,), and behind it, shape (k,)."""


@dataclass(frozen=True)
class FittedModel:
    """The chain and the hypotheses fitted together, and the linear model of their residuals.

    Attributes
    ----------
    noise
        Noise constants by which the hypotheses act, where the fit leaves them open and the effects say more; None where
        they are those of the fit.
    """

    hypotheses: list[Hypothesis]
    baseline: Baseline
    linear: LinearModel
    is_converged: bool
    noise: Noise | None = None

    @property
    def station(self) -> Station:
        """The data, without the events on which a covariate of the hypotheses is unknown."""
        return self.linear.station


def fit_chain(station: Station, modes: SkyModes | None = None) -> FittedModel:
    """Fit the chain of every path without any hypothesis.

    Parameters
    ----------
    modes
        Relative changes of P_sky by which sky and antenna models differ, or None where P_sky is exact.
    """
    baseline = fit_baseline(station)
    return FittedModel([], baseline, linearise(station, baseline, modes), is_converged=True)


def linearise(
    station: Station, baseline: Baseline, modes: SkyModes | None, hypotheses: Sequence[Hypothesis] = ()
) -> LinearModel:
    """The linear model of a baseline's residuals, with noise levels estimated from them.

    Parameters
    ----------
    hypotheses
        What was divided out of the power before the baseline was fitted. The free vectors are derivatives of the whole
        power, with what these do: beside a large effect, those of the chain alone leave part of the freedom of A and of
        the noise constants in the residuals. It looks like more of the same effect, and errors of sizes are too small.
    """
    terms = act_together(station, baseline.terms, hypotheses)
    gains = EventGains.of(station, terms)
    residuals = split_residuals(station, baseline.residual, gains.vectors)
    return LinearModel(station, residuals, terms, modes).beside_modes(gains)


def act_together(station: Station, terms: ChainTerms, hypotheses: Sequence[Hypothesis]) -> ChainTerms:
    """The chain of the mean path of each class with the hypotheses that act on all of its paths."""
    classes = range(len(station.conditions.dipoles))
    for one in hypotheses:
        concerned = np.array([bool(np.all(one.target.is_member[station.class_of == c])) for c in classes])
        if np.any(concerned):
            changed = one.cause.apply(terms, station.conditions, one.template, one.size)
            at = concerned[:, None, None]
            pairs = {field.name: (getattr(changed, field.name), getattr(terms, field.name)) for field in fields(terms)}
            terms = ChainTerms(**{name: np.where(at, new, old) for name, (new, old) in pairs.items()})
    return terms


def power_ratio(station: Station, terms: ChainTerms, hypotheses: Sequence[Hypothesis]) -> Floats:
    """Power with the hypotheses over power without, shape (path, event, freq)."""
    plain = terms.power()
    ratio = np.empty_like(station.power)
    for members, index, concerned in _groups(station, hypotheses):
        changed = terms
        for one in (hypotheses[k] for k in concerned):
            changed = one.cause.apply(changed, station.conditions, one.template, one.size)
        ratio[members] = np.maximum(changed.power()[index] / plain[index], SMALLEST_RATIO)
    return ratio


def _groups(station: Station, hypotheses: Sequence[Hypothesis]) -> list[tuple[NDArray[np.int64], int, list[int]]]:
    """Paths of the same class with the same hypotheses: members, class, hypotheses."""
    columns = [station.class_of, *(one.target.is_member.astype(int) for one in hypotheses)]
    keys, group_of = np.unique(np.stack(columns, axis=1), axis=0, return_inverse=True)
    return [
        (np.flatnonzero(group_of.ravel() == g), int(key[0]), np.flatnonzero(key[1:]).tolist())
        for g, key in enumerate(keys)
    ]


def with_noise(station: Station, terms: ChainTerms, noise: Noise) -> ChainTerms:
    """The chain with other noise constants."""
    intercepts = station.conditions.intercepts
    receiver, adc = intercepts.split_behind(noise[1])
    return replace(terms, n_lna=intercepts.before(noise[0]), receiver_noise=receiver, adc_noise=adc)


def refit(before: FittedModel, new: Hypothesis, noise: Noise | None = None) -> FittedModel | None:
    """Fit the chain of every path and the sizes of all hypotheses together: those of the model before, and a new one.

    Returns None where the hypotheses cannot be told apart or the fit runs away. Events on which the covariate of the
    new cause is unknown are left out.

    Parameters
    ----------
    before
        The model that is extended.
    new
        The hypothesis added, at the size from which to start.
    noise
        Noise constants by which the hypotheses act; None for those of the model before.
    """
    noise = before.noise if noise is None else noise
    station = before.station.on_events(new.cause.known_events(before.station.conditions, new.template))
    most = new.cause.largest_step
    hypotheses = [*before.hypotheses, replace(new, size=float(np.clip(new.size, -most, most)))]
    levels = before.linear.on_events(station.is_used).residuals.levels
    found = fit_sizes(station, before.baseline, hypotheses, levels, before.linear.modes, noise=noise)
    return None if found is None else found[0]


def fit_sizes(
    station: Station,
    baseline: Baseline,
    hypotheses: Sequence[Hypothesis],
    levels: NoiseLevels,
    modes: SkyModes | None,
    *,
    is_free: NDArray[np.bool_] | None = None,
    noise: Noise | None = None,
) -> tuple[FittedModel, Floats] | None:
    """Fit the chain of every path and the sizes of hypotheses together, with noise levels that stay as they are.

    Parameters
    ----------
    baseline
        The chain from which to start.
    hypotheses
        At the sizes from which to start.
    is_free
        Sizes that are fitted, shape (hypothesis,); None for all.
    noise
        Noise constants by which the hypotheses act; None for those of the fit.

    Returns
    -------
    The fitted model and the information on the sizes, shape (hypothesis, hypothesis); None where the hypotheses cannot
    be told apart or the fit runs away.
    """
    limit = np.array([one.cause.largest_step for one in hypotheses])
    at = np.arange(len(hypotheses)) if is_free is None else np.flatnonzero(is_free)
    before: tuple[Floats, Floats] | None = None
    for _ in range(MAX_ROUNDS):
        beside = _fit_beside(station, baseline, hypotheses, noise)
        if beside is None or _has_run_away(station, beside, hypotheses):
            return None
        baseline = beside
        linear = linearise(station, baseline, modes, hypotheses)
        if not float(np.std(linear.residuals.mean)) < LARGEST_CHANGE:
            return None
        # The noise levels stay those of the model before, so that every round minimises the same chi^2.
        weighed = linear.with_levels(levels)
        conditions = station.conditions
        others = [act_together(station, baseline.terms, [o for o in hypotheses if o is not one]) for one in hypotheses]
        templates = [
            signature(one.cause, terms, conditions, one.template, one.size)
            for one, terms in zip(hypotheses, others, strict=True)
        ]
        score, information = weighed.products(templates, [one.target for one in hypotheses])
        own = information[np.ix_(at, at)]
        if not can_be_told_apart(own):
            return None
        step, sigma = np.zeros(len(hypotheses)), np.array([one.sigma for one in hypotheses])
        step[at] = np.clip(solve_symmetric(own, score[at, None])[:, 0], -limit[at], limit[at])
        sigma[at] = np.sqrt(np.diag(invert_symmetric(own)))
        is_converged = bool(np.all(np.abs(step[at]) < STANDS_STILL * sigma[at]))
        fitted = [replace(one, sigma=float(s)) for one, s in zip(hypotheses, sigma, strict=True)]
        if is_converged:
            break
        sizes = np.array([one.size for one in hypotheses])
        last = sizes[at], step[at]
        moved = step[at] if before is None else _secant(*last, sigma[at], *before)
        sizes[at] += np.clip(moved, -limit[at], limit[at])
        before, hypotheses = last, [replace(one, size=float(size)) for one, size in zip(fitted, sizes, strict=True)]
    return FittedModel(fitted, baseline, linear, is_converged, noise), information


def _fit_beside(
    station: Station, baseline: Baseline, hypotheses: Sequence[Hypothesis], noise: Noise | None
) -> Baseline | None:
    """Fit the chain beside hypotheses until what they do by its constants stands still; None where they run away."""
    if noise is not None:
        baseline = replace(baseline, terms=with_noise(station, baseline.terms, noise))
    ratio = power_ratio(station, baseline.terms, hypotheses)
    for _ in range(CHAIN_FITS):
        if not np.all((ratio > LARGEST_CHANGE**-1) & (ratio < LARGEST_CHANGE)):
            return None
        baseline = fit_baseline(station, ratio)
        if noise is not None:
            baseline = replace(baseline, terms=with_noise(station, baseline.terms, noise))
        last, ratio = ratio, power_ratio(station, baseline.terms, hypotheses)
        if np.linalg.norm(np.log(ratio / last)) <= CHAIN_STANDS_STILL * np.linalg.norm(np.log(ratio)):
            break
    return baseline


def _secant(sizes: Floats, step: Floats, sigma: Floats, last_sizes: Floats, last_step: Floats) -> Floats:
    """The step to where the steps end if they go on changing as they did; shape (free size,) each.

    The chain that is fitted beside the sizes answers each step, so that steps alone may swing for many rounds: Anderson
    (1965, J. ACM 12, 547) with one step remembered, of one size the method of secants.
    """
    change = step - last_step
    share = float(np.sum(change * step / sigma**2) / max(np.sum((change / sigma) ** 2), STANDS_STILL**2))
    return np.asarray(step - share * (sizes - last_sizes + change))


def _has_run_away(station: Station, baseline: Baseline, hypotheses: Sequence[Hypothesis]) -> bool:
    """Whether residuals are far from noise, which is not to be estimated from them, or nothing is left of the sky.

    In a channel at the end of the band, behind a long cable, the fitted share of the sky is 0 within its error: the
    band as a whole tells.
    """
    terms = act_together(station, baseline.terms, hypotheses)
    share = (terms.sky * terms.front / terms.power()).mean(axis=(1, 2))
    is_near = float(np.std(mean_of_paths(station, baseline.residual))) < LARGEST_CHANGE
    return not (is_near and bool(np.all(share > 0)))


def can_be_told_apart(information: Floats) -> bool:
    """Whether the data hold information on every hypothesis, and none is a combination of the others.

    `information` has the shape (hypothesis, hypothesis).
    """
    seen = np.diag(information)
    if not np.all(np.isfinite(information)) or np.any(seen <= 0):
        return False
    size = np.sqrt(seen)
    return bool(seen.size == 0 or np.linalg.eigvalsh(information / np.outer(size, size))[0] > SMALLEST_DIFFERENCE)


def held_out_fold(station: Station) -> NDArray[np.int64]:
    """Number of the fold of each event, shape (event,).

    Folds are blocks of date and of 2 h of LST, because neighbouring events share conditions.
    """
    order = np.argsort(np.argsort(station.conditions.time_unix))
    date_block = order * DATE_BLOCKS // order.size
    lst_block = (station.conditions.lst_hours // (24 / LST_BLOCKS)).astype(int)
    return np.asarray((date_block + lst_block) % FOLDS)


def held_out_gain(before: FittedModel, hypothesis: Hypothesis, templates: Sequence[Template]) -> float:
    """Gain in log-likelihood on held-out events, summed over the folds.

    For each fold the template (a date, hours, a delay) is chosen and the size is fitted on the other folds alone.
    """
    cause = hypothesis.cause
    linear = before.linear.on_events(cause.known_events(before.station.conditions, hypothesis.template))
    conditions, fold = linear.station.conditions, held_out_fold(linear.station)
    parts = [
        linear.by_fold(
            spectral_signature(cause, before.baseline.terms, conditions, family.templates[0]),
            family.profiles,
            hypothesis.target,
            fold,
        )
        for family in group_templates(conditions, cause, templates)
    ]
    score, information, whole = (np.concatenate(part, axis=1) for part in zip(*parts, strict=True))
    of_training, known, bare = (part.sum(axis=0) - part for part in (score, information, whole))
    size = np.divide(of_training, known, out=np.zeros_like(known), where=known > SMALLEST_SHARE * bare)
    best = np.argmax(of_training * size, axis=1)
    k = np.arange(len(score))
    size, score, information = size[k, best], score[k, best], information[k, best]
    return float(np.sum(size * score - 0.5 * size**2 * information))


# Sizes where the data hardly tell the noise in front of the receiver from that behind it.
#
# A gain in front of N_RCU acts on the sky and on N_LNA, not on the noise behind: by how much it must have changed
# depends on how the noise is shared. Where the fit leaves that open, a size is averaged over noise constants as the fit
# knows them, weighed by how well each describes the effect that was found, and its error contains their scatter.

OPEN_FROM = 0.05
"""Share of the power by which a noise constant must be uncertain: below, it moves a size by less than this share."""
HARDLY_KNOWN = 0.5
"""Relative error of a constant from which only its order of magnitude is known: its distribution is that of |N(0, s)|,
as the weak prior of the fit is."""
DRAWS, SEED = 64, 0
DRAWS_AT_ONCE = 8
"""Draws whose templates are weighed together: eight share what a call costs, and more take more memory for nothing."""
SCOUTS, ENOUGH, NARROWER, MOST_ROUNDS = 32, 6.0, 0.3, 5
"""Draws of which so many must count: with fewer, an effect that itself says how noise is shared is looked at more
closely, so much at a time."""


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
    centre, scale, is_last = np.zeros(normal.shape[1]), 1.0, False
    for k in range(MOST_ROUNDS + 1):
        is_last |= k == MOST_ROUNDS
        own = normal if is_last else normal[:SCOUTS]
        u = centre + scale * own
        drawn = noise.draw(u)
        size, gain = _fit_sizes(model, one, drawn)
        if not np.any(np.isfinite(gain)):
            return None
        # by likelihood and prior over the density of the draws
        gain += 0.5 * (np.sum(own**2, axis=1) - np.sum(u**2, axis=1)) + own.shape[1] * np.log(scale)
        weight = np.exp(gain - gain.max())
        evidence = float(gain.max() + np.log(weight.mean()))
        weight /= weight.sum()
        if is_last:
            break
        is_last = bool(1.0 / np.sum(weight**2) >= ENOUGH)
        if not is_last:
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
    """The noise constants of the paths of a hypothesis; None where all are known to 5 % of the power."""
    constants, covariance = model.baseline.noise_of(one.target.is_member)
    covariance = covariance + model.linear.open_noise
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
    for start in range(0, len(drawn), DRAWS_AT_ONCE):
        chains = [with_noise(model.station, fitted_terms, noise) for noise in drawn[start : start + DRAWS_AT_ONCE]]
        templates = [
            np.stack([signature(h.cause, terms, conditions, h.template, h.size) for terms in chains]) for h in there
        ]
        missed = fitted - np.stack([_log_ratio(there, terms, model) for terms in chains])
        products = zip(*model.linear.products([*templates, missed], [*targets, one.target]), strict=True)
        for k, (score, information) in enumerate(products, start):
            if can_be_told_apart(information[:-1, :-1]):
                inverse = invert_symmetric(information[:-1, :-1])
                onto = score[:-1] + information[:-1, -1]
                size[k] = one.size + inverse[0] @ onto
                gain[k] = 0.5 * (onto @ inverse @ onto - information[-1, -1]) - score[-1]
    return size, gain


def _log_ratio(hypotheses: Sequence[Hypothesis], terms: ChainTerms, model: FittedModel) -> Floats:
    """Ln of the power with the hypotheses, floored, over power without, shape (class, event, freq)."""
    changed = terms
    for one in hypotheses:
        changed = one.cause.apply(changed, model.station.conditions, one.template, one.size)
    return np.asarray(np.log(np.maximum(changed.power() / terms.power(), SMALLEST_RATIO)))
