"""The chain test with the sky free within what is known of it: whether the model describes the data at all.

Two things must hold. The intercepts of all channels follow from three noise constants, b = N_LNA s + H q. And along LST
nothing is left beside the lines: the residual of an event, projected on a few smooth functions of frequency, follows no
harmonic of the sidereal day. Exchanged letters, a wrong clock or another antenna's pattern change what is left along
LST first, because a line in each channel absorbs most of what they do to the intercepts.

Where a sky is known to some precision, d ln P_sky = sum_k a_k m_k(LST, nu) with a_k ~ N(0, 1). It moves the measured
lines and what is left beside them by known vectors G (the response of the fit itself), so that both, as one vector r,
have the covariance V + G^T G (V: noise), and

    chi^2 = min over (N_LNA, q) of r^T (V + G^T G)^-1 r

has as many degrees of freedom as r has numbers, less three, and less those of the sky that the data determine, the
trace of G (V + G^T G)^-1 G^T. What the best sky departs from the one given, sum_k a_k^2, counts in full: a sky that is
off by one standard deviation in each mode costs one for each, a wrong clock hundreds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from lbacal_core.calibration.lines import Lines, Look, PathLines, look_beside, move_lines, move_lines_by
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.errors import name_path
from lbacal_core.grids import Floats
from lbacal_core.instrument.chain import Intercepts
from lbacal_core.linear import find_whitener, invert_symmetric, solve_symmetric
from lbacal_core.simulation.prior import SKY_HARMONICS, Mistake, SkyPrior
from lbacal_core.sky.table import harmonics_at

# Mistakes that users have made, as changes of P_sky: the data say whether one describes them better.
#
# Where the sky may follow waves along LST that no model has, data with a mistaken input are not improbable by
# themselves. They are still far more probable with the input set right. The gain of a mistake is ln of the probability
# of the data with P_sky as it would be, over that with P_sky as it is, both with the sky free within what is known of
# it. Where nothing is wrong, a gain of g or more has a probability of at most exp(-g).

LARGEST_GAIN = 10.0
"""Both polarisations together; 24 antennas of clean drawn worlds reach -0.4, exchanged letters 15 and more."""
LIKELY_MISTAKE = "likely mistake"
"""Under this name the notes of a report hold them."""
Owner = tuple[str | None, int | None]
"""Station and antenna of a curve."""


class Tried(NamedTuple):
    """The gain of each mistake in a path, and whether noise and the sky's prior explain what it leaves."""

    gain: Floats
    fits: NDArray[np.bool_]


UNDESCRIBED = "letters, times or antenna, none as tried"
"""What is said where the best mistake describes the data better, and does not describe them."""


def name_mistakes(found: Sequence[tuple[CalibrationCurve, Tried]], mistakes: Sequence[Mistake]) -> dict[Owner, str]:
    """The likely mistake of each antenna, station or array where there is one: its dipoles share it.

    Parameters
    ----------
    found
        Curves with what was tried, each of shape (mistake,).
    """
    total: dict[Owner, Tried] = {}
    for curve, own in found:
        before = total.get(curve.owner, Tried(np.zeros(len(mistakes)), np.ones(len(mistakes), dtype=bool)))
        total[curve.owner] = Tried(before.gain + own.gain, before.fits & own.fits)
    return {
        owner: mistakes[best].name if tried.fits[best] else UNDESCRIBED
        for owner, tried in total.items()
        if tried.gain.size and tried.gain[best := int(np.argmax(tried.gain))] > LARGEST_GAIN
    }


def describe_mistakes(mistaken: Mapping[Owner, str]) -> str:
    """Describe the likely mistakes, the most frequent first, with the first antenna or station that shows it."""
    owners: dict[str, list[Owner]] = {}
    for owner, name in mistaken.items():
        owners.setdefault(name, []).append(owner)
    order = sorted(owners, key=lambda name: (-len(owners[name]), name))
    more = {name: f" and {len(of) - 1} more" if len(of) > 1 else "" for name, of in owners.items()}
    return "; ".join(f"{name} ({name_path(*owners[name][0])}{more[name]})" for name in order)


MISFIT_PROBABILITY = 1e-6
"""A curve whose chi^2 is less probable than this is a misfit: of 2000 good ones 0.002 are."""


@dataclass(frozen=True)
class ChainTest:
    """The result of the chain test of paths.

    Attributes
    ----------
    chi2, dof
        Chi^2 and its degrees of freedom, both shape (path,).
    behind
        What is added behind the antenna, in standard deviations, skies of the prior allowed, shape (path, constant).
    gain
        Ln of the probability of the data without each mistake over that with it, shape (path, mistake).
    """

    chi2: Floats
    dof: Floats
    behind: Floats
    gain: Floats

    @property
    def tried(self) -> list[Tried]:
        """The mistakes that were tried in each path."""
        # the gain of a mistake is half of what it takes from chi^2
        fits = ~is_improbable(self.chi2[:, None] - 2.0 * self.gain, self.dof[:, None])
        return [Tried(*one) for one in zip(self.gain, fits, strict=True)]

    @property
    def per_dof(self) -> Floats:
        """Chi^2 per degree of freedom, shape (path,)."""
        return np.asarray(self.chi2 / self.dof)

    @property
    def is_misfit(self) -> NDArray[np.bool_]:
        """Whether noise and the sky's prior cannot explain it, shape (path,)."""
        return is_improbable(self.chi2, self.dof)


def is_improbable(chi2: Floats, dof: Floats | NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether chi^2 of so many degrees of freedom is less probable than `MISFIT_PROBABILITY`, same shape."""
    return np.asarray((np.asarray(dof) > 0) & (scipy.special.chdtrc(dof, chi2) < MISFIT_PROBABILITY))


@dataclass(frozen=True)
class FittedPaths:
    """Spectra of some paths with what was fitted to them; each path is tested by itself.

    Attributes
    ----------
    power, relative_variance
        As in `fit_lines`, shape (path, event, freq) and (path, event).
    sky_power, lst_hours
        Shape (event, freq) and (event,).
    lines
        Lines of these paths.
    n, slope
        Fitted noise in front, shape (path, r), and s, shape (path, freq). Noise and prior are taken at these: a
        search for the N_LNA at which both are widest would always succeed.
    terms
        What each noise constant adds to an intercept.
    is_free
        Channels whose intercept is not tested, shape (path, freq).
    freedom, dipole
        The sky's prior, None where it is taken at its word; and the paths' dipole.
    """

    power: Floats
    sky_power: Floats
    relative_variance: Floats
    lst_hours: Floats
    lines: Lines
    n: Floats
    slope: Floats
    terms: Intercepts
    is_free: NDArray[np.bool_]
    freedom: SkyPrior | None
    dipole: str

    def test(self) -> ChainTest:
        """Chi^2 and its degrees of freedom, and the gain of each mistake."""
        mistakes, series = 0, None
        if self.freedom is not None:
            mistakes = len(self.freedom.mistakes)
            series = np.concatenate([self.freedom.mistake_series(self.dipole), self.freedom.series(self.dipole)])
        found = []
        for p in range(self.power.shape[0]):
            seen = self._see(p, series, mistakes)
            residual, of_sky_modes = seen.whiten(seen.value), seen.whiten(seen.of_modes.T)
            dof = seen.value.size - len(self.terms.names) - float(np.sum(of_sky_modes**2))
            behind = seen.measure_constants()[len(self.terms.front) :]
            found.append((float(np.sum(residual**2)), dof, *behind, *seen.gain_of(seen.of_mistakes).tolist()))
        first = 2 + len(self.terms.behind)
        table = np.array(found, dtype=float).reshape(-1, first + mistakes)
        return ChainTest(table[:, 0], table[:, 1], table[:, 2:first], table[:, first:])

    def compare(self, predictions: Floats) -> Floats:
        """Ln of the probability of the data of one path under other predictions over that under its own fit.

        Parameters
        ----------
        predictions
            Power of each event by other models that were fitted to the same data, shape (prediction, event, freq).

        Returns
        -------
        Shape (prediction,). A prediction may be far from the fit: what the lines do with it is computed and not
        linearised.
        """
        seen = self._see(0, None if self.freedom is None else self.freedom.series(self.dipole))
        is_present = np.isfinite(self.relative_variance[0])
        return seen.gain_of(seen.respond_to(predictions[:, is_present] / seen.path.model - 1.0))

    def _see(self, p: int, series: Floats | None, mistakes: int = 0) -> _Seen:
        """What the test sees of a path; the first of the series are the mistakes, the others the modes."""
        is_present = np.isfinite(self.relative_variance[p])
        path = PathLines.of(
            self.power[p, is_present], self.sky_power[is_present], self.relative_variance[p, is_present],
            self.lines.select(np.array([p])),
        )  # fmt: skip
        basis, before = harmonics_at(self.lst_hours, SKY_HARMONICS)[is_present], self.terms.before(self.n[p])
        return _Seen.of(path, basis, before, self.slope[p], self.terms, self.is_free[p], series, mistakes)


@dataclass(frozen=True)
class _Seen:
    """What the test sees of a path, one vector r: the intercepts beside the chain's, then what is left along LST.

    Attributes
    ----------
    to_residual
        How the intercepts beside the chain's follow from slopes and intercepts, shape (channel, 2 freq).
    value
        r, in standard deviations, shape (number,).
    of_modes, of_mistakes
        How r answers to each mode of the freedom and to the mistakes, shape (..., number).
    columns
        How it answers to the noise constants, shape (number, constant).
    whitener
        Root of the covariance of r, noise and sky.
    """

    path: PathLines
    look: Look
    to_residual: Floats
    value: Floats
    of_modes: Floats
    of_mistakes: Floats
    columns: Floats
    whitener: Floats

    @classmethod
    def of(
        cls,
        path: PathLines,
        basis: Floats,
        before: Floats,
        slope: Floats,
        terms: Intercepts,
        is_free: NDArray[np.bool_],
        series: Floats | None,
        mistakes: int = 0,
    ) -> _Seen:
        """The vector with its covariance; the first of the series are the mistakes, the others the modes.

        The noise of measured slopes is in r as well: at these, a change of the sky has a part of r by construction.
        What r says of that noise, skies of the modes allowed, is taken off first: what is left of it is not in r.
        """
        channels = path.slope.size
        look = look_beside(path.power / path.model - 1.0, path.of_sky, path.of_constant, basis)
        covariance = invert_symmetric(path.information)
        tested = np.flatnonzero(~is_free)
        to_residual = np.concatenate([-np.diag(before), np.eye(channels)], axis=1)[tested]
        scale = np.sqrt(np.diag(to_residual @ covariance @ to_residual.T))
        to_residual /= scale[:, None]
        value = np.concatenate([to_residual @ np.concatenate([path.slope, path.intercept]), look.value])
        columns = np.zeros((value.size, len(terms.names)))
        forms = np.concatenate([terms.front * slope, terms.behind])
        columns[: tested.size] = forms.T[tested] / scale[:, None]
        noise = np.eye(value.size)
        noise[: tested.size, : tested.size] = to_residual @ covariance @ to_residual.T

        def see_at(sky_slope: Floats) -> _Seen:
            response = np.zeros((0, value.size))
            if series is not None:
                moved = move_lines(path, sky_slope, basis, series)
                signal = sky_slope * path.of_sky
                beside = look.respond(signal, path.of_sky, path.of_constant, basis, series, moved)
                response = np.concatenate([moved @ to_residual.T, beside], axis=1)
            modes = response[mistakes:]
            whitener = find_whitener(noise + modes.T @ modes)
            return cls(path, look, to_residual, value, modes, response[:mistakes], columns, whitener)

        seen = see_at(path.slope)
        if series is None:
            return seen
        of_noise = (seen.whitener.T @ seen.whiten(value)[:, 0])[: tested.size]
        return see_at(path.slope - covariance[:channels] @ to_residual.T @ of_noise)

    def whiten(self, vectors: Floats) -> Floats:
        """Vectors, shape (number, ...), in units of their scatter, the noise constants profiled out."""
        flat = vectors.reshape(self.value.size, -1)
        columns, white = self.whitener @ self.columns, self.whitener @ flat
        return np.asarray(white - columns @ solve_symmetric(columns.T @ columns, columns.T @ white))

    def measure_constants(self) -> Floats:
        """The noise constants in standard deviations, shape (constant,); those in front beside the fitted ones."""
        columns = self.whitener @ self.columns
        inverse = invert_symmetric(columns.T @ columns)
        return np.asarray(inverse @ columns.T @ (self.whitener @ self.value) / np.sqrt(np.diag(inverse)))

    def gain_of(self, responses: Floats) -> Floats:
        """Ln of the probability of r about each response over that about 0; shape (response, number) to (response,)."""
        residual, without = self.whiten(self.value)[:, 0], self.whiten(responses.T)
        return np.asarray(residual @ without - 0.5 * np.sum(without**2, axis=0))

    def respond_to(self, change: Floats) -> Floats:
        """R of data that depart from the lines by relative changes, shape (change, event, freq), and have no noise."""
        path, channels = self.path, self.path.slope.size
        moved = move_lines_by(path, change)
        of_lines = path.of_sky * moved[:, None, :channels] + path.of_constant * moved[:, None, channels:]
        beside = np.einsum("ej,kef,fd->kjd", self.look.directions, change - of_lines, self.look.features, optimize=True)
        of_intercepts = self.value[: len(self.to_residual)] + moved @ self.to_residual.T
        return np.concatenate([of_intercepts, beside.reshape(len(change), -1)], axis=1)
