"""The vectors N that a fit leaves free and the inverse covariance W of the noise, event by event.

An event has independent noise in each channel, and a covariance along a few vectors that its channels share: W of an
event is a number plus a matrix of low rank. The slopes ln A(nu) in N act in one channel each, the waves along LST are
few spectra with many profiles in time, and the rest is given event by event.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lbacal_core.grids import Floats
from lbacal_core.skypower.differences import Waves


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
