"""The baseline of one station: the chain of every path fitted by itself, and its residuals.

Every constant property of a path (its A(nu), its gain in front of or behind N_RCU, its noise constants) is free. A
cause must describe structure that remains beside these.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lbacal_core.calibration.lines import ChainForms, fit_lines
from lbacal_core.calibration.separable import SeparableSolution, solve_separable
from lbacal_core.calibration.singles import hears_the_sky
from lbacal_core.discovery.station import Station
from lbacal_core.grids import Floats
from lbacal_core.instrument.chain import ChainTerms
from lbacal_core.linear import invert_symmetric


@dataclass(frozen=True)
class Baseline:
    """The fitted chain of every path.

    Attributes
    ----------
    residual
        Relative deviation of the spectra from the model, shape (path, event, freq); 0 where absent.
    terms
        The chain of the mean path of each class.
    solution
        Slopes s and noise constants of every path with their covariance.
    """

    residual: Floats
    terms: ChainTerms
    solution: SeparableSolution

    def noise_of(self, is_member: NDArray[np.bool_]) -> tuple[Floats, Floats]:
        """Noise constants of the station, and the covariance of those of one of some paths: (k,) and (k, k)."""
        covariance = self.solution.covariance[:, self.solution.x.shape[1] :, self.solution.x.shape[1] :]
        is_good = np.isfinite(covariance[:, 0, 0])
        own = is_member & is_good if np.any(is_member & is_good) else is_good
        typical = covariance[own].mean(axis=0) if np.any(own) else np.zeros(covariance.shape[1:])
        return _typical_constants(self.solution, is_good | ~np.any(is_good)), typical


def fit_baseline(station: Station, ratio: Floats | None = None) -> Baseline:
    """Fit every path's chain, after dividing the recorded power by what hypotheses do to it.

    Parameters
    ----------
    ratio
        Power with the hypotheses over power without, shape (path, event, freq); None where there is none.
    """
    power = station.power if ratio is None else station.power / ratio
    paths, _, channels = power.shape
    conditions, terms = station.conditions, station.conditions.intercepts
    slope, intercept = np.empty((paths, channels)), np.empty((paths, channels))
    information = np.empty((paths, 2 * channels, 2 * channels))
    forms = ChainForms.of(conditions.frequency_mhz, conditions.antenna_gain, conditions.receiver_gain)
    members = [np.flatnonzero(station.class_of == index) for index in range(len(conditions.dipoles))]
    for rows, sky in zip(members, station.sky, strict=True):
        lines = fit_lines(power[rows], sky, station.relative_variance[rows], forms)
        slope[rows], intercept[rows], information[rows] = lines.slope, lines.intercept, lines.information
    solution = solve_separable(slope, intercept, information, terms)
    noise = terms.before(solution.n) * solution.x + solution.q @ terms.behind
    residual = np.empty_like(power)
    for rows, sky in zip(members, station.sky, strict=True):
        model = solution.x[rows][:, None, :] * sky + noise[rows][:, None, :]
        residual[rows] = power[rows] / model - 1.0
    residual *= station.is_present[:, :, None]
    return Baseline(residual, _mean_terms(station, solution), solution)


def _mean_terms(station: Station, solution: SeparableSolution) -> ChainTerms:
    """The chain of the mean path of each class: noise constants of the station, slopes of the class."""
    # A class without an identifiable path takes the median of all its paths.
    is_good = np.isfinite(solution.covariance[:, 0, 0])
    of_class = [station.class_of == index for index in range(len(station.conditions.dipoles))]
    members = [np.flatnonzero(own & is_good if np.any(own & is_good) else own) for own in of_class]
    is_good |= not np.any(is_good)
    constants, terms = _typical_constants(solution, is_good), station.conditions.intercepts
    before, behind = terms.before(constants[: len(terms.front)]), terms.split_behind(constants[len(terms.front) :])
    slope = np.stack([np.median(solution.x[rows], axis=0) for rows in members])
    return ChainTerms(
        sky=station.sky, n_lna=before, front=slope[:, None, :], receiver_noise=behind[0], adc_noise=behind[1]
    )


def _typical_constants(solution: SeparableSolution, is_good: NDArray[np.bool_]) -> Floats:
    """Median noise constants of some paths, shape (constant,)."""
    # A fitted level of zero or below is uncertain by its error: causes act on at least half of that error. What
    # constants that are not told apart add together is known, and so is each beside the others.
    channels = solution.x.shape[1]
    covariance = solution.covariance[is_good, channels:, channels:]
    variance = np.einsum("pkk->pk", covariance)
    information = np.einsum("pkk->pk", invert_symmetric(np.nan_to_num(covariance)))
    variance = np.where(solution.is_merged[is_good], 1.0 / np.maximum(information, 1e-300), variance)
    floor = 0.5 * np.sqrt(np.nan_to_num(np.median(variance, axis=0)))
    levels = np.column_stack([solution.n[is_good], solution.q[is_good]])
    return np.asarray(np.maximum(np.median(levels, axis=0), floor))


# Paths that hardly hear the sky: their antenna or its amplifier is broken, and they are left out of a search.
#
# The sky is a smaller share of their power than of that of the others. What a wrong sky does to it therefore does not
# cancel in their deviation from the mean, where the differences between sky models are not profiled out, and takes the
# form of a cause.


def leave_out_deaf(station: Station) -> tuple[Station, list[str]]:
    """The station without the paths that hardly hear the sky, and their names; a class keeps one path at least."""
    is_kept = hears_the_sky(sky_shares(station))
    for c in range(len(station.conditions.dipoles)):
        own = station.class_of == c
        if not np.any(is_kept[own]):
            is_kept |= own
    deaf = np.flatnonzero(~is_kept).tolist()
    names = [f"antenna {station.antenna[k]} {station.dipole[k]}" for k in deaf]
    return (station if not deaf else select_paths(station, is_kept)), names


def sky_shares(station: Station) -> Floats:
    """Median over the channels of the share of the sky in the power of each path, shape (path,)."""
    solution = fit_baseline(station).solution
    terms = station.conditions.intercepts
    sky = station.sky.mean(axis=1)[station.class_of] * solution.x
    power = sky + terms.before(solution.n) * solution.x + solution.q @ terms.behind
    return np.asarray(np.median(sky / power, axis=1))


def select_paths(station: Station, kept: NDArray[np.bool_]) -> Station:
    """The station with some of its paths alone."""
    return replace(
        station,
        antenna=station.antenna[kept],
        dipole=station.dipole[kept],
        class_of=station.class_of[kept],
        group=station.group[kept],
        power=station.power[kept],
        relative_variance=station.relative_variance[kept],
    )
