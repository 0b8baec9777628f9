"""Gains of single events: how they show along frequency, and what they do to the mean path beyond first order.

A gain behind everything changes ln P by a, one in front of N_RCU by h b, with h the share of the power that comes
through it, and a resonance that is lower by c by h c d ln G/d nu. Along the three vectors 1, h and h d ln G/d nu, with
the mean h, the noise is linear in these amounts. Beyond that, h changes with LST, the gains multiply each other, and a
resonance that moves is wider on average, by c^2 G''/2G to second order: where it moved by 0.3 MHz in rain, it was named
as widening. A(nu) has structure from channel to channel, so that no order is enough for a shift of a channel: where one
event of heavy rain moved by 1.3 MHz, the resonance was named as following rain. G is read at nu + c.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from lbacal_core.causes.antenna import log_gain
from lbacal_core.chain.terms import ChainTerms
from lbacal_core.discovery.levels import GAINS_PRIOR, clean_mean
from lbacal_core.discovery.noise import Residuals
from lbacal_core.discovery.station import Station
from lbacal_core.grids import Floats
from lbacal_core.linear import invert_symmetric, solve_symmetric

LARGEST = 5.0
"""Standard deviations to which the amounts of an event are cut: beyond are bursts, which are no gains."""
ROUNDS, SETTLED = 8, 1e-4
"""Times at most that amounts are read from means without what lies beyond first order, which is up to half of an
amount; and the relative change of the power below which they have settled."""
NODES, NODE_WEIGHTS = np.array([-(3.0**0.5), 0.0, 3.0**0.5]), np.array([1.0, 4.0, 1.0]) / 6.0
"""Gauss-Hermite quadrature of three nodes, in standard deviations."""


@dataclass(frozen=True)
class EventGains:
    """How gains of an event show.

    Attributes
    ----------
    front
        Share of the power that comes through a gain in front of N_RCU, shape (class, event, freq).
    curve
        ln G of the antenna as it was fitted, by MHz. The curve of an instrument's table has slopes that are off by a
        third where A(nu) has structure.
    """

    front: Floats
    curve: CubicSpline

    @classmethod
    def of(cls, station: Station, terms: ChainTerms) -> EventGains:
        """Those of a fitted chain."""
        conditions = station.conditions
        front = np.broadcast_to((terms.sky + terms.n_lna) * terms.front / terms.power(), terms.sky.shape)
        return cls(front, CubicSpline(conditions.frequency_mhz, log_gain(terms, conditions)))

    @property
    def slope(self) -> Floats:
        """Slope of ln G, 1/MHz, shape (freq,)."""
        return np.asarray(self.curve(self.curve.x, 1))

    def lower_by(self, shift_mhz: Floats) -> Floats:
        """Relative change of G by a resonance that is lower, (...,) -> (..., freq); its end slopes continue."""
        frequency, slope = self.curve.x, self.slope
        moved = frequency + shift_mhz[..., None]
        inside = np.clip(moved, frequency[0], frequency[-1])
        beyond = np.where(moved > inside, slope[-1], slope[0]) * (moved - inside)
        return np.asarray(np.expm1(self.curve(inside) + beyond - self.curve(frequency)))

    @property
    def vectors(self) -> Floats:
        """Vectors along frequency that the noise of an event may share, as each class shows them, (class, 3, freq)."""
        front = self.front.mean(axis=1)
        return np.stack([np.ones_like(front), front, front * self.slope], axis=1)

    def beyond_first_order(self, station: Station, residuals: Residuals, mean: Floats) -> Floats:
        """What the gains of each event do to the means beyond first order, shape (event, freq).

        The amounts of an event are known from the means with an error, and those of single paths by their levels: their
        second moments are those of the posterior.

        Parameters
        ----------
        mean
            The means without what the fit leaves free, shape (polarisation, event, freq).
        """
        levels, vectors = residuals.levels, residuals.levels.vectors
        share = np.bincount(station.class_of, weights=residuals.in_mean, minlength=len(self.front))
        front = np.tensordot(share / share.sum(), self.front, axes=1)
        seeds = np.tensordot(share / share.sum(), self.vectors, axes=1)
        # amounts of the seeds by those of the vectors
        onto = solve_symmetric(seeds @ seeds.T, seeds @ vectors.T, prior=GAINS_PRIOR)
        spread = residuals.spread.mean()
        channel = np.mean(levels.common_channel**2) + levels.path_channel**2 * spread
        shared = levels.common_sum + spread * levels.mean_path_shared
        inverse = invert_symmetric(shared + channel * np.eye(len(vectors)))
        shrunk = inverse @ shared
        unknown = (shared - shared @ shrunk) / len(mean) + (1.0 - spread) * levels.mean_path_shared
        variance = (onto @ unknown @ onto.T)[levels.kind_of]
        beyond = np.zeros(mean.shape[1:])
        for _ in range(ROUNDS):
            told = clean_mean(station, mean - beyond, seeds).mean(axis=0) @ vectors.T
            distance = np.sqrt(len(mean) * np.einsum("ek,ekj,ej->e", told, inverse[levels.kind_of], told))
            told *= np.minimum(LARGEST / np.maximum(distance, LARGEST), 1.0)[:, None]
            amounts = np.matmul(told[:, None], shrunk[levels.kind_of])[:, 0] @ onto.T
            moments = amounts[:, :, None] * amounts[:, None, :] + variance
            first = (front - seeds[1]) * amounts[:, 1:2] + (front * self.slope - seeds[2]) * amounts[:, 2:3]
            together = moments[:, 0, 1, None] + self.slope * (moments[:, 0, 2] + moments[:, 1, 2])[:, None]
            nodes = amounts[:, 2, None] + NODES * np.sqrt(variance[:, 2, 2, None])
            moved = NODE_WEIGHTS @ self.lower_by(nodes) - self.slope * amounts[:, 2:3]
            before, beyond = beyond, np.asarray(first + front * (together + moved))
            if np.abs(beyond - before).max() < SETTLED:
                break
        return beyond
