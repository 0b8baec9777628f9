"""Static departures of single antennas along frequency: wrong lengths, reflections.

A(nu) is common to a station's antennas. Every antenna departs from it a little, and how much along each shape is seen
from the antennas themselves: one is claimed only if it lies outside the prediction interval of the others of its cable
name (Student's t, leave one out). No error of the fit enters, only how antennas scatter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.stats import t as student

from lbacal_core.causes.cable import CableLength, CableReflection, log_loss_per_metre
from lbacal_core.causes.catalogue import STATIC_CAUSES
from lbacal_core.discovery.baseline import Baseline, StationData
from lbacal_core.discovery.scan import equivalent_trials, p_of, sigma_of
from lbacal_core.discovery.targets import Target
from lbacal_core.grids import Floats

FEWEST_OTHERS = 4
"""An antenna is compared with those of the same cable name, of which there must be so many."""


@dataclass(frozen=True)
class StaticScore:
    """The significance of a static cause for one antenna.

    Attributes
    ----------
    z
        Normal equivalent of Student's t of the antenna against the others, with its sign.
    size, sigma
        Departure from the mean of the others and their scatter, in the cause's unit.
    trials
        Equivalent number of independent scores.
    departure
        The shape, change of ln (A L_coax) per unit of size, shape (freq,).
    """

    cause: CableLength | CableReflection
    parameters: dict[str, float]
    target: Target
    z: float
    size: float
    sigma: float
    trials: float
    departure: Floats

    @property
    def p_value(self) -> float:
        """Probability of such a score from the whole family where nothing is hidden."""
        return p_of(abs(self.z), self.trials)


def scan_static(data: StationData, baseline: Baseline, targets: list[Target], seed: int = 0) -> list[StaticScore]:
    """The best score of each static cause, most significant first."""
    antennas = [target for target in targets if target.scope == "antenna"]
    if not antennas:
        return []
    departure, root = _departures(data, baseline, antennas)
    cable = np.array([data.conditions.cables[data.class_of[np.flatnonzero(t.is_member)[0]]] for t in antennas])
    compared = [name for name in np.unique(cable) if np.sum(cable == name) > FEWEST_OTHERS]
    cables = dict(zip(data.conditions.cables, np.exp(data.conditions.cable_log_loss), strict=True))
    scores = []
    for cause in STATIC_CAUSES:
        shapes = cause.shapes(data.conditions.frequency_mhz, log_loss_per_metre(cables))
        if not shapes or not compared:
            continue
        flat = np.eye(root.shape[0]) - 1.0 / root.shape[0]
        vectors = solve_triangular(root, flat @ np.stack([shape.departure for shape in shapes]).T, lower=True).T
        norm = np.sum(vectors**2, axis=1)
        sizes = departure @ vectors.T / norm
        unit = vectors / np.sqrt(norm)[:, None]
        count = float(sum(np.sum(cable == name) for name in compared))
        trials = float(equivalent_trials(unit @ unit.T, [0] * len(shapes), [count], seed)[0])
        z, change, scatter = np.zeros_like(sizes), np.zeros_like(sizes), np.ones_like(sizes)
        for name in compared:
            rows = np.flatnonzero(cable == name)
            z[rows], change[rows], scatter[rows] = _against_others(sizes[rows])
        a, k = np.unravel_index(int(np.argmax(np.abs(z))), z.shape)
        scores.append(
            StaticScore(
                cause,
                shapes[k].parameters,
                antennas[a],
                float(z[a, k]),
                float(change[a, k]),
                float(scatter[a, k]),
                trials,
                shapes[k].departure,
            )
        )
    return sorted(scores, key=lambda score: score.p_value)


def _against_others(sizes: Floats) -> tuple[Floats, Floats, Floats]:
    """Each antenna against the prediction interval of the others: normal equivalent, difference, scatter."""
    others = sizes.shape[0] - 1
    mean = (sizes.sum(axis=0) - sizes) / others
    square = (np.sum(sizes**2, axis=0) - sizes**2) / others - mean**2
    scatter = np.sqrt(np.maximum(square, 1e-300) * others / (others - 1) * (1 + 1 / others))
    ratio = (sizes - mean) / scatter
    p_value = 2 * student.sf(np.abs(ratio), others - 1)
    return np.sign(ratio) * np.vectorize(sigma_of)(p_value), sizes - mean, scatter


def _departures(data: StationData, baseline: Baseline, antennas: list[Target]) -> tuple[Floats, Floats]:
    """Whitened log slopes of each antenna, mean of its dipoles, and the root that whitens the noise of the fit."""
    channels = data.power.shape[2]
    solution = baseline.solution
    log_slope = np.log(np.maximum(solution.x, 1e-300))
    for index in np.unique(data.class_of):
        members = np.flatnonzero(data.class_of == index)
        log_slope[members] -= np.median(log_slope[members], axis=0)
    log_slope -= log_slope.mean(axis=1, keepdims=True)
    covariance = solution.covariance[:, :channels, :channels] / (solution.x[:, :, None] * solution.x[:, None, :])
    trace = np.einsum("pii->p", covariance)
    typical = np.nanargmin(np.abs(trace - np.nanmedian(trace)))
    # A gain that is flat in frequency is free: a wide variance for the constant.
    root = np.linalg.cholesky(covariance[typical] + np.ones((channels, channels)))
    of_antenna = np.stack([log_slope[target.is_member].mean(axis=0) for target in antennas])
    return solve_triangular(root, of_antenna.T, lower=True).T, root
