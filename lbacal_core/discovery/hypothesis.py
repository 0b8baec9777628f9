"""A hypothesis: a cause, one template of its family, a target (the affected paths), and a size."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc, erfcinv

from lbacal_core.causes.cause import Cause, Template
from lbacal_core.discovery.station import Station
from lbacal_core.grids import Floats

OF_ALL = " of all antennas"
"""How the label of one dipole of the station ends."""


@dataclass(frozen=True)
class Target:
    """A set of paths: one path, an antenna, antennas that share hardware, a cable name, one dipole, or the station.

    Attributes
    ----------
    scope
        One of `lbacal_core.causes.cause.SCOPES`.
    label
        In words: ``antenna 17 X``, ``antenna 17``, ``group board 3``, ``cable 80``,
        ``dipole X of all antennas``, ``station``.
    is_member
        Shape (path,).
    """

    scope: str
    label: str
    is_member: NDArray[np.bool_]

    @property
    def is_wide(self) -> bool:
        """Whether it is more than an antenna, so that the mean of the station shows its effect."""
        return self.has_all_antennas or self.scope in ("cable", "group")

    @property
    def has_all_antennas(self) -> bool:
        """Whether it is the station or one dipole of all antennas: deviations from their mean tell nothing."""
        return self.scope in ("station", "dipole")


@dataclass(frozen=True)
class Hypothesis:
    """A cause with a template for a target, at a size.

    Attributes
    ----------
    sigma
        Standard deviation of the size for this template.
    template_sigma
        Scatter of the size among the templates that the data leave open, as a fraction of the size.
    over_templates
        Gain in chi^2 of the mean likelihood over finer templates about this one beyond that of this one: 0 or less.
    """

    cause: Cause
    template: Template
    target: Target
    size: float
    sigma: float = np.inf
    template_sigma: float = 0.0
    over_templates: float = 0.0

    @property
    def uncertainty(self) -> float:
        """Standard deviation of the size, including the scatter among templates that the data leave open."""
        return float(np.hypot(self.sigma, self.template_sigma * self.size))


@dataclass(frozen=True)
class Rival:
    """A cause, or a sentence, in the place of a finding, with the chi^2 that the finding gains beyond it."""

    cause: str
    target: str
    delta_chi2: float

    @property
    def odds(self) -> float:
        """Odds of this rival to the finding, 1e300 at most."""
        return float(np.exp(min(-0.5 * self.delta_chi2, np.log(1e300))))

    def as_dict(self) -> dict[str, Any]:
        """The fields `cause`, `target`, `delta_chi2` and `odds` of a report."""
        return {"cause": self.cause, "target": self.target, "delta_chi2": self.delta_chi2, "odds": self.odds}


def list_targets(station: Station) -> list[Target]:
    """Every path, antenna, cable name, group and dipole of a station, and the station."""
    paths, dipoles = len(station.antenna), np.unique(station.dipole)
    targets = []
    if paths > len(dipoles):
        for k in range(paths):
            label = f"antenna {station.antenna[k]} {station.dipole[k]}"
            targets.append(Target("path", label, np.arange(paths) == k))
        for antenna in np.unique(station.antenna):
            is_member = station.antenna == antenna
            if is_member.sum() > 1:
                targets.append(Target("antenna", f"antenna {antenna}", is_member))
    cables = np.array(station.conditions.cables)[station.class_of]
    for scope, names in (("cable", cables), ("group", station.group)):
        for name in np.unique(names[names != ""]):
            is_member = names == name
            is_antenna = scope == "group" and np.unique(station.antenna[is_member]).size == 1
            if not np.all(is_member) and not is_antenna:
                targets.append(Target(scope, f"{scope} {name}", is_member))
    if paths > len(dipoles) > 1:
        targets += [Target("dipole", f"dipole {one}{OF_ALL}", station.dipole == one) for one in dipoles]
    return [*targets, Target("station", "station", np.ones(paths, dtype=bool))]


# Look-elsewhere: probabilities of the largest of many scores, and the trials factor of correlated ones.

DRAWS = 2000
"""Simulated sets of scores: the quantile below is then known to 7 % of its trials factor."""
QUANTILE = 0.9
"""Quantile of the largest score that gives the trials factor: its tail has begun there, and 200 draws lie beyond."""

LARGEST_LEVEL = 8.0
"""Level beyond which the trials factor hardly changes a significance, standard deviations."""

SMALLEST_EIGENVALUE = 1e-9
"""Smallest eigenvalue over the largest: below, it is a rounding error, whose root would be seen."""


def p_of(z: float, trials: float) -> float:
    """Probability that the largest of `trials` independent standard normal numbers exceeds z in absolute value."""
    return float(-np.expm1(-trials * erfc(z / np.sqrt(2.0))))


def p_of_best(p_value: float, trials: float) -> float:
    """Probability that the smallest of `trials` independent p-values is as small (Sidak 1967)."""
    return float(-np.expm1(trials * np.log1p(-min(p_value, 1 - 1e-12))))


def significance(z: float, trials: float) -> float:
    """The score in standard deviations after the look-elsewhere correction, however small the probability."""
    p_value = p_of(z, trials)
    return sigma_of(p_value) if p_value > 1e-250 else float(np.sqrt(z**2 - 2 * np.log(trials)))


def sigma_of(p_value: float) -> float:
    """The two-sided normal equivalent of a probability, standard deviations."""
    return float(np.sqrt(2.0) * erfcinv(np.clip(p_value, 1e-300, 1.0)))


def trials_factor(correlation: Floats, seed: int, level: float = 0.0) -> float:
    """Number of independent scores whose largest exceeds as much as that of correlated ones, shape (score, score).

    It grows with the level: neighbouring dates that are one trial at 3 sigma are two or three at 5. Beyond what drawn
    scores reach, one score is drawn beyond the level and the others beside it; the probability that any exceeds is the
    mean of 1 over the number that do, times that of each alone (Adler, Blanchet & Liu 2012, Ann. Appl. Prob. 22, 1167).

    Parameters
    ----------
    level
        Score in standard deviations at which the number is asked; that of the quantile `QUANTILE` at least.
    """
    if len(correlation) == 1:
        return 1.0
    values, vectors = np.linalg.eigh(correlation)
    # The symmetric root without rounding errors: any other depends on the last digits of the matrix.
    root = (vectors * np.sqrt(np.where(values > SMALLEST_EIGENVALUE * values[-1], values, 0.0))) @ vectors.T
    rng = np.random.default_rng(seed)
    draws = rng.standard_normal((DRAWS, len(root))) @ root
    quantile = float(np.quantile(np.abs(draws).max(axis=1), QUANTILE))
    if level <= quantile:
        return float(max(-np.log(QUANTILE) / max(float(erfc(quantile / np.sqrt(2.0))), 1e-300), 1.0))
    seen = np.flatnonzero(np.diag(correlation) > SMALLEST_EIGENVALUE)
    if not seen.size:  # the data show no template: what is left of each is rounding
        return 1.0
    tail, at = float(erfc(min(level, LARGEST_LEVEL) / np.sqrt(2.0))), np.arange(DRAWS)
    first = rng.choice(seen, DRAWS)
    beyond = np.sqrt(2.0) * erfcinv(tail * (1.0 - rng.random(DRAWS)))
    draws += (beyond - draws[at, first])[:, None] * correlation[first]
    draws[at, first] = beyond
    many = np.sum(np.abs(draws) >= np.minimum(beyond, min(level, LARGEST_LEVEL))[:, None], axis=1)
    chance = min(seen.size * tail * float(np.mean(1.0 / many)), QUANTILE)
    return float(max(-np.log1p(-chance) / tail, 1.0))
