"""Comparison of cable names: whether the length on record of a whole cable name is wrong.

The antennas of a station share A(nu), so that ln s - ln L_coax is the same for all but for the departures of single
antennas. What moves all antennas of a cable name together must be known as well: the gain of an event that they share
shifts the slopes of short and long cables differently, as does a sky that is not the true one. The influence of each
event on the fitted slopes measures the first, whatever form the gains have (the sandwich of a linear estimator, events
being independent; Huber 1967); the second is the response to the differences between sky models.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from lbacal_core.causes.cable import CableLength, log_loss_per_metre
from lbacal_core.discovery.antennas import AntennaScore
from lbacal_core.discovery.baseline import Baseline
from lbacal_core.discovery.hypothesis import Target
from lbacal_core.discovery.project import LinearModel
from lbacal_core.discovery.station import Station
from lbacal_core.discovery.trials import sigma_of
from lbacal_core.grids import Floats
from lbacal_core.linear import invert_symmetric, solve_symmetric

FEWEST_ANTENNAS = 2
"""Antennas of a cable name, so that their scatter is known."""
FEWEST_CHANNELS = 10
"""Channels in which every antenna hears the sky."""
MOST_DEAF = 0.3
"""Share of the channels in which an antenna may have no slope, as behind a long cable at the end of the band."""
WORST_NOISE = 5.0
"""Errors of the size of an antenna, over the median: beyond, as of one that hardly hears the sky, it is left out."""


@dataclass(frozen=True)
class _Antennas:
    """The antennas that are compared.

    Attributes
    ----------
    cable
        Cable name, shape (antenna,).
    log_gain
        ln s - ln L_coax, mean of the dipoles, shape (antenna, freq).
    influence
        Change of it by each event, shape (antenna, event, freq).
    response
        Change of it by each difference between sky models, shape (antenna, mode, freq).
    """

    cable: NDArray[np.str_]
    log_gain: Floats
    influence: Floats
    response: Floats

    def on_channels(self, kept: NDArray[np.bool_]) -> _Antennas:
        """Some of the channels."""
        return _Antennas(self.cable, self.log_gain[:, kept], self.influence[..., kept], self.response[..., kept])

    def select(self, kept: NDArray[np.bool_]) -> _Antennas:
        """Some of the antennas."""
        return _Antennas(self.cable[kept], self.log_gain[kept], self.influence[kept], self.response[kept])


def compare_cable_names(baseline: Baseline, model: LinearModel, targets: Sequence[Target]) -> list[AntennaScore]:
    """The scores of a wrong length of each cable name, most significant first; empty where nothing can be compared."""
    station = model.station
    conditions = station.conditions
    wide = {target.label.removeprefix("cable "): target for target in targets if target.scope == "cable"}
    losses = dict(zip(conditions.cables, np.exp(conditions.cable_log_loss), strict=True))
    per_metre = log_loss_per_metre(losses)
    if per_metre is None or len(wide) < 2:
        return []
    antennas = _gather(station, baseline, model)
    channels = np.all(np.isfinite(antennas.log_gain), axis=0)
    if len(antennas.cable) < len(wide) + 1 or channels.sum() < FEWEST_CHANNELS:
        return []
    antennas = antennas.on_channels(channels)
    weights = _weights(antennas, per_metre[channels])
    noise = np.sqrt(np.sum((antennas.influence @ weights) ** 2, axis=1))
    antennas = antennas.select(noise < WORST_NOISE * np.median(noise))
    names, counts = np.unique(antennas.cable, return_counts=True)
    compared = [str(name) for name, count in zip(names, counts, strict=True) if count >= FEWEST_ANTENNAS]
    antennas = antennas.select(np.isin(antennas.cable, compared))
    if len(compared) < 2 or not set(compared) <= wide.keys():
        return []
    departure, dof = _departure(antennas, weights, compared)
    scores = [
        _score(antennas, weights, wide[name], (departure, dof), per_metre, channels, compared) for name in compared
    ]
    return sorted(scores, key=lambda score: score.p_value)


def _score(
    antennas: _Antennas,
    weights: Floats,
    target: Target,
    departure: tuple[float, int],
    per_metre: Floats,
    channels: NDArray[np.bool_],
    compared: Sequence[str],
) -> AntennaScore:
    """A cable name against all others: Student's t of its length."""
    own = antennas.cable == target.label.removeprefix("cable ")
    contrast = np.where(own, 1.0 / own.sum(), -1.0 / (~own).sum())
    observed = contrast @ antennas.log_gain
    size = float(observed @ weights)
    influence = np.einsum("a,aef->ef", contrast, antennas.influence)
    response = np.einsum("a,amf->mf", contrast, antennas.response)
    covariance = influence.T @ influence + response.T @ response
    sigma = float(np.sqrt(weights @ covariance @ weights + departure[0] ** 2 * np.sum(contrast**2)))
    z = float(np.copysign(sigma_of(2 * stdtr(departure[1], -abs(size) / sigma)), size))
    shown, error = np.full((2, per_metre.size), np.nan)
    shown[channels], error[channels] = observed - observed.mean(), np.sqrt(np.diag(covariance))
    rest = shown - size * (per_metre - per_metre[channels].mean())
    is_pair = len(compared) == 2  # the two contrasts are one
    return AntennaScore(
        cause=CableLength(),
        parameters={"or_size": -size} if is_pair else {},
        target=target,
        z=z,
        size=size,
        sigma=sigma,
        trials=1.0 if is_pair else float(len(compared)),
        chi2_before=float(np.nansum((shown / error) ** 2)),
        chi2_after=float(np.nansum((rest / error) ** 2)),
        dof=int(channels.sum()) - 2,
        departure=per_metre,
        observed=shown,
        error=error,
        similar=[],
    )


def _gather(station: Station, baseline: Baseline, model: LinearModel) -> _Antennas:
    """The mean of the dipoles of every antenna whose paths were all fitted; NaN where a slope is not positive."""
    solution = baseline.solution
    is_fitted = np.isfinite(solution.covariance[:, 0, 0]) & (np.mean(solution.x <= 0, axis=1) < MOST_DEAF)
    numbers = [a for a in np.unique(station.antenna) if np.all(is_fitted[station.antenna == a])]
    names = np.array(station.conditions.cables)[station.class_of]
    cable, log_gain, influence, response = [], [], [], []
    for number in numbers:
        paths = np.flatnonzero(station.antenna == number)
        cable.append(names[paths[0]])
        log_loss = station.conditions.cable_log_loss[station.class_of[paths]]
        slope = np.where(solution.x[paths] > 0, solution.x[paths], np.nan)
        log_gain.append(np.mean(np.log(slope) - log_loss, axis=0))
        of_paths = [_influence(station, baseline, model, path) for path in paths.tolist()]
        influence.append(np.mean([one for one, _ in of_paths], axis=0))
        response.append(np.mean([other for _, other in of_paths], axis=0))
    return _Antennas(np.array(cable), np.array(log_gain), np.array(influence), np.array(response))


def _influence(station: Station, baseline: Baseline, model: LinearModel, path: int) -> tuple[Floats, Floats]:
    """Change of ln s of a path by the residual of each event, and by each difference between sky models.

    The estimator is linear about its solution: delta(x, n, q) = Cov J' V^-1 r, with J the derivative of ln P and V the
    noise of the fit, radiometer noise in each channel and what an event shares.

    Returns
    -------
    Shapes (event, freq) and (mode, freq).
    """
    solution, levels = baseline.solution, model.residuals.levels
    c = int(station.class_of[path])
    sky, terms = station.sky[c], station.conditions.intercepts
    slope, before = solution.x[path], terms.before(solution.n[path])
    power = slope * (sky + before) + solution.q[path] @ terms.behind
    of_slope = (sky + before) / power
    constants = np.concatenate([terms.front * slope, terms.behind])[:, None] / power
    present = station.is_present[path]
    precision = np.where(present, 1.0 / station.relative_variance[path], 0.0)
    scale = float(model.residuals.levels.path_scale[path])
    channels = slope.size
    radiometer = (levels.path_channel * scale) ** 2
    variance, turned = np.linalg.eigh(levels.of_all(levels.path_shared[:, c]) * scale**2)
    vectors = turned.T @ levels.vectors
    # What an event shares along each vector takes this part of its weight, shape (vector, event).
    over = np.maximum(variance, 0.0)[:, None] * precision / radiometer
    taken = over / (1.0 + over)

    def weigh(values: Floats) -> Floats:
        """V^-1 times vectors of shape (..., event, freq)."""
        own = values * precision[:, None] / radiometer
        return np.asarray(own - (own @ vectors.T * taken.T) @ vectors)

    information = np.zeros((channels + len(constants), channels + len(constants)))
    weighed = weigh(constants)
    side = np.einsum("ef,cef->fc", of_slope, weighed)
    information[channels:, channels:] = np.einsum("cef,def->cd", constants, weighed)
    information[:channels, channels:], information[channels:, :channels] = side, side.T
    for vector, part in zip(vectors, taken, strict=True):
        along = of_slope * vector
        information[:channels, :channels] -= (along * (part * precision / radiometer)[:, None]).T @ along
    information[np.arange(channels), np.arange(channels)] += precision @ of_slope**2 / radiometer
    # in a flat receiver the information about two noise constants is singular, that about the slopes is not
    inverse = invert_symmetric(information)

    def moved(values: Floats) -> Floats:
        """Change of ln s by each of some residuals, shape (..., event, freq) -> (..., event, freq)."""
        along = weigh(values)
        onto = np.concatenate([along * of_slope, np.einsum("cef,...ef->...ec", constants, along)], axis=-1)
        return np.asarray(onto @ inverse[:, :channels] / slope)

    residual = np.where(present[:, None], baseline.residual[path], 0.0)
    if model.modes is None:
        return moved(residual), np.zeros((0, channels))
    modes = np.concatenate([model.modes.common[:, c], model.modes.own[:, c]])
    share = slope * sky / power
    return moved(residual), np.stack([moved(mode * share).sum(axis=0) for mode in modes])


def _weights(antennas: _Antennas, per_metre: Floats) -> Floats:
    """Weights of the channels whose sum with ln s - ln L_coax is a length in m: a gain flat in frequency is free."""
    noise = np.einsum("aef,aeg->fg", antennas.influence, antennas.influence)
    noise += 1e-3 * np.trace(noise) / len(noise) * np.eye(len(noise))
    columns = np.column_stack([per_metre, np.ones_like(per_metre)])
    solved = solve_symmetric(noise, columns)
    return np.asarray(solved @ invert_symmetric(columns.T @ solved)[:, 0])


def _departure(antennas: _Antennas, weights: Floats, compared: Sequence[str]) -> tuple[float, int]:
    """Standard deviation of the length of single antennas of a name beyond their noise, m, and degrees of freedom."""
    squares, noise, dof = 0.0, 0.0, 0
    for name in compared:
        own = antennas.cable == name
        lengths = antennas.log_gain[own] @ weights
        influence = antennas.influence[own] @ weights
        squares += float(np.sum((lengths - lengths.mean()) ** 2))
        noise += float(np.sum((influence - influence.mean(axis=0)) ** 2))
        dof += int(own.sum()) - 1
    return float(np.sqrt(max(squares - noise, 0.0) / dof)), dof
