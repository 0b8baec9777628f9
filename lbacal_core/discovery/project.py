"""The linear model of a station's residuals: the mean of its paths, and every path's deviation from it.

Mean and deviations are independent and have a `View` each. An effect on some paths changes both: the mean changes by
the effect times the share of these paths in the mean, and the deviations by the rest. `LinearModel` adds up the scores
and the information of the views.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from lbacal_core.causes.antenna import log_gain
from lbacal_core.discovery.hypothesis import Target
from lbacal_core.discovery.noise import (
    GAINS_PRIOR,
    NoiseLevels,
    Residuals,
    clean_mean,
    estimate_again,
    split_residuals,
    split_values,
    with_memory,
)
from lbacal_core.discovery.station import SkyModes, Station
from lbacal_core.discovery.view import Seen, View
from lbacal_core.grids import Floats
from lbacal_core.instrument.chain import ChainTerms
from lbacal_core.linear import invert_symmetric, solve_symmetric
from lbacal_core.sky.differences import Waves

# Gains of single events: how they show along frequency, and what they do to the mean path beyond first order.
#
# A gain behind everything changes ln P by a, one in front of N_RCU by h b, with h the share of the power that comes
# through it, and a resonance that is lower by c by h c d ln G/d nu. Along the three vectors 1, h and h d ln G/d nu,
# with the mean h, the noise is linear in these amounts. Beyond that, h changes with LST, the gains multiply each other,
# and a resonance that moves is wider on average, by c^2 G''/2G to second order: where it moved by 0.3 MHz in rain, it
# was named as widening. A(nu) has structure from channel to channel, so that no order is enough for a shift of a
# channel: where one event of heavy rain moved by 1.3 MHz, the resonance was named as following rain. G is read at nu +
# c.

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
        """The gains that events have in a fitted chain: its share in front of N_RCU, and the resonance in its G_ant."""
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
            # beside a huge gain, what is left of a variance is a rounding error of either sign
            nodes = amounts[:, 2, None] + NODES * np.sqrt(np.maximum(variance[:, 2, 2, None], 0.0))
            moved = NODE_WEIGHTS @ self.lower_by(nodes) - self.slope * amounts[:, 2:3]
            before, beyond = beyond, np.asarray(first + front * (together + moved))
            if np.abs(beyond - before).max() < SETTLED:
                break
        return beyond


@dataclass(frozen=True)
class Part:
    """The templates for targets as one view sees them.

    Attributes
    ----------
    view
        The view.
    templates
        As the view sees them, k of them.
    share
        Share of each template that each member shows, shape (k, member).
    sign
        1; or minus the number of paths whose deviations lose what their mean shows (`LinearModel.lost`).
    """

    view: View
    templates: Seen
    share: Floats
    sign: float


@dataclass(frozen=True)
class LinearModel:
    """A station's residuals with their noise levels, and what the fit leaves free.

    Attributes
    ----------
    terms
        The chain of the mean path of each class; the free vectors are its derivatives.
    modes
        Relative changes of P_sky by which sky and antenna models differ, or None where P_sky is exact.
    empirical
        Further free vectors of the mean, shape (vector, polarisation, event, freq), or None.
    """

    station: Station
    residuals: Residuals
    terms: ChainTerms
    modes: SkyModes | None
    empirical: Floats | None = None

    def with_levels(self, levels: NoiseLevels) -> LinearModel:
        """The same residuals weighed with other noise levels."""
        return replace(self, residuals=replace(self.residuals, levels=levels))

    def with_residuals(self, mean: Floats, deviation: Floats) -> LinearModel:
        """The model with other residuals of the same events, weighed alike.

        Shapes (polarisation, event, freq) and (path, event, freq).
        """
        return replace(self, residuals=replace(self.residuals, mean=mean, deviation=deviation))

    def with_change(self, change: Floats) -> LinearModel:
        """The same noise, with a change of every path added to the residuals, shape (path, event, freq)."""
        mean, deviation = split_values(self.station, change, self.residuals.in_mean)
        return self.with_residuals(self.residuals.mean + mean, self.residuals.deviation + deviation)

    def on_events(self, is_known: NDArray[np.bool_]) -> LinearModel:
        """The model of some events alone, such as those whose temperature is known; shape (event,)."""
        if np.all(is_known):
            return self
        station = self.station.on_events(is_known)
        residuals = self.residuals
        whole = residuals.deviation + residuals.taken + residuals.mean[self.polarisation_of[station.class_of]]
        residuals = split_residuals(station, whole * station.is_present[:, :, None], residuals.seeds)
        return replace(self, station=station, residuals=residuals).beside_modes()

    def beside_modes(self, gains: EventGains | None = None) -> LinearModel:
        """The same with noise levels estimated beside differences between models, which are no noise.

        Parameters
        ----------
        gains
            Given once for new residuals: what gains of single events do beyond first order is then taken out.
        """
        residuals, mean, sky = self.residuals, self.residuals.mean, None
        if self.modes is not None:
            mean, sky = self.common.clean(mean[None])[0], self._seen_in_deviations()
            residuals = estimate_again(self.station, residuals, mean, sky)
        if gains is not None:
            beyond = gains.beyond_first_order(self.station, residuals, mean)
            linear = replace(residuals, mean=residuals.mean - beyond)
            residuals = estimate_again(self.station, linear, mean - beyond, sky)
        return self if residuals is self.residuals else replace(self, residuals=residuals)

    def _seen_in_deviations(self) -> Floats:
        """What the changes of the sky that the means show do to the deviations, shape (class, event, freq).

        Paths differ in the share of the sky in their power, and a change of the sky does not cancel in them.
        """
        amounts = self.common.fitted(self.residuals.mean)
        rows, _, channels = self.common.slope.shape
        amounts[: rows * (channels + len(self._mean_free_vectors[1]))] = 0.0
        change = self.common.described(amounts) / self._seen_in_mean(np.ones((1, 1, 1, 1)))[0]
        return np.asarray(self._contrast * change[self.polarisation_of])

    @cached_property
    def _contrast(self) -> Floats:
        """Share of the sky in the power of each class less that of the mean path, shape (class, event, freq)."""
        of_mean = self._seen_in_mean(np.ones((1, 1, 1, 1)))[0]
        return np.asarray(self._sky_share - of_mean[self.polarisation_of])

    @cached_property
    def polarisation_of(self) -> NDArray[np.int64]:
        """Index of the polarisation of each class, shape (class,)."""
        return np.searchsorted(self.residuals.polarisations, self.station.conditions.dipoles)

    @cached_property
    def paths_in_mean(self) -> NDArray[np.int64]:
        """Number of paths in the mean of each polarisation, shape (polarisation,)."""
        polarisations, in_mean = self.residuals.polarisations, self.residuals.in_mean
        return np.array([np.sum(self.station.dipole[in_mean] == name) for name in polarisations])

    @cached_property
    def members(self) -> list[NDArray[np.int64]]:
        """Rows of the paths of each class, shape (path of the class,)."""
        return [np.flatnonzero(self.station.class_of == c) for c in range(len(self.station.conditions.dipoles))]

    @cached_property
    def weight(self) -> Floats:
        """Weight of each event of a path: 0 where absent, less for noisy paths, shape (path, event).

        The deviation of a path outside the mean contains the noise of the path and of the mean.
        """
        residuals = self.residuals
        own = residuals.levels.path_scale[:, None] ** 2
        of_mean = residuals.spread[self.polarisation_of[self.station.class_of]]
        return self.station.is_present / np.where(residuals.in_mean[:, None], own, own + of_mean)

    @cached_property
    def common(self) -> View:
        """The means over the paths of each polarisation."""
        residuals, levels = self.residuals, self.residuals.levels
        polarisations = len(residuals.polarisations)
        is_known = residuals.spread > 0
        channel = is_known / (
            levels.common_channel[:, None] ** 2 + levels.path_channel**2 * residuals.spread + ~is_known
        )
        everyone = np.all(is_known, axis=0).reshape(-1, 1, 1)
        size = np.eye(len(levels.vectors))
        variance = np.mean(levels.common_channel**2) + levels.path_channel**2 * residuals.spread.mean(axis=0)
        of_paths = residuals.spread.mean(axis=0)[:, None, None] * levels.mean_path_shared[levels.kind_of]
        joint = of_paths + variance[:, None, None] * size
        of_sum, of_difference = (
            everyone * invert_symmetric(with_memory(np.where(everyone, shared[levels.kind_of] + joint, size), memory))
            for shared, memory in (
                (levels.common_sum, levels.sum_memory),
                (levels.common_difference, levels.difference_memory),
            )
        )
        mean = np.full((polarisations, polarisations), 1.0 / polarisations)[:, :, None, None, None]
        own = np.eye(polarisations)[:, :, None, None, None]
        inside = mean * of_sum + (own - mean) * of_difference
        slope, constants = self._mean_free_vectors
        free = np.zeros((constants.shape[0] * polarisations, *slope.shape))
        for d in range(polarisations):
            free[d * len(constants) : (d + 1) * len(constants), d] = constants[:, d]
        prior = np.zeros(len(free))
        waves = None
        if self.modes is not None:
            modes = self._modes_in_mean(self.modes)
            free, prior = np.concatenate([free, modes]), np.concatenate([prior, np.full(len(modes), self.modes.prior)])
            waves = None if self.modes.waves is None else self._waves_in_mean(*self.modes.waves)
        if self.empirical is not None:
            free, prior = np.concatenate([free, self.empirical]), np.concatenate([prior, np.zeros(len(self.empirical))])
        weight = np.ones((1, channel.shape[1]))
        return View(channel, inside, levels.vectors, slope, free, prior, waves, weight, residuals.mean[None])

    @cached_property
    def open_noise(self) -> Floats:
        """Covariance of the noise constants of the mean path where the sky is open, mean of the polarisations, (k, k).

        The fit of a path has none of it, as its sky is given: more brightness everywhere is noise to that.
        """
        slope, constants = self._mean_free_vectors
        count = len(constants)
        if self.modes is None:
            return np.zeros((count, count))
        own = (self.common.covariance_of(slice(d * count, (d + 1) * count))[0] for d in range(len(slope)))
        return np.asarray(np.mean(list(own), axis=0))

    def _modes_in_mean(self, modes: SkyModes) -> Floats:
        """What the differences between models do to the means, one prior sigma each."""
        common, own = (self._seen_in_mean(part) for part in (modes.common, modes.own))
        polarisations = np.arange(len(self.residuals.polarisations))
        return np.concatenate([common, *(own * (polarisations == d)[:, None, None] for d in polarisations)])

    def _waves_in_mean(self, common: Waves, own: Waves) -> Waves:
        """What waves along LST do to the means: the mean share of the sky at each frequency shows them."""
        share = self._seen_in_mean(np.ones((1, 1, 1, 1))).mean(axis=(0, 2))
        spectra, spectrum_of, profile = [common.spectra[:, None] * share], [common.spectrum_of], [common.profile]
        for d in range(len(share)):
            spectrum_of.append(own.spectrum_of + sum(map(len, spectra)))
            spectra.append(own.spectra[:, None] * share * (np.arange(len(share)) == d)[:, None])
            profile.append(own.profile)
        return Waves(np.concatenate(profile), np.concatenate(spectrum_of), np.concatenate(spectra))

    def _seen_in_mean(self, changes: Floats) -> Floats:
        """Relative changes of P_sky, (mode, class, event, freq), as the means show them, (mode, polarisation, ...)."""
        return self.mean_of(changes * self._sky_share, np.ones(len(self.station.antenna), dtype=bool))

    @cached_property
    def _sky_share(self) -> Floats:
        """Share of the sky in the power of the mean path of each class, shape (class, event, freq)."""
        return np.asarray(self.terms.sky * self.terms.front / self.terms.power())

    @cached_property
    def paths(self) -> list[View]:
        """The deviations of the paths of each class.

        The level of the sky, which the means tell no better than its prior, stays free in them.
        """
        slope, constants = self._free_vectors
        return [
            self._path_view(
                slope[c],
                constants[:, c],
                self.weight[members],
                members,
                self._level[:, c],
                self.residuals.levels.path_shared[:, c],
            )
            for c, members in enumerate(self.members)
        ]

    @cached_property
    def _level(self) -> Floats:
        """What the level of the sky does to the deviations, one prior sigma each, shape (mode, class, event, freq)."""
        common = np.empty((0, 1, 1, 1)) if self.modes is None else self.modes.common
        return np.asarray(common * self._contrast)

    @cached_property
    def lost(self) -> list[View]:
        """The mean path of each polarisation with the mean weights: deviations lose its information with their mean.

        The level of the sky is as free in it as in the paths on average: beside an effect that moves the share of the
        sky in one class of paths, deviations would lose more information on it than they have.
        """
        slope, constants = self._mean_free_vectors
        polarisation, in_mean = self.polarisation_of[self.station.class_of], self.residuals.in_mean
        weights = [self.weight[in_mean & (polarisation == d)].mean(axis=0) for d in range(len(slope))]
        share = self.share_of_mean(np.ones(len(in_mean), dtype=bool))[:, None, None]
        nobody, level = np.empty(0, dtype=np.int64), self._level * np.sqrt(share)
        levels = [level[:, self.polarisation_of == d].reshape(-1, *slope.shape[1:]) for d in range(len(slope))]
        shared = self.residuals.levels.mean_path_shared
        return [
            self._path_view(slope[d], constants[:, d], w[None], nobody, levels[d], shared)
            for d, w in enumerate(weights)
        ]

    def _path_view(
        self,
        slope: Floats,
        constants: Floats,
        weight: Floats,
        members: NDArray[np.int64],
        level: Floats,
        shared: Floats,
    ) -> View:
        levels = self.residuals.levels
        variance = levels.path_channel**2
        channel = np.array([[1.0 / variance]])
        inside = invert_symmetric(with_memory(shared + variance * np.eye(len(levels.vectors)), levels.path_memory))
        inside = (inside[levels.kind_of] if len(inside) > 1 else inside)[None, None]
        free, residual = np.concatenate([constants, level])[:, None], self.residuals.deviation[members][:, None]
        prior = np.repeat([0.0, 1.0 if self.modes is None else self.modes.prior], [len(constants), len(level)])
        return View(channel, inside, levels.vectors, slope[None], free, prior, None, weight, residual)

    @cached_property
    def _free_vectors(self) -> tuple[Floats, Floats]:
        """Derivatives of ln P by ln A, (class, event, freq), and by each noise constant, (constant, class, ...)."""
        terms, power = self.terms, self.terms.power()
        slope = np.broadcast_to((terms.sky + terms.n_lna) * terms.front / power, power.shape)
        noise = self.station.conditions.intercepts
        columns = [*(form * terms.front / power for form in noise.front), *(form / power for form in noise.behind)]
        return slope, np.stack([np.broadcast_to(column, power.shape) for column in columns])

    @cached_property
    def _mean_free_vectors(self) -> tuple[Floats, Floats]:
        """Derivatives of ln P of the mean path of each polarisation, as in `_free_vectors`."""
        slope, constants = self._free_vectors
        share = np.zeros((len(self.residuals.polarisations), len(self.members)))
        counts = [self.residuals.in_mean[members].sum() for members in self.members]
        share[self.polarisation_of, np.arange(len(self.members))] = counts
        share /= share.sum(axis=1, keepdims=True)
        return np.einsum("dc,cef->def", share, slope), np.einsum("dc,jcef->jdef", share, constants)

    def mean_of(self, values: Floats, is_member: NDArray[np.bool_]) -> Floats:
        """Change of the means by an effect on some, (..., class, event, freq) -> (..., polarisation, event, freq).

        `is_member` marks the paths with the effect, shape (path,).
        """
        polarisations = len(self.residuals.polarisations)
        mean = np.zeros((*values.shape[:-3], polarisations, *values.shape[-2:]), dtype=values.dtype)
        for c, share in enumerate(self.share_of_mean(is_member)):
            if share:
                mean[..., self.polarisation_of[c], :, :] += share * values[..., c, :, :]
        return mean

    def share_of_mean(self, is_member: NDArray[np.bool_]) -> Floats:
        """Share of the given paths of each class in the mean of their polarisation, shape (class,)."""
        counts = np.array([np.sum((is_member & self.residuals.in_mean)[members]) for members in self.members])
        return np.asarray(counts / self.paths_in_mean[self.polarisation_of])

    def shows_in_means_alone(self, is_member: NDArray[np.bool_]) -> bool:
        """Whether the deviations of the paths say nothing about an effect on the paths marked, shape (path,)."""
        dipole = self.station.dipole
        return self.modes is not None and bool(np.all(is_member == np.isin(dipole, dipole[is_member])))

    def share_of_deviation(self, is_member: NDArray[np.bool_]) -> Floats:
        """Share of an effect in the deviation of each path, shape (path,).

        Where the sky is free, changes of the sky have been taken out of the deviations, and an effect on the whole
        station or on one of its dipoles may look like one: the means alone then show it, and the share is 0.

        It is 0 for a path outside the target. A path of the target has the share 1 if it is part of the mean; the
        change of the mean is subtracted from all these paths together (`lost`). If it is not part of the mean, the
        share is 1 less the share of the target's paths in the mean.
        """
        if self.shows_in_means_alone(is_member):
            return np.zeros(len(is_member))
        in_mean, polarisation = self.residuals.in_mean, self.polarisation_of[self.station.class_of]
        of_mean = np.zeros(len(self.paths_in_mean))
        np.add.at(of_mean, self.polarisation_of, self.share_of_mean(is_member))
        return np.asarray(is_member * np.where(in_mean, 1.0, 1.0 - of_mean[polarisation]))

    def parts(self, templates: Sequence[Floats], targets: Sequence[Target]) -> Iterator[Part]:
        """Templates of shape (..., class, event, freq), each with its target, as every view sees them."""
        changes = [self.mean_of(t, target.is_member) for t, target in zip(templates, targets, strict=True)]
        means = np.stack(changes, axis=-4)
        whole = np.ones((len(changes), 1))
        yield Part(self.common, self.common.see(means), whole, 1.0)
        lost = whole * [[not self.shows_in_means_alone(target.is_member)] for target in targets]
        for d, (view, count) in enumerate(zip(self.lost, self.paths_in_mean, strict=True)):
            yield Part(view, view.see(means[..., d : d + 1, :, :]), lost, -float(count))
        share = np.stack([self.share_of_deviation(target.is_member) for target in targets])
        for c, (view, members) in enumerate(zip(self.paths, self.members, strict=True)):
            if np.any(share[:, members]):
                own = np.stack([template[..., c, :, :] for template in templates], axis=-3)
                yield Part(view, view.see(own[..., None, :, :]), share[:, members], 1.0)

    def products(self, templates: Sequence[Floats], targets: Sequence[Target]) -> tuple[Floats, Floats]:
        """Scores, shape (..., k), and information, (..., k, k), of k templates of shape (..., class, event, freq)."""
        size, other = len(templates), templates[0].shape[:-3]
        score, information = np.zeros((*other, size)), np.zeros((*other, size, size))
        always = np.ones((1, self.station.power.shape[1]))
        for part in self.parts(templates, targets):
            products = part.view.inner(part.templates, always)[0][..., 0]
            information += part.sign * np.einsum("km,jm,...kjm->...kj", part.share, part.share, products)
            if part.sign > 0:
                score += np.sum(part.share * part.view.score_by_event(part.templates).sum(axis=-1), axis=-1)
        return score, information

    def by_fold(
        self, template: Floats, profiles: Floats, target: Target, fold: NDArray[np.int64]
    ) -> tuple[Floats, Floats, Floats]:
        """Score and information of a spectral template with each time profile in each fold, shape (fold, profile).

        The third array is the information before the free vectors are profiled out.
        """
        score, information, whole = np.zeros((3, int(fold.max()) + 1, len(profiles)))
        for part in self.parts([template], [target]):
            for m in np.flatnonzero(part.share[0]).tolist():
                share = float(part.share[0, m])
                gram, own, fitted = part.view.inner_by_fold(part.templates, profiles, fold, m)
                information += part.sign * share**2 * np.diagonal(gram, axis1=1, axis2=2)
                whole += share**2 * own
                if part.sign > 0:
                    score += share * part.view.score_by_fold(part.templates, profiles, fold, m, fitted)
        return score, information, whole

    def chi_squared(self) -> tuple[float, int]:
        """Chi^2 of the residuals, and its degrees of freedom."""
        residuals, is_present = self.residuals, self.station.is_present
        total = float(self.chi_squared_by_event().sum())
        polarisations, events, channels = residuals.mean.shape
        count = polarisations * events * channels - self.common.rank
        shares = 1.0 - residuals.in_mean / self.paths_in_mean[self.polarisation_of[self.station.class_of]]
        count += int(np.sum(shares * np.maximum(is_present.sum(axis=1) * channels - channels - 3, 0)))
        return total, count

    def chi_squared_by_event(self, *, of_means: bool = False) -> Floats:
        """What each event adds to chi^2, that of the means alone or with the deviations, shape (event,)."""
        views = (self.common,) if of_means else (self.common, *self.paths)
        parts = [np.einsum("mref,mref->e", view.residual, view.weighted_residual) for view in views]
        return np.asarray(np.sum(parts, axis=0))
