"""One antenna against the others of its cable name, along frequency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lbacal_core.causes.cable import AntennaTemplate
from lbacal_core.discovery.view import Seen, View
from lbacal_core.grids import Floats
from lbacal_core.linear import find_whitener, fit_least_squares, root_of

MOST_SMOOTH, CHANNELS_PER_SMOOTH = 8, 6
"""Most half periods within the band of a departure that counts as smooth, and fewest channels for each."""
TYPICAL = 1.3
"""Median departure along a cosine, in errors of the fit, beyond which antennas differ along it; of noise it is 0.67."""
NORMAL_MEDIAN = 0.6745
"""Median of the absolute value of a standard normal number."""
SMALLEST_SHARE = 0.02
"""Share of its information below which a ripple is not told from smooth departures."""


@dataclass(frozen=True)
class Comparison:
    """One antenna against the others of its cable name, whitened by the errors of the fit.

    The channels of a whitened comparison are independent: the view takes them for events of one channel, and its free
    vectors are the gain that is flat in frequency and smooth departures. Its members are the mean and half the
    difference of the dipoles.

    Attributes
    ----------
    root
        Cholesky root of the covariance, shape (freq, freq).
    departure
        ln (A L_coax) of the antenna less that of the others, shape (mean or half difference, freq).
    smooth
        Departures that are left free: smooth ones, and what findings leave, shape (k, freq).
    typical
        Their typical amounts in an antenna, shape (k,); infinite where nothing is known of them.
    """

    root: Floats
    departure: Floats
    smooth: Floats
    typical: Floats

    def beside(self, departures: Floats, typical: Floats | None = None) -> Comparison:
        """The same with departures left free beside those before, within typical amounts where these are given."""
        typical = np.full(len(departures), np.inf) if typical is None else typical
        return replace(
            self,
            smooth=np.concatenate([self.smooth, departures]),
            typical=np.concatenate([self.typical, typical]),
        )

    @cached_property
    def view(self) -> View:
        """The whitened comparison."""
        channels = len(self.root)
        one = np.ones((1, channels))
        return View(
            one,
            one[None, :, :, None, None],
            np.ones((1, 1)),
            self._whiten(one)[:, :, None],
            self._whiten(self.smooth)[:, None, :, None],
            self.typical**-2.0,
            None,
            np.ones((2, channels)),
            self._whiten(self.departure)[:, None, :, None],
        )

    @cached_property
    def _whitener(self) -> Floats:
        return find_whitener(self.root @ self.root.T)

    def _whiten(self, values: Floats) -> Floats:
        """Departures, shape (k, freq), in units of independent errors."""
        return values @ self._whitener.T

    def see(self, templates: Sequence[AntennaTemplate]) -> Seen:
        """Departures in units of the errors."""
        values = self._whiten(np.stack([template.departure for template in templates]))
        return self.view.see(values[:, None, :, None])

    def along(self, departures: Floats) -> Floats:
        """Departure along each of some departures beside those before, in errors of the fit, shape (2, departure)."""
        flat = np.ones((1, departures.shape[1]))
        free = np.linalg.qr(self._whiten(np.concatenate([flat, departures])).T)[0]
        return np.asarray(self._whiten(self.departure) @ free[:, 1:])

    def fit(self, departures: Floats) -> Floats:
        """Amount of each of some departures, all free, in the mean and half the difference, shape (2, departure)."""
        free = self._whiten(np.concatenate([np.ones((1, departures.shape[1])), departures]))
        return np.asarray(fit_least_squares(free.T, self._whiten(self.departure).T).T[:, 1:])

    def told_apart(self, templates: Sequence[AntennaTemplate]) -> list[AntennaTemplate]:
        """Templates that are no smooth departures."""
        bare = np.sum(self._whiten(np.stack([template.departure for template in templates])) ** 2, axis=1)
        is_told = self._lengths(self.see(templates)) ** 2 > SMALLEST_SHARE * bare
        return [template for template, is_kept in zip(templates, is_told, strict=True) if is_kept]

    def less_smooth(self, found: Floats) -> Floats:
        """The departure of the mean of the dipoles less what is smooth beside a found one, without its mean."""
        rest = self._whiten((self.departure[0] - found)[None])[:, :, None]
        left = self.departure[0] - self.root @ (rest - self.view.clean(rest))[0, :, 0]
        return np.asarray(left - left.mean())

    def amplitudes(self, templates: Sequence[AntennaTemplate]) -> Floats:
        """Departure along each template over its error, mean and half difference, shape (2, template).

        The error is that of the fit, and of the departures that are typical of antennas where they are beside it.
        """
        seen = self.see(templates)
        return np.asarray(self.view.score_by_event(seen).sum(axis=-1).T / self._lengths(seen))

    def correlate(self, one: Sequence[AntennaTemplate], other: Sequence[AntennaTemplate]) -> Floats:
        """Correlations of templates, shape (one, other)."""
        everyone = np.ones((1, self.root.shape[0]))
        left, right = self.see(one), self.see(other)
        product = self.view.cross(left, right, everyone, everyone)[0]
        return np.asarray(product / np.outer(self._lengths(left), self._lengths(right)))

    def _lengths(self, seen: Seen) -> Floats:
        return np.asarray(np.sqrt(np.maximum(np.diagonal(self.view.gram(seen)[0]), 0.0)))

    def refine(self, about: Sequence[AntennaTemplate]) -> tuple[AntennaTemplate, float, float]:
        """The best template about one that was found, its size, and its length in units of the error of the fit.

        A ripple has a positive size: its negative is another phase.
        """
        about = self.told_apart(about) or about
        length, amplitude = self._lengths(self.see(about)), self.amplitudes(about)[0]
        best = int(np.argmax(amplitude))
        return about[best], float(amplitude[best] / length[best]), float(length[best])

    def chi_squared(self, template: AntennaTemplate, size: float) -> tuple[float, float]:
        """Chi^2 of the mean of the dipoles against the others, without and with a template at a size."""
        before = float(np.sum(self.view.residual[0] * self.view.weighted_residual[0]))
        length, amplitude = float(self._lengths(self.see([template]))[0]), float(self.amplitudes([template])[0, 0])
        return before, before - 2 * size * amplitude * length + (size * length) ** 2


def compare(number: int, log_slope: Floats, covariance: Floats, cable: NDArray[np.str_]) -> Comparison | None:
    """One antenna against the weighted mean of the others of its cable name; None where there are none, or no fit."""
    is_fitted = np.all(np.isfinite(covariance), axis=(1, 2))
    others = np.flatnonzero((cable == cable[number]) & is_fitted & (np.arange(len(cable)) != number))
    if not is_fitted[number] or not others.size:
        return None
    weight = 1.0 / np.einsum("aff->a", covariance[others])
    weight /= weight.sum()
    root = root_of(covariance[number] + np.tensordot(weight**2, covariance[others], axes=1))
    departure = log_slope[:, number] - np.einsum("a,maf->mf", weight, log_slope[:, others])
    return Comparison(root, departure, np.empty((0, len(root))), np.empty(0))


def smooth_departures(compared: Sequence[Comparison], cable: NDArray[np.str_], frequency_mhz: Floats) -> Floats:
    """Cosines as smooth as the departures that most antennas show and one more, shape (k, freq).

    None where antennas are alike. The one more is for an antenna that departs a little less smoothly than most. What
    all antennas of a cable name show alike is their distance from one that is far from them.
    """
    place = (frequency_mhz - frequency_mhz[0]) / max(float(np.ptp(frequency_mhz)), 1e-300)
    most = min(MOST_SMOOTH, frequency_mhz.size // CHANNELS_PER_SMOOTH)
    cosines = np.cos(np.pi * np.outer(np.arange(1, most + 1), place))
    if not most:
        return cosines
    shown = np.stack([one.along(cosines) for one in compared])
    for name in np.unique(cable):
        shown[cable == name] -= np.median(shown[cable == name], axis=0)
    rows = shown[:, np.any(shown != 0, axis=(0, 2))].reshape(-1, most)
    typical = np.median(np.abs(rows), axis=0)
    shown_by_most = int(np.max(np.flatnonzero(typical > TYPICAL), initial=-1)) + 1
    return np.asarray(cosines[: shown_by_most + 1 if shown_by_most else 0])


def typical_amounts(compared: Sequence[Comparison], departures: Floats) -> Floats:
    """Amount of each of some departures in a typical antenna, fitted together with the others, shape (departure,).

    By the median of all antennas and both differences: what one antenna shows alone does not move it.
    """
    if not len(departures):
        return np.empty(0)
    fitted = np.stack([one.fit(departures) for one in compared])
    shown = np.any(fitted != 0, axis=(0, 2))
    return np.asarray(np.median(np.abs(fitted[:, shown]), axis=(0, 1)) / NORMAL_MEDIAN)
