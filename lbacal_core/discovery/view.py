"""Inner products of templates in one view of the residuals, with the free vectors of the fit profiled out.

Residuals e have the inverse noise covariance W, and the fit leaves the vectors N free: A(nu) in every channel, three
noise constants, and the differences between sky models, whose amounts have a Gaussian prior. With L the inverse
covariance of the prior (0 for a vector that is free without limit), the inner product of two templates u and v is that
of what N cannot describe,

    <u, v> = u'Wv - (u'WN) (N'WN + L)^-1 (N'Wv),                                                                   (1)

the score of a template is <u, e> and its information <u, u>: the Fisher matrix with nuisance parameters profiled out
(Cowan 1998, Statistical Data Analysis, section 9.2). Only this module knows W and N.

A template is a spectral template, shape (row, event, freq), times a time profile, shape (event,). Spectral templates
are few and time profiles many (dates, hours), so that sums over events are all that each profile costs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lbacal_core.grids import Floats
from lbacal_core.linear import root_of_inverse
from lbacal_core.sky.differences import Waves

# The vectors N that a fit leaves free and the inverse covariance W of the noise, event by event.
#
# An event has independent noise in each channel, and a covariance along a few vectors that its channels share: W of an
# event is a number plus a matrix of low rank. The slopes ln A(nu) in N act in one channel each, the waves along LST are
# few spectra with many profiles in time, and the rest is given event by event.


@dataclass(frozen=True)
class Along:
    """Products N'W t with the free vectors event by event; those with the waves without their profiles in time.

    Attributes
    ----------
    free
        Shape (..., event, vector).
    waves
        Shape (..., event, spectrum of waves).
    """

    free: Floats
    waves: Floats


@dataclass(frozen=True)
class FreeVectors:
    """W and N of rows with common events: one path, or the means of the polarisations.

    Attributes
    ----------
    channel
        Inverse variance of what lies outside the vectors of the noise, shape (row, event), or 1 for event.
    inside
        Inverse covariance of the amounts of these vectors, shape (row, row, event, k, k), or 1 for event.
    vectors
        Orthonormal vectors along frequency that the noise of an event shares, shape (k, freq).
    slope
        Relative change of the power with ln A(nu): one free vector for each row and channel, shape (row, event, freq).
    constants
        Further free vectors, shape (vector, row, event, freq).
    prior
        Inverse variance of the amount of each of these, 0 where it is free without limit, shape (vector,).
    waves
        Further free vectors with a prior variance of 1, their spectra of shape (spectrum, row, freq), or None.
    """

    channel: Floats
    inside: Floats
    vectors: Floats
    slope: Floats
    constants: Floats
    prior: Floats
    waves: Waves | None

    def on_events(self, events: NDArray[np.int64]) -> FreeVectors:
        """The same of some events alone."""
        waves = self.waves
        return FreeVectors(
            self.channel if self.channel.shape[1] == 1 else self.channel[:, events],
            self.inside if self.inside.shape[2] == 1 else self.inside[:, :, events],
            self.vectors,
            self.slope[:, events],
            self.constants[:, :, events],
            self.prior,
            waves and Waves(waves.profile[:, events], waves.spectrum_of, waves.spectra),
        )

    def weigh(self, values: Floats) -> Floats:
        """W times vectors, shape (..., row, event, freq)."""
        amount = values @ self.vectors.T
        if len(self.inside) == 1:
            across = np.squeeze(amount[..., None, :] @ self.inside[0, 0], -2)
        else:
            across = np.einsum("rsekl,...sel->...rek", self.inside, amount)
        weighed = values * self.channel[..., None]
        weighed += (across - amount * self.channel[..., None]) @ self.vectors
        return np.asarray(weighed)

    def along(self, weighed: Floats) -> Along:
        """Products of weighed templates, shape (..., row, event, freq), with the free vectors event by event."""
        rows, _, channels = self.slope.shape
        size = rows * channels
        others = self._along_others(weighed)
        free = np.empty((*others.free.shape[:-1], size + len(self.constants)))
        for r, slope in enumerate(self.slope):
            np.multiply(slope, weighed[..., r, :, :], out=free[..., r * channels : (r + 1) * channels])
        free[..., size:] = others.free
        return Along(free, others.waves)

    def _along_others(self, weighed: Floats) -> Along:
        """The same without the slopes, as if there were none."""
        rows, events, channels = self.slope.shape
        by_event = np.moveaxis(weighed, -2, 0).reshape(events, -1, rows * channels) @ self._constants_by_event
        free = np.swapaxes(by_event, 0, 1).reshape(*weighed.shape[:-3], events, len(self.constants))
        spectra = self._wave_spectra
        return Along(free, np.asarray(sum(weighed[..., r, :, :] @ spectra[:, r].T for r in range(rows))))

    def sum(self, along: Along, weight: Floats) -> Floats:
        """Products with the free vectors summed over weighted events, weights (set, event) -> (..., set, vector)."""
        waves = np.empty((*along.free.shape[:-2], len(weight), len(self._wave_profiles)))
        for own, of_spectrum in zip(self._waves_of, np.moveaxis(along.waves, -1, 0), strict=True):
            if of_spectrum.size < weight.size:  # the profiles of the waves go with the fewer numbers
                by_wave = of_spectrum[..., None, :] * self._wave_profiles[own] @ weight.T
                waves[..., own] = np.swapaxes(by_wave, -1, -2)
            else:
                profiles = (weight[:, None] * self._wave_profiles[own]).reshape(-1, weight.shape[1])
                waves[..., own] = (of_spectrum @ profiles.T).reshape(*waves.shape[:-1], own.size)
        return np.concatenate([weight @ along.free, waves], axis=-1)

    def described(self, amounts: Floats) -> Floats:
        """What amounts of the free vectors describe, (..., vector) -> (..., row, event, freq)."""
        rows, _, channels = self.slope.shape
        end = rows * channels + len(self.constants)
        own = self.slope * amounts[..., : rows * channels].reshape(*amounts.shape[:-1], rows, 1, channels)
        own += np.tensordot(amounts[..., rows * channels : end], self.constants, axes=1)
        for at, spectrum in zip(self._waves_of, self._wave_spectra, strict=True):
            by_event = amounts[..., end + at] @ self._wave_profiles[at]
            own += by_event[..., None, :, None] * spectrum[:, None]
        return np.asarray(own)

    @property
    def prior_information(self) -> Floats:
        """L, shape (vector, vector)."""
        rows, _, channels = self.slope.shape
        waves = np.ones(len(self._wave_profiles))
        return np.diag(np.concatenate([np.zeros(rows * channels), self.prior, waves]))

    def information_of_free(self, weight: Floats) -> Floats:
        """N'WN for each set of event weights, (set, event) -> (set, vector, vector)."""
        rows, events, channels = self.slope.shape
        size, end = rows * channels, rows * channels + len(self.constants)
        gram = np.empty((len(weight), *self.prior_information.shape))
        constants, spectra = others = self.weigh_others()
        for r, slope in enumerate(self.slope):
            gram[:, r * channels : (r + 1) * channels] = self.onto_channels(weight, slope, r, others)
        gram[:, size:, :size] = np.swapaxes(gram[:, :size, size:], 1, 2)
        gram[:, size:end, size:] = np.swapaxes(self.sum(self._along_others(constants), weight), 0, 1)
        along = self._along_others(spectra)
        for own, free, waves in zip(self._waves_of, along.free, along.waves, strict=True):
            profiles = (weight[:, None] * self._wave_profiles[own]).reshape(-1, events)
            onto = self.sum(Along(free, waves), profiles)
            gram[:, end + own, size:] = onto.reshape(len(weight), own.size, -1)
        return gram

    def weigh_others(self) -> tuple[Floats, Floats]:
        """W times the constants and times the spectra of the waves, each of shape (vector, row, event, freq)."""
        spectra = self._wave_spectra
        whole = np.broadcast_to(spectra[:, :, None], (len(spectra), *self.slope.shape))
        return self.weigh(self.constants), self.weigh(whole)

    def onto_channels(self, weight: Floats, spectrum: Floats, row: int, others: tuple[Floats, Floats]) -> Floats:
        """Products N'Wu of u, a spectrum of one row in one channel, (event, freq) -> (set, freq, vector).

        `others` is what `weigh_others` gives.
        """
        constants, waves = (other[:, row] * spectrum for other in others)
        onto = [self.between_channels(weight, spectrum, slope, row, s) for s, slope in enumerate(self.slope)]
        of_waves = np.empty((*onto[0].shape[:2], len(self._wave_profiles)))
        for own, wave in zip(self._waves_of, waves, strict=True):
            of_waves[:, :, own] = np.swapaxes((weight[:, None] * self._wave_profiles[own]) @ wave, 1, 2)
        return np.concatenate([*onto, np.moveaxis(weight @ constants, 0, -1), of_waves], axis=-1)

    def between_channels(self, weight: Floats, one: Floats, other: Floats, r: int, s: int) -> Floats:
        """Products u'Wv of two spectra of rows r and s, each in one channel, 2 x (event, freq) -> (set, freq, freq)."""
        amount = self.inside[r, s] - (self.channel[r][:, None, None] * np.eye(len(self.vectors)) if r == s else 0.0)
        if len(amount) == 1:
            between = np.swapaxes(one * weight[:, :, None], 1, 2) @ other * (self.vectors.T @ amount[0] @ self.vectors)
        else:
            left = (one[:, None] * self.vectors * weight[..., None, None]).reshape(len(weight), -1, one.shape[1])
            right = (other[:, None] * (amount @ self.vectors)).reshape(-1, one.shape[1])
            between = np.swapaxes(left, 1, 2) @ right
        if r == s:
            at = np.arange(one.shape[1])
            between[:, at, at] += weight @ (one * other * self.channel[r][:, None])
        return np.asarray(between)

    @cached_property
    def _waves_of(self) -> list[NDArray[np.int64]]:
        """The waves that have each spectrum."""
        if self.waves is None:
            return []
        return [np.flatnonzero(self.waves.spectrum_of == d) for d in range(len(self.waves.spectra))]

    @property
    def _wave_spectra(self) -> Floats:
        """Spectra of the waves, shape (spectrum, row, freq)."""
        return np.empty((0, len(self.slope), self.slope.shape[2])) if self.waves is None else self.waves.spectra

    @property
    def _wave_profiles(self) -> Floats:
        """Profiles of the waves, shape (wave, event)."""
        return np.empty((0, self.slope.shape[1])) if self.waves is None else self.waves.profile

    @cached_property
    def _constants_by_event(self) -> Floats:
        """Shape (event, row x freq, vector)."""
        flat = np.moveaxis(self.constants, 2, 0)
        return np.ascontiguousarray(np.swapaxes(flat.reshape(*flat.shape[:2], flat.shape[2] * flat.shape[3]), 1, 2))


SMALLEST_EIGENVALUE = 1e-10
"""Eigenvalue of the unit-diagonal N'WN below which free vectors are combinations of others to rounding errors."""
SMALLEST_SHARE = 1e-6
"""Share of its information below which a template counts as free: what remains are rounding errors. An example is a
step at a date after which the path recorded nothing."""
SMALLEST_INFORMATION = 1e-6
"""Information below which a unit of size moves the data by less than a thousandth of a standard deviation."""


@dataclass(frozen=True)
class Seen:
    """Templates as one view sees them.

    Attributes
    ----------
    values
        t, shape (..., row, event, freq).
    weighed
        W t, the same shape.
    along
        N'W t event by event.
    """

    values: Floats
    weighed: Floats
    along: Along

    def by_event(self, other: Seen) -> Floats:
        """Products t'W u of all pairs event by event, nothing profiled out, shape (..., k, j, event)."""
        return self._own_by_event if other is self else self._by_event(other)

    @cached_property
    def _own_by_event(self) -> Floats:
        return self._by_event(self)

    def _by_event(self, other: Seen) -> Floats:
        return np.asarray(np.einsum("...kref,...jref->...kje", self.values, other.weighed))


@dataclass(frozen=True)
class ChannelTemplates:
    """Templates that are a few spectra times factors along frequency, as interference lines are.

    Attributes
    ----------
    spectra
        Shape (spectrum, event, freq).
    row_of
        Row of the view in which each spectrum acts, shape (spectrum,).
    shares
        How much of each spectrum acts in a template, shape (k, spectrum).
    factors
        Shape (factor, freq).
    """

    spectra: Floats
    row_of: NDArray[np.int64]
    shares: Floats
    factors: Floats


@dataclass(frozen=True)
class View(FreeVectors):
    """One part of the residuals, with its noise and its free vectors.

    A view has one row (a path) or several rows with common events (the means of both polarisations). Its members are
    paths with the same templates and noise; every member has its own events.

    Attributes
    ----------
    weight
        Weight of each event for each member, shape (member, event); 0 where absent.
    residual
        Shape (member, row, event, freq).
    """

    weight: Floats
    residual: Floats

    def see(self, values: Floats) -> Seen:
        """Weigh templates, shape (..., row, event, freq), and take their products with the free vectors."""
        weighed = self.weigh(values)
        return Seen(values, weighed, self.along(weighed))

    def inner(self, templates: Seen | ChannelTemplates, profiles: Floats) -> tuple[Floats, Floats]:
        """Information (1) of templates with time profiles (profile, event), and u'Wv alone.

        Returns
        -------
        Shape (..., k, k, member, profile), of templates in channels (factor, k, k, member, profile).
        """
        if isinstance(templates, ChannelTemplates):
            return self._inner_of_channels(templates, profiles)
        whole = (templates.by_event(templates)[..., None, :] * self.weight) @ profiles.T**2
        lost = self._sum_profiles(templates, profiles)
        return whole - np.einsum("...kmnv,...jmnv->...kjmn", lost @ self._inverse, lost), whole

    def score(self, templates: Seen | ChannelTemplates, profiles: Floats, other: Floats | None = None) -> Floats:
        """Scores <t, e> with every time profile, shape (..., k, member, profile).

        Parameters
        ----------
        profiles
            Shape (profile, event).
        other
            What stands in the place of e, weighed as `weighted_residual` is.
        """
        dual = self.weighted_residual if other is None else other
        if isinstance(templates, ChannelTemplates):
            score = np.matmul(profiles, templates.spectra * dual[:, templates.row_of])
            of_each = np.einsum("mcnf,sf->scmn", score, templates.factors, optimize=True)
            return np.asarray(np.tensordot(of_each, templates.shares, axes=(1, 1)).transpose(0, 3, 1, 2))
        return np.asarray(np.einsum("...kref,mref->...kme", templates.values, dual, optimize=True) @ profiles.T)

    def _sum_profiles(self, templates: Seen, profiles: Floats) -> Floats:
        """N'W t summed over the events of each member with each time profile, shape (..., member, profile, vector)."""
        weight = (self.weight[:, None] * profiles).reshape(-1, profiles.shape[1])
        total = self.sum(templates.along, weight)
        return total.reshape(*total.shape[:-2], len(self.weight), len(profiles), total.shape[-1])

    def _inner_of_channels(self, templates: ChannelTemplates, profiles: Floats) -> tuple[Floats, Floats]:
        """`inner` from sums over sets of events in which every profile is constant."""
        factors, spectra, rows, shares = templates.factors, templates.spectra, templates.row_of, templates.shares
        by_set, set_of = np.unique(profiles, axis=1, return_inverse=True)
        members, count, sets = len(self.weight), len(shares), by_set.shape[1]
        whole = np.empty((len(factors), count, count, members, sets))
        lost = np.empty((len(factors), count, members, sets, len(self.prior_information)))
        for g in range(sets):
            events = np.flatnonzero(set_of.ravel() == g)
            part, here, weight = self.on_events(events), spectra[:, events], self.weight[:, events]
            others = part.weigh_others()
            onto = np.stack([part.onto_channels(weight, one, r, others) for one, r in zip(here, rows, strict=True)])
            lost[..., g, :] = np.tensordot(factors, np.tensordot(shares, onto, axes=1), axes=(1, 2))
            pairs = np.empty((len(here), len(here), *onto.shape[1:3], factors.shape[1]))
            for k, one in enumerate(here):
                for j, other in enumerate(here[: k + 1]):
                    pairs[k, j] = part.between_channels(weight, one, other, rows[k], rows[j])
                    pairs[j, k] = np.swapaxes(pairs[k, j], 1, 2)
            together = np.tensordot(shares, np.tensordot(shares, pairs, axes=1), axes=(1, 1))
            whole[..., g] = np.einsum("sf,...sf->s...", factors, factors @ together)
        lost = by_set @ (lost @ self._root)
        whole = whole @ by_set.T**2
        return whole - np.einsum("skmnv,sjmnv->skjmn", lost, lost), whole

    def products(self, seen: Sequence[Seen], profiles: Sequence[Floats]) -> Floats:
        """Inner products (1) of the templates of several families, each with all its time profiles.

        Returns
        -------
        Shape (member, sum of k n, sum of k n), family after family.
        """
        lost = [self._lost(*family) for family in zip(seen, profiles, strict=True)]
        ends = np.cumsum([0, *(one.shape[1] for one in lost)])
        joined = np.concatenate(lost, axis=1)
        found = -(joined @ self._inverse @ np.swapaxes(joined, 1, 2))
        for i, (one, left) in enumerate(zip(seen, profiles, strict=True)):
            for j, (other, right) in enumerate(zip(seen[: i + 1], profiles, strict=False)):
                rows, columns = slice(ends[i], ends[i + 1]), slice(ends[j], ends[j + 1])
                whole = self._whole(one, other, left, right)
                found[:, rows, columns] += whole
                if i != j:
                    found[:, columns, rows] += np.swapaxes(whole, 1, 2)
        return np.asarray(found)

    def _whole(self, one: Seen, other: Seen, one_profiles: Floats, other_profiles: Floats) -> Floats:
        """Products u'Wv with nothing profiled out, shape (member, k n, j m)."""
        right = one.by_event(other)[:, :, None] * other_profiles
        whole = np.einsum("mne,kjpe->mknjp", self.weight[:, None] * one_profiles, right, optimize=True)
        return np.asarray(whole.reshape(len(self.weight), len(one.values) * len(one_profiles), -1))

    def _lost(self, seen: Seen, profiles: Floats) -> Floats:
        """Products u'WN with the free vectors, shape (member, k n, vector)."""
        sums = np.moveaxis(self._sum_profiles(seen, profiles), -3, 0)
        return np.asarray(sums.reshape(len(sums), -1, sums.shape[-1]))

    def gram(self, templates: Seen) -> Floats:
        """Inner products (1) of templates, shape (member, k, k)."""
        return self.products([templates], [np.ones((1, self.weight.shape[1]))])

    def score_by_event(self, templates: Seen) -> Floats:
        """Contribution of every event to the scores <t, e>, shape (..., k, member, event)."""
        return np.asarray(np.einsum("...kref,mref->...kme", templates.values, self.weighted_residual, optimize=True))

    def inner_by_fold(
        self, templates: Seen, profiles: Floats, fold: NDArray[np.int64], member: int
    ) -> tuple[Floats, Floats, Floats]:
        """Information (1) that the events of each fold hold, the free vectors fitted to all events.

        Parameters
        ----------
        profiles
            Shape (n, event).
        fold
            Number of the fold of each event, shape (event,).

        Returns
        -------
        Shape (fold, k n, k n), the sum over the folds is (1); t'Wt alone, shape (fold, k n); and the fitted amounts of
        the free vectors, shape (k n, vector).
        """
        is_in = _indicators(fold)
        size = len(templates.values) * len(profiles)
        weight = self.weight[member] * is_in
        free = self.sum(templates.along, (weight[:, None] * profiles).reshape(-1, fold.size))
        free = np.moveaxis(free.reshape(-1, len(is_in), len(profiles), free.shape[-1]), 0, 1)
        free = free.reshape(len(is_in), size, -1)
        pairs = templates.by_event(templates)
        whole = np.einsum("ge,ne,kje,me->gknjm", weight, profiles, pairs, profiles, optimize=True)
        whole = whole.reshape(-1, size, size)
        fitted = free.sum(axis=0) @ self._inverse[member]
        mixed = free @ fitted.T
        of_free = fitted @ (self.information_of_free(weight) + self.prior_information / len(is_in)) @ fitted.T
        left = whole - mixed - np.swapaxes(mixed, 1, 2) + of_free
        return left, np.diagonal(whole, axis1=1, axis2=2), fitted

    def score_by_fold(
        self, templates: Seen, profiles: Floats, fold: NDArray[np.int64], member: int, fitted: Floats
    ) -> Floats:
        """Score <t, e> that the events of each fold hold, shape (fold, k n); `fitted` as `inner_by_fold` gives it."""
        is_in, dual = _indicators(fold), self.weighted_residual[member]
        by_event = np.einsum("kref,ref->ke", templates.values, dual)
        own = np.einsum("ge,ne,ke->gkn", is_in, profiles, by_event, optimize=True).reshape(len(is_in), -1)
        along = self.sum(self.along(dual), is_in)
        # The pull of the prior on the fitted amounts, 0 where there is none, counts in equal parts.
        return np.asarray(own - (along - along.mean(axis=0)) @ fitted.T)

    @cached_property
    def weighted_residual(self) -> Floats:
        """W (e - N x) with x fitted, shape (member, row, event, freq): its product with a template is the score."""
        dual = np.empty_like(self.residual)
        for m, residual in enumerate(self.residual):
            dual[m] = self.weigh_clean(residual, m)
        return dual

    def weigh_clean(self, values: Floats, member: int = 0) -> Floats:
        """W of a member's events times a template less what the free vectors describe, shape (row, event, freq)."""
        return np.asarray(self.weight[member][:, None] * self.weigh(self.clean(values, member)))

    def clean(self, values: Floats, member: int = 0) -> Floats:
        """Templates of shape (..., row, event, freq) less what the free vectors describe."""
        return np.asarray(values - self.described(self.fitted(values, member)))

    def fitted(self, values: Floats, member: int = 0) -> Floats:
        """Amounts of the free vectors fitted to templates of shape (..., row, event, freq), shape (..., vector)."""
        onto = self.sum(self.along(self.weigh(values)), self.weight[member : member + 1])[..., 0, :]
        return np.asarray(onto @ self._inverse[member])

    @cached_property
    def rank(self) -> int:
        """Number of independent free vectors of the first member."""
        return int(np.linalg.matrix_rank(self._inverse[0], hermitian=True))

    def covariance_of(self, constants: slice) -> Floats:
        """Covariance of some of the constants, all else that is free fitted as well, shape (member, k, k)."""
        first = self.slope.shape[0] * self.slope.shape[2]
        at = slice(first + constants.start, first + constants.stop)
        return self._inverse[:, at, at]

    @cached_property
    def _inverse(self) -> Floats:
        """(N'WN + L)^-1 of each member on the space that the vectors span, shape (member, vector, vector)."""
        return np.asarray(self._root @ np.swapaxes(self._root, 1, 2))

    @cached_property
    def _root(self) -> Floats:
        """R of each member with R R' = (N'WN + L)^-1; vectors of any size count alike."""
        gram = self.information_of_free(self.weight) + self.prior_information
        return root_of_inverse(gram, SMALLEST_EIGENVALUE)


def _indicators(fold: NDArray[np.int64]) -> Floats:
    """1 where an event lies in a fold, shape (fold, event)."""
    return np.asarray(fold == np.arange(fold.max() + 1)[:, None], dtype=float)
