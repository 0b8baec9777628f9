"""What residuals say of signatures: scores and information, with everything that the fit absorbs projected out.

Residuals are weighed with the inverse covariance of their noise. A signature t has the score t.W.e and the information
t.W.t, after A(nu) of each channel and the three noise constants are taken out of both, path by path: every path with
the events that it has, so that a dead antenna is judged by the year in which it lived.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lbacal_core.causes.terms import ChainTerms
from lbacal_core.discovery.baseline import StationData
from lbacal_core.discovery.targets import Target
from lbacal_core.discovery.whitening import Levels, Residuals
from lbacal_core.grids import Floats

SMALLEST_EIGENVALUE = 1e-10


@dataclass(frozen=True)
class Space:
    """Vectors over events and channels of one row or several (a path, or the means of the dipole letters).

    Attributes
    ----------
    channel
        Inverse variance of what is not flat in frequency, shape (row, event).
    band
        Inverse covariance of the band means of the rows, shape (row, row, event).
    front
        Relative change of the power with ln A(nu), one absorbed vector for each row and channel,
        shape (row, event, freq).
    dense
        Further absorbed vectors, shape (vector, row, event, freq).
    """

    channel: Floats
    band: Floats
    front: Floats
    dense: Floats

    def weigh(self, values: Floats) -> Floats:
        """Inverse covariance times vectors, shape (..., row, event, freq)."""
        band = values.mean(axis=-1)
        across = np.einsum("rse,...se->...re", self.band, band) / values.shape[-1]
        weighed = (values - band[..., None]) * self.channel[..., None]
        weighed += across[..., None]
        return np.asarray(weighed)

    def absorbed_of(self, weighed: Floats) -> Floats:
        """Products with the absorbed vectors event by event, (..., row, event, freq) -> (..., event, vector)."""
        own = np.moveaxis(self.front * weighed, -3, -2)
        other = np.einsum("jref,...ref->...ej", self.dense, weighed)
        return np.concatenate([own.reshape(*own.shape[:-2], -1), other], axis=-1)

    def products_of(self, courses: Floats, smooth: Floats, signs: Floats, weight: Floats) -> tuple[Floats, Floats]:
        """Inner products of functions of the event times functions of frequency, all combinations.

        Parameters
        ----------
        courses, smooth, signs
            Functions of the event, of frequency, and factors on the rows; shape (h, event), (l, freq), (s, row).
        weight
            Of each event, shape (event,).

        Returns
        -------
        Products with the absorbed vectors, shape (s h l, vector), and with each other, shape (s h l, s h l).
        """
        rows, _, channels = self.front.shape
        band = smooth.mean(axis=1)
        rest = smooth - band[:, None]
        joint = np.einsum("rte,st->sre", self.band, signs)
        shape = (len(signs), len(courses), len(smooth))
        own = np.empty((*shape, rows, channels))
        other = np.zeros((*shape, len(self.dense)))
        gram = np.zeros((*shape, *shape))
        of_rest, of_band = rest @ rest.T, np.outer(band, band)
        for s, r in np.ndindex(len(signs), rows):
            single, both = courses * (weight * signs[s, r] * self.channel[r]), courses * (weight * joint[s, r])
            own[s, :, :, r] = (single @ self.front[r])[:, None] * rest
            own[s, :, :, r] += (both @ self.front[r])[:, None] * band[:, None] / channels
            for j, dense in enumerate(self.dense[:, r]):
                other[s, :, :, j] += single @ (dense @ rest.T) + np.outer(both @ dense.mean(axis=1), band)
            for t in range(len(signs)):
                of_single, of_both = single @ (signs[t, r] * courses).T, both @ (signs[t, r] * courses).T
                gram[s, :, :, t] += of_single[:, None, :, None] * of_rest[None, :, None]
                gram[s, :, :, t] += of_both[:, None, :, None] * of_band[None, :, None]
        size = len(signs) * len(courses) * len(smooth)
        absorbed = np.concatenate([own.reshape(size, rows * channels), other.reshape(size, -1)], axis=1)
        return absorbed, gram.reshape(size, size)

    def invert_gram(self, weight: Floats) -> Floats:
        """Inverse of the absorbed vectors' information for each set of event weights, (set, event) -> (set, n, n)."""
        rows, _, channels = self.front.shape
        size = rows * channels
        gram = np.empty((len(weight), size + len(self.dense), size + len(self.dense)))
        flat = np.swapaxes(self.front, 0, 1).reshape(-1, size)
        row_of = np.repeat(np.arange(rows), channels)
        for r in range(rows):
            for s in range(rows):
                at = self.band[r, s] / channels**2 - (self.channel[r] / channels if r == s else 0.0)
                left = self.front[r] * (weight * at)[:, :, None]
                gram[:, _channels_of(r, channels), _channels_of(s, channels)] = np.swapaxes(left, 1, 2) @ self.front[s]
        square = weight @ (flat**2 * self.channel.T[:, row_of])
        gram[:, np.arange(size), np.arange(size)] += square
        of_dense = self.absorbed_of(self.weigh(self.dense))
        gram[:, size:, :] = np.einsum("ke,jen->kjn", weight, of_dense, optimize=True)
        gram[:, :size, size:] = np.swapaxes(gram[:, size:, :size], 1, 2)
        return _invert(gram)

    def clean(self, values: Floats, inverse: Floats, weight: Floats) -> Floats:
        """Vectors less what the fit absorbs, shape (..., row, event, freq), with weights of shape (event,)."""
        absorbed = np.einsum("e,...en->...n", weight, self.absorbed_of(self.weigh(values)))
        return np.asarray(values - self.absorbed_sum(absorbed @ inverse))

    def absorbed_sum(self, amounts: Floats) -> Floats:
        """Absorbed vectors times amounts, (..., vector) -> (..., row, event, freq)."""
        rows, _, channels = self.front.shape
        own = amounts[..., : rows * channels].reshape(*amounts.shape[:-1], rows, 1, channels)
        other = np.einsum("jref,...j->...ref", self.dense, amounts[..., rows * channels :], optimize=True)
        return np.asarray(self.front * own + other)


def _channels_of(row: int, channels: int) -> slice:
    """Where the channels of a row stand among the absorbed vectors."""
    return slice(row * channels, (row + 1) * channels)


def _invert(gram: Floats) -> Floats:
    """Inverse on the space that the vectors span; vectors of any size count alike."""
    size = np.sqrt(np.maximum(np.diagonal(gram, axis1=1, axis2=2), 1e-300))
    values, vectors = np.linalg.eigh(gram / (size[:, :, None] * size[:, None, :]))
    kept = values > SMALLEST_EIGENVALUE * values[:, -1:]
    inverse = np.where(kept, 1.0 / np.where(kept, values, 1.0), 0.0)
    turned = vectors / size[:, :, None]
    return np.asarray((turned * inverse[:, None, :]) @ np.swapaxes(turned, 1, 2))


@dataclass(frozen=True)
class Evidence:
    """A station's residuals with their noise levels, and what the fit absorbs.

    Attributes
    ----------
    terms
        The chain of the mean path of each class, from which the absorbed vectors follow.
    modes
        Relative changes of P_sky by which sky and antenna models differ, shape (mode, class, event, freq), or None.
    empirical
        Further vectors of the mean that count as absorbed, shape (vector, letter, event, freq), or None.
    """

    data: StationData
    residuals: Residuals
    terms: ChainTerms
    modes: Floats | None
    empirical: Floats | None = None

    def with_levels(self, levels: Levels) -> Evidence:
        """The same residuals weighed with other noise levels."""
        return replace(self, residuals=replace(self.residuals, levels=levels))

    @cached_property
    def letter_of(self) -> NDArray[np.int64]:
        """Index of the dipole letter of each class, shape (class,)."""
        return np.searchsorted(self.residuals.letters, self.data.conditions.dipoles)

    @cached_property
    def paths_of(self) -> NDArray[np.int64]:
        """Number of paths in the mean of each dipole letter."""
        letters, in_mean = self.residuals.letters, self.residuals.in_mean
        return np.array([np.sum(self.data.dipole[in_mean] == letter) for letter in letters])

    @cached_property
    def members(self) -> list[NDArray[np.int64]]:
        """Paths of each class."""
        return [np.flatnonzero(self.data.class_of == c) for c in range(len(self.data.conditions.dipoles))]

    @cached_property
    def weight(self) -> Floats:
        """Weight of each event of a path: 0 where absent, less for noisy paths, shape (path, event).

        A path outside the mean is compared with it, and shows the noise of both.
        """
        residuals = self.residuals
        own = residuals.levels.path_scale[:, None] ** 2
        of_mean = residuals.spread[self.letter_of[self.data.class_of]]
        return self.data.is_present / np.where(residuals.in_mean[:, None], own, own + of_mean)

    @cached_property
    def path_spaces(self) -> list[Space]:
        """Deviations of one path of each class."""
        power = self.terms.power()
        front = np.broadcast_to((self.terms.sky + self.terms.n_lna) * self.terms.front / power, power.shape)
        columns = (self.terms.front / power, self.data.conditions.receiver_gain / power, 1.0 / power)
        dense = np.stack([np.broadcast_to(column, power.shape) for column in columns])
        everyone = np.ones(power.shape[1])
        return [self._path_space(front[c], dense[:, c], everyone) for c in range(len(power))]

    def _path_space(self, front: Floats, dense: Floats, weight: Floats) -> Space:
        levels = self.residuals.levels
        channel, band = weight / levels.path_channel**2, weight / levels.path_band**2
        return Space(channel[None], band[None, None], front[None], dense[:, None])

    @cached_property
    def letter_spaces(self) -> list[Space]:
        """Deviations of a path of each letter, of the mean class with the mean weights."""
        front, dense = self._class_means
        letter, in_mean = self.letter_of[self.data.class_of], self.residuals.in_mean
        weights = [self.weight[in_mean & (letter == d)].mean(axis=0) for d in range(len(self.residuals.letters))]
        return [self._path_space(front[d], dense[:, d], weight) for d, weight in enumerate(weights)]

    @cached_property
    def _class_means(self) -> tuple[Floats, Floats]:
        """Absorbed vectors of the mean of each letter: front, shape (letter, event, freq), and dense."""
        share = np.zeros((len(self.residuals.letters), len(self.members)))
        share[self.letter_of, np.arange(len(self.members))] = [self.residuals.in_mean[m].sum() for m in self.members]
        share /= share.sum(axis=1, keepdims=True)
        front = np.stack([space.front[0] for space in self.path_spaces])
        dense = np.stack([space.dense[:, 0] for space in self.path_spaces], axis=1)
        return np.einsum("dc,cef->def", share, front), np.einsum("dc,jcef->jdef", share, dense)

    @cached_property
    def mean_space(self) -> Space:
        """Means over the paths of each dipole letter."""
        residuals, levels = self.residuals, self.residuals.levels
        letters = len(residuals.letters)
        is_known = residuals.spread > 0
        channel = is_known / (
            levels.common_channel[:, None] ** 2 + levels.path_channel**2 * residuals.spread + ~is_known
        )
        joint = residuals.spread.mean(axis=0) * levels.path_band**2
        of_sum, of_difference = (
            is_known.all(axis=0) / (2 * (level**2 + joint) + ~is_known.all(axis=0))
            for level in (levels.common_sum, levels.common_difference)
        )
        band = np.empty((letters, letters, joint.size))
        if letters == 1:
            band[0, 0] = 2 * of_sum
        else:
            band[:] = of_sum - of_difference
            band[[0, 1], [0, 1]] = of_sum + of_difference
        front, constants = self._class_means
        dense = np.zeros((constants.shape[0] * letters, *front.shape))
        for d in range(letters):
            dense[d * len(constants) : (d + 1) * len(constants), d] = constants[:, d]
        if self.modes is not None and self.modes.size:
            sky_share = self.terms.sky * self.terms.front / self.terms.power()
            everyone = np.ones(len(self.data.antenna), dtype=bool)
            # Models differ for each polarisation by itself: a mode of one says nothing of the other.
            shown = self.mean_of(self.modes * sky_share, everyone)
            dense = np.concatenate([dense, *(shown * (np.arange(letters) == d)[:, None, None] for d in range(letters))])
        if self.empirical is not None:
            dense = np.concatenate([dense, self.empirical])
        return Space(channel, band, front, dense)

    @cached_property
    def path_inverse(self) -> Floats:
        """Inverse information of what each path's fit absorbs, shape (path, n, n)."""
        size = self.path_spaces[0].front.shape[2] + len(self.path_spaces[0].dense)
        inverse = np.empty((len(self.data.antenna), size, size))
        for space, members in zip(self.path_spaces, self.members, strict=True):
            inverse[members] = space.invert_gram(self.weight[members])
        return inverse

    @cached_property
    def letter_inverse(self) -> list[Floats]:
        """The same for the mean path of each letter."""
        everyone = np.ones((1, self.data.power.shape[1]))
        return [space.invert_gram(everyone)[0] for space in self.letter_spaces]

    @cached_property
    def mean_inverse(self) -> Floats:
        """The same for the station's mean."""
        return np.asarray(self.mean_space.invert_gram(np.ones((1, self.data.power.shape[1])))[0])

    @cached_property
    def path_dual(self) -> Floats:
        """Weighed and cleaned deviations, whose product with a signature is its score; shape (path, event, freq)."""
        dual = np.empty_like(self.residuals.deviation)
        for space, members in zip(self.path_spaces, self.members, strict=True):
            for k in members:
                clean = space.clean(self.residuals.deviation[k][None], self.path_inverse[k], self.weight[k])
                dual[k] = self.weight[k][:, None] * space.weigh(clean)[0]
        return dual

    @cached_property
    def mean_dual(self) -> Floats:
        """The same for the station's mean, shape (letter, event, freq)."""
        dual: Floats = self.mean_space.weigh(self.clean_mean(self.residuals.mean))
        return dual

    def clean_mean(self, values: Floats) -> Floats:
        """Vectors of the mean less what the fit absorbs, shape (..., letter, event, freq)."""
        return self.mean_space.clean(values, self.mean_inverse, np.ones(values.shape[-2]))

    def clean_path(self, values: Floats, path: int) -> Floats:
        """Vectors of one path less what its fit absorbs, shape (..., event, freq); 0 in absent events."""
        space = self.path_spaces[int(self.data.class_of[path])]
        clean = space.clean(values[..., None, :, :], self.path_inverse[path], self.weight[path])
        return np.asarray(clean[..., 0, :, :] * self.data.is_present[path][:, None])

    def mean_of(self, values: Floats, is_member: NDArray[np.bool_]) -> Floats:
        """What the means over paths show of some paths' effect, (..., class, event, freq) -> (..., letter, ...)."""
        mean = np.zeros((*values.shape[:-3], len(self.residuals.letters), *values.shape[-2:]), dtype=values.dtype)
        for c, share in enumerate(self.share_of_mean(is_member)):
            if share:
                mean[..., self.letter_of[c], :, :] += share * values[..., c, :, :]
        return mean

    def share_of_mean(self, is_member: NDArray[np.bool_]) -> Floats:
        """Part that the members of each class have in the mean of their letter, shape (class,)."""
        counts = np.array([np.sum((is_member & self.residuals.in_mean)[members]) for members in self.members])
        return np.asarray(counts / self.paths_of[self.letter_of])

    def share_of_deviation(self, is_member: NDArray[np.bool_]) -> Floats:
        """Part of an effect that shows in the deviation of each path, shape (path,).

        A member of the mean shows all of it, and the members together less what the mean shows; a path outside shows
        what it has more than the mean.
        """
        in_mean, letter = self.residuals.in_mean, self.letter_of[self.data.class_of]
        of_letter = np.zeros(len(self.paths_of))
        np.add.at(of_letter, self.letter_of, self.share_of_mean(is_member))
        return np.asarray(is_member * np.where(in_mean, 1.0, 1.0 - of_letter[letter]))

    def products(self, signatures: Sequence[Floats], targets: Sequence[Target]) -> tuple[Floats, Floats]:
        """Score, shape (effect,), and information, shape (effect, effect), of effects with their targets.

        Parameters
        ----------
        signatures
            Of each effect, shape (class, event, freq).
        """
        means = np.stack([self.mean_of(s, t.is_member) for s, t in zip(signatures, targets, strict=True)])
        score = np.tensordot(means, self.mean_dual, axes=3)
        information = self._inner(self.mean_space, self.mean_inverse, means)
        for d, count in enumerate(self.paths_of):
            information -= count * self._inner(self.letter_spaces[d], self.letter_inverse[d], means[:, d : d + 1])
        share = np.stack([self.share_of_deviation(target.is_member) for target in targets])
        for c, (space, members) in enumerate(zip(self.path_spaces, self.members, strict=True)):
            own = np.stack([signature[c] for signature in signatures])
            weighed = space.weigh(own[:, None])
            absorbed = space.absorbed_of(weighed)
            both = np.einsum("ief,jef->ije", own, weighed[:, 0], optimize=True)
            for k in members[share[:, members].any(axis=0)]:
                concerned = share[:, k]
                lost = np.einsum("e,ien->in", self.weight[k], absorbed)
                matrix = both @ self.weight[k] - lost @ self.path_inverse[k] @ lost.T
                information += matrix * np.outer(concerned, concerned)
                score += concerned * np.tensordot(own, self.path_dual[k], axes=2)
        return score, information

    def _inner(self, space: Space, inverse: Floats, values: Floats) -> Floats:
        """Information matrix of vectors of shape (k, row, event, freq)."""
        weighed = space.weigh(values)
        absorbed = space.absorbed_of(weighed).sum(axis=-2)
        flat = values.reshape(len(values), -1)
        return np.asarray(flat @ weighed.reshape(len(values), -1).T - absorbed @ inverse @ absorbed.T)

    def mean_information(self, values: Floats) -> Floats:
        """Information matrix of vectors of the mean, shape (k, letter, event, freq)."""
        return self._inner(self.mean_space, self.mean_inverse, values)

    def chi_squared(self) -> tuple[float, int]:
        """Chi^2 of what the fit leaves, and its degrees of freedom."""
        total = float(np.sum(self.residuals.mean * self.mean_dual) + np.sum(self.residuals.deviation * self.path_dual))
        letters, events, channels = self.residuals.mean.shape
        rank = np.linalg.matrix_rank(self.mean_inverse, hermitian=True)
        count = letters * events * channels - int(rank)
        shares = 1.0 - self.residuals.in_mean / self.paths_of[self.letter_of[self.data.class_of]]
        present = self.data.is_present.sum(axis=1)
        count += int(np.sum(shares * np.maximum(present * channels - channels - 3, 0)))
        return total, count
