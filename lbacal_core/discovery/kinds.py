"""Kinds of events, whose noise has its own covariance: those in rain, where a wet antenna's resonance may move more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc, chdtri

from lbacal_core.causes.conditions import RAIN
from lbacal_core.discovery.station import Station
from lbacal_core.grids import Floats
from lbacal_core.linear import fit_least_squares, invert_symmetric

FEWEST_OF_KIND = 40
"""Events of a kind from which its covariance is estimated, to 22 %."""
RARE, BEYOND_CHANCE = 0.1, 1e-3
"""Quantile of the other events that fewer events of a kind must exceed to have a covariance of their own, and the
probability below which so many do not by chance."""
WAYS = ("flag", "linear", "saturating")
"""Ways in which causes follow rain."""
HEAVY, TYLER_ROUNDS = 1e-3, 10
"""Share of normal events beyond which an event counts as no noise; rounds of a fixed point that needs six."""
SMALLEST_DISTANCE = 1e-18
"""Floor of a squared distance: exact data keep a finite weight."""


@dataclass(frozen=True)
class Kinds:
    """Kinds of the events of a station.

    Attributes
    ----------
    of_event
        1 in rain, where these are a kind, else 0, shape (event,).
    follows
        What follows rain as causes know it, shape (event, way), 0 where the events are of one kind.
    is_ordinary
        Events of the second kind without bursts, shape (event,).
    """

    of_event: NDArray[np.int64]
    follows: Floats
    is_ordinary: NDArray[np.bool_]

    @property
    def members(self) -> list[NDArray[np.int64]]:
        """Events of each kind."""
        return [np.flatnonzero(self.of_event == kind) for kind in range(int(self.of_event.max()) + 1)]

    def beside_rain(self, amount: Floats) -> Floats:
        """Amounts, shape (..., event, k), less what follows rain within its kind, scaled so that noise keeps its size.

        It is structure, and would count as noise of this kind: a resonance that moves with the millimetres of rain
        kept half of its score.
        """
        own, count = self.is_ordinary, int(self.is_ordinary.sum())
        if count <= len(WAYS):
            return amount
        left = amount - self.follows @ fit_least_squares(self.follows[own], amount[..., own, :])
        whole = (count / (count - np.linalg.matrix_rank(self.follows[own]))) ** 0.5
        return np.asarray(np.where(self.of_event[:, None] > 0, whole * left, amount))


def list_kinds(station: Station, amount: Floats) -> Kinds:
    """The kinds of events.

    Events in rain are a kind where they are many, and where fewer scatter more than the dry ones: with the weights of
    these, 38 events in which the resonance moved were called interference and a resonance that widens.

    Parameters
    ----------
    amount
        Amounts of what events may share along frequency, in the means, shape (event, k).
    """
    conditions = station.conditions
    rain = conditions.covariate(RAIN)
    is_wet = np.zeros(len(amount), dtype=bool) if rain is None else np.nan_to_num(rain) > 0
    wet, dry = is_wet & station.is_used, ~is_wet & station.is_used
    one = Kinds(np.zeros(is_wet.size, dtype=np.int64), np.zeros((is_wet.size, len(WAYS))), np.zeros_like(wet))
    if dry.sum() < FEWEST_OF_KIND or wet.sum() <= len(WAYS):
        return one
    both = Kinds(is_wet.astype(np.int64), np.concatenate([conditions.wetness(way) for way in WAYS], axis=1), wet)
    ordinary = wet.copy()
    ordinary[wet] = ~is_heavy(both.beside_rain(amount)[wet])
    both = Kinds(both.of_event, both.follows, ordinary)
    if wet.sum() < FEWEST_OF_KIND:
        inverse = invert_symmetric(amount[dry].T @ amount[dry])
        left = both.beside_rain(amount)
        distance = np.einsum("ek,kj,ej->e", left, inverse, left)
        many = int(np.sum(distance[wet] > np.quantile(distance[dry], 1.0 - RARE)))
        if bdtrc(many - 1, wet.sum(), RARE) >= BEYOND_CHANCE:
            return one
    return both


def is_heavy(amount: Floats) -> NDArray[np.bool_]:
    """Which events are beyond the quantile `HEAVY` of the normal distribution that most show, (event, k) -> (event,).

    Its form is that of the directions of the amounts (Tyler 1987, Ann. Stat. 15, 234), its size that of their median.
    """
    size = amount.shape[1]
    distance, form = np.ones(len(amount)), np.eye(size)
    for _ in range(TYLER_ROUNDS):
        form = amount.T @ (amount / distance[:, None])
        form *= size / max(float(np.trace(form)), SMALLEST_DISTANCE**0.5)
        inverse = invert_symmetric(form)
        distance = np.maximum(np.einsum("ek,kj,ej->e", amount, inverse, amount), SMALLEST_DISTANCE)
    return np.asarray(distance > np.median(distance) * chdtri(size, HEAVY) / chdtri(size, 0.5))
