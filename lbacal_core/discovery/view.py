"""Inner products of templates in one view of the residuals, with the free vectors of the fit profiled out.

Residuals e have the inverse noise covariance W, and the fit leaves the vectors N free: A(nu) in every channel, three
noise constants, and the differences between sky models, whose amounts have a Gaussian prior. With L the inverse
covariance of the prior (0 for a vector that is free without limit), the inner product of two templates u and v is that
of what N cannot describe,

    <u, v> = u'Wv - (u'WN) (N'WN + L)^-1 (N'Wv),                                                                   (1)

the score of a template is <u, e> and its information <u, u>: the Fisher matrix with nuisance parameters profiled out
(Cowan 1998, Statistical Data Analysis, section 9.2). No other module knows W or N.

A template is a spectral template, shape (row, event, freq), times a time profile, shape (event,). Spectral templates
are few and time profiles many (dates, hours), so that sums over events are all that each profile costs.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lbacal_core.grids import Floats
from lbacal_core.skypower.differences import Waves

SMALLEST_EIGENVALUE = 1e-10
"""Eigenvalue of the unit-diagonal N'WN below which free vectors are combinations of others to rounding errors."""
SMALLEST_SHARE = 1e-6
"""Share of its information below which a template counts as free: what remains are rounding errors. An example is a
step at a date after which the path recorded nothing."""
MANY_PROFILES = 8
"""Number of time profiles above which sums run first over sets of events in which every profile is constant."""


@dataclass(frozen=True)
class TimeProfiles:
    """Time profiles, and the sets of events in which every profile is constant.

    Attributes
    ----------
    values
        Shape (profile, event).
    order, begins
        Events sorted by set, and where each set begins.
    by_set
        Shape (profile, set).
    """

    values: Floats
    order: NDArray[np.int64]
    begins: NDArray[np.int64]
    by_set: Floats

    def sum(self, values: Floats) -> Floats:
        """Sums over the events of values times each profile, (..., event, n) -> (..., profile, n)."""
        if len(self.begins) == len(self.order):
            return self.values @ values
        return np.asarray(self.by_set @ np.add.reduceat(values[..., self.order, :], self.begins, axis=-2))


def make_profiles(values: Floats) -> TimeProfiles:
    """Prepare time profiles, shape (profile, event); many of them with the sets of events in which all are constant."""
    if len(values) <= MANY_PROFILES:
        events = np.arange(values.shape[1])
        return TimeProfiles(values, events, events, values)
    by_set, set_of = np.unique(values, axis=1, return_inverse=True)
    order = np.argsort(set_of.ravel(), kind="stable")
    return TimeProfiles(values, order, np.searchsorted(set_of.ravel()[order], np.arange(by_set.shape[1])), by_set)


@dataclass(frozen=True)
class Seen:
    """Templates as one view sees them.

    Attributes
    ----------
    values
        t, shape (..., row, event, freq).
    weighed
        W t, the same shape.
    free
        N'W t event by event, shape (..., event, vector).
    """

    values: Floats
    weighed: Floats
    free: Floats

    def by_event(self, other: Seen) -> Floats:
        """Products t'W u of all pairs event by event, nothing profiled out, shape (..., k, j, event)."""
        return np.asarray(np.einsum("...kref,...jref->...kje", self.values, other.weighed))


@dataclass(frozen=True)
class View:
    """One part of the residuals, its noise and its free vectors.

    A view has one row (a path) or several rows with common events (the means of both polarisations). Its members are
    paths with the same templates and noise; every member has its own events.

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
    weight
        Weight of each event for each member, shape (member, event); 0 where absent.
    residual
        Shape (member, row, event, freq).
    waves
        Further free vectors with a prior variance of 1, their spectra of shape (spectrum, row, freq), or None.
    """

    channel: Floats
    inside: Floats
    vectors: Floats
    slope: Floats
    constants: Floats
    prior: Floats
    weight: Floats
    residual: Floats
    waves: Waves | None = None

    def see(self, values: Floats) -> Seen:
        """Weigh templates, shape (..., row, event, freq), and take their products with the free vectors."""
        weighed = self._weigh(values)
        own = np.moveaxis(self.slope * weighed, -3, -2)
        own = own.reshape(*own.shape[:-2], own.shape[-2] * own.shape[-1])
        return Seen(values, weighed, np.concatenate([own, *self._along_others(weighed)], axis=-1))

    def _along_others(self, weighed: Floats) -> list[Floats]:
        """Products of vectors, (..., row, event, freq), with the constants and with the waves, (..., event, vector)."""
        events, channels = weighed.shape[-2:]
        by_event = np.moveaxis(weighed, -2, 0).reshape(events, -1, len(self.slope) * channels)
        products = [by_event @ self._constants_by_event]
        if self.waves is not None:
            of_spectra = by_event @ self.waves.spectra.reshape(len(self.waves.spectra), -1).T
            products.append(of_spectra[..., self.waves.spectrum_of] * self.waves.profile.T[:, None])
        shape = (*weighed.shape[:-3], events)
        return [np.swapaxes(one, 0, 1).reshape(*shape, one.shape[-1]) for one in products]

    @cached_property
    def _constants_by_event(self) -> Floats:
        """Shape (event, row x freq, vector)."""
        flat = np.moveaxis(self.constants, 2, 0)
        return np.ascontiguousarray(np.swapaxes(flat.reshape(*flat.shape[:2], flat.shape[2] * flat.shape[3]), 1, 2))

    def _weigh(self, values: Floats) -> Floats:
        """W times vectors, shape (..., row, event, freq)."""
        amount = values @ self.vectors.T
        if len(self.inside) == 1:
            across = np.squeeze(amount[..., None, :] @ self.inside[0, 0], -2)
        else:
            across = np.einsum("rsekl,...sel->...rek", self.inside, amount)
        weighed = values * self.channel[..., None]
        weighed += (across - amount * self.channel[..., None]) @ self.vectors
        return np.asarray(weighed)

    def inner(self, templates: Seen, profiles: TimeProfiles) -> tuple[Floats, Floats]:
        """Information (1) of templates with one time profile, shape (..., k, k, member, profile); and u'Wv alone."""
        whole = (templates.by_event(templates)[..., None, :] * self.weight) @ profiles.values.T**2
        lost = profiles.sum(self.weight[:, :, None] * templates.free[..., None, :, :])
        return whole - np.einsum("...kmnv,...jmnv->...kjmn", lost @ self._inverse, lost), whole

    def cross(self, one: Seen, other: Seen, one_profiles: Floats, other_profiles: Floats) -> Floats:
        """Inner products (1) of all templates with all time profiles, shape (member, k n, j m).

        Parameters
        ----------
        one, other
            Templates, k and j of them.
        one_profiles, other_profiles
            Shape (n, event) and (m, event).
        """
        members, rows = len(self.weight), len(one.values) * len(one_profiles)
        left = self.weight[:, None] * one_profiles
        right = one.by_event(other)[:, :, None] * other_profiles
        whole = np.einsum("mne,kjpe->mknjp", left, right, optimize=True).reshape(members, rows, -1)
        lost = [
            np.einsum("mne,kev->mknv", self.weight[:, None] * profiles, seen.free, optimize=True)
            for seen, profiles in ((one, one_profiles), (other, other_profiles))
        ]
        flat = [part.reshape(members, -1, part.shape[-1]) for part in lost]
        return np.asarray(whole - flat[0] @ self._inverse @ np.swapaxes(flat[1], 1, 2))

    def gram(self, templates: Seen) -> Floats:
        """Inner products (1) of templates, shape (member, k, k)."""
        everyone = np.ones((1, self.weight.shape[1]))
        return self.cross(templates, templates, everyone, everyone)

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
        free = np.einsum("ge,ne,kev->gknv", weight, profiles, templates.free, optimize=True)
        free = free.reshape(len(is_in), size, -1)
        pairs = templates.by_event(templates)
        whole = np.einsum("ge,ne,kje,me->gknjm", weight, profiles, pairs, profiles, optimize=True)
        whole = whole.reshape(-1, size, size)
        fitted = free.sum(axis=0) @ self._inverse[member]
        mixed = free @ fitted.T
        of_free = fitted @ (self._information_of_free(weight) + self._prior / len(is_in)) @ fitted.T
        left = whole - mixed - np.swapaxes(mixed, 1, 2) + of_free
        return left, np.diagonal(whole, axis1=1, axis2=2), fitted

    def score_by_fold(
        self, templates: Seen, profiles: Floats, fold: NDArray[np.int64], member: int, fitted: Floats
    ) -> Floats:
        """Score <t, e> that the events of each fold hold, shape (fold, k n); `fitted` as `inner_by_fold` gives it."""
        is_in, dual = _indicators(fold), self.weighted_residual[member]
        by_event = np.einsum("kref,ref->ke", templates.values, dual)
        own = np.einsum("ge,ne,ke->gkn", is_in, profiles, by_event, optimize=True).reshape(len(is_in), -1)
        slope = np.einsum("ge,ref,ref->grf", is_in, self.slope, dual, optimize=True).reshape(len(is_in), -1)
        along = np.concatenate([slope, *(is_in @ other for other in self._along_others(dual))], axis=1)
        # The pull of the prior on the fitted amounts, 0 where there is none, counts in equal parts.
        return np.asarray(own - (along - along.mean(axis=0)) @ fitted.T)

    @cached_property
    def weighted_residual(self) -> Floats:
        """W (e - N x) with x fitted, shape (member, row, event, freq): its product with a template is the score."""
        dual = np.empty_like(self.residual)
        for m, (residual, weight) in enumerate(zip(self.residual, self.weight, strict=True)):
            dual[m] = weight[:, None] * self._weigh(self.clean(residual, m))
        return dual

    def clean(self, values: Floats, member: int = 0) -> Floats:
        """Templates of shape (..., row, event, freq) less what the free vectors describe."""
        return np.asarray(values - self.described(self.fitted(values, member)))

    def fitted(self, values: Floats, member: int = 0) -> Floats:
        """Amounts of the free vectors fitted to templates of shape (..., row, event, freq), shape (..., vector)."""
        onto = np.einsum("e,...ev->...v", self.weight[member], self.see(values).free)
        return np.asarray(onto @ self._inverse[member])

    def described(self, amounts: Floats) -> Floats:
        """What amounts of the free vectors describe, (..., vector) -> (..., row, event, freq)."""
        rows, _, channels = self.slope.shape
        end = rows * channels + len(self.constants)
        own = self.slope * amounts[..., : rows * channels].reshape(*amounts.shape[:-1], rows, 1, channels)
        own += np.tensordot(amounts[..., rows * channels : end], self.constants, axes=1)
        if self.waves is not None:
            of_spectrum = np.eye(len(self.waves.spectra))[self.waves.spectrum_of]
            by_event = np.einsum(
                "...v,ve,vd->...ed", amounts[..., end:], self.waves.profile, of_spectrum, optimize=True
            )
            own += np.einsum("...ed,drf->...ref", by_event, self.waves.spectra, optimize=True)
        return np.asarray(own)

    @cached_property
    def rank(self) -> int:
        """Number of independent free vectors of the first member."""
        return int(np.linalg.matrix_rank(self._inverse[0], hermitian=True))

    @cached_property
    def _inverse(self) -> Floats:
        """(N'WN + L)^-1 of each member on the space that the vectors span; vectors of any size count alike."""
        gram = self._information_of_free(self.weight) + self._prior
        size = np.sqrt(np.maximum(np.diagonal(gram, axis1=1, axis2=2), 1e-300))
        values, vectors = np.linalg.eigh(gram / (size[:, :, None] * size[:, None, :]))
        kept = values > SMALLEST_EIGENVALUE * values[:, -1:]
        inverse = np.where(kept, 1.0 / np.where(kept, values, 1.0), 0.0)
        turned = vectors / size[:, :, None]
        return np.asarray((turned * inverse[:, None, :]) @ np.swapaxes(turned, 1, 2))

    @property
    def _prior(self) -> Floats:
        """L, shape (vector, vector)."""
        rows, _, channels = self.slope.shape
        waves = np.ones(0 if self.waves is None else len(self.waves.profile))
        return np.diag(np.concatenate([np.zeros(rows * channels), self.prior, waves]))

    def _information_of_free(self, weight: Floats) -> Floats:
        """N'WN for each set of event weights, (set, event) -> (set, vector, vector)."""
        rows, _, channels = self.slope.shape
        size = rows * channels
        gram = np.empty((len(weight), *self._prior.shape))
        flat = np.swapaxes(self.slope, 0, 1).reshape(-1, size)
        row_of = np.repeat(np.arange(rows), channels)
        for r in range(rows):
            for s in range(rows):
                block = slice(r * channels, (r + 1) * channels), slice(s * channels, (s + 1) * channels)
                gram[:, block[0], block[1]] = self._along_vectors(weight, r, s)
        square = weight @ (flat**2 * self.channel.T[:, row_of])
        gram[:, np.arange(size), np.arange(size)] += square
        end = size + len(self.constants)
        gram[:, size:end, :] = np.einsum("ke,jev->kjv", weight, self.see(self.constants).free, optimize=True)
        if self.waves is not None:
            spectra = np.broadcast_to(
                self.waves.spectra[:, :, None], (len(self.waves.spectra), rows, flat.shape[0], channels)
            )
            for d, free in enumerate(self.see(spectra).free):
                (own,) = np.nonzero(self.waves.spectrum_of == d)
                gram[:, end + own, :] = (weight[:, None] * self.waves.profile[own]) @ free
        gram[:, :size, size:] = np.swapaxes(gram[:, size:, :size], 1, 2)
        return gram

    def _along_vectors(self, weight: Floats, r: int, s: int) -> Floats:
        """The part of N'WN of the slopes of two rows that the vectors of the noise add, shape (set, freq, freq)."""
        size = len(self.vectors)
        amount = self.inside[r, s] - (self.channel[r][:, None, None] * np.eye(size) if r == s else 0.0)
        if len(amount) == 1:
            pairs = np.swapaxes(self.slope[r] * weight[:, :, None], 1, 2) @ self.slope[s]
            return np.asarray(pairs * (self.vectors.T @ amount[0] @ self.vectors))
        total = np.zeros((len(weight), self.slope.shape[2], self.slope.shape[2]))
        for k in range(size):
            for j in range(size):
                left = self.slope[r] * self.vectors[k] * (weight * amount[:, k, j])[:, :, None]
                total += np.swapaxes(left, 1, 2) @ (self.slope[s] * self.vectors[j])
        return total


def _indicators(fold: NDArray[np.int64]) -> Floats:
    """1 where an event lies in a fold, shape (fold, event)."""
    return np.asarray(fold == np.arange(fold.max() + 1)[:, None], dtype=float)
