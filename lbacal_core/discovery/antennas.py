"""Comparison of antennas: departures of single antennas along frequency that are constant in time.

A(nu) is common to a station's antennas, and every antenna departs from it a little. The scatter of these departures
along each template is measured from all antennas against others of their cable name. An antenna is a finding only if it
lies outside the prediction interval of the others (Student's t, leave one out). Antennas of different cable names are
not compared: the noise of the common event gain moves the slopes of short and long cables apart, all together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from lbacal_core.causes.cable import AntennaCause, AntennaTemplate, log_loss_per_metre
from lbacal_core.causes.catalogue import ANTENNA_CAUSES
from lbacal_core.discovery.baseline import Baseline
from lbacal_core.discovery.hypothesis import Target
from lbacal_core.discovery.policy import Policy
from lbacal_core.discovery.station import Station
from lbacal_core.discovery.trials import p_of, sigma_of, trials_factor
from lbacal_core.grids import Floats

FEWEST_COMPARISONS = 3
"""Smallest number of independent comparisons: antennas less cable names."""
REACH_US, SMOOTH_US = 0.08, 0.1
"""Delays that differ by less than the first pool their scatter between antennas. A delay below the second does not:
departures of antennas are larger the smoother they are, so that neighbouring short delays scatter differently."""


@dataclass(frozen=True)
class AntennaScore:
    """The significance of a constant departure of one antenna.

    Attributes
    ----------
    z
        Normal equivalent of Student's t of the antenna against the others, with its sign.
    size, sigma
        Departure from the mean of the others and its standard deviation, in the cause's unit.
    trials
        Equivalent number of independent scores of the cause.
    departure
        The spectral template, change of ln (A L_coax) per unit of size, shape (freq,).
    observed, error
        ln (A L_coax) of the antenna less that of the others, without its mean, and the error of each channel by the fit
        given all others (errors of neighbours move together), shape (freq,).
    similar
        Other causes of the antenna comparison that fit as well, with their correlation.
    """

    cause: AntennaCause
    parameters: dict[str, float]
    target: Target
    z: float
    size: float
    sigma: float
    trials: float
    departure: Floats
    observed: Floats
    error: Floats
    similar: list[tuple[str, float]]

    @property
    def p_value(self) -> float:
        """Probability of a score as large, for any cause of the antenna comparison, where nothing is hidden."""
        return p_of(abs(self.z), self.trials * len(ANTENNA_CAUSES))


def compare_antennas(
    station: Station, baseline: Baseline, targets: Sequence[Target], policy: Policy, seed: int = 0
) -> list[AntennaScore]:
    """The best score of each cause of the antenna comparison, most significant first."""
    antennas = [target for target in targets if target.scope == "antenna"]
    antennas = antennas or [target for target in targets if target.scope == "path"]
    if not antennas or count_comparisons(station) < FEWEST_COMPARISONS:
        return []
    departure, roots, is_compared = _departures(station, baseline, antennas)
    per_metre = log_loss_per_metre(_cable_losses(station))
    templates = {
        cause: found
        for cause in ANTENNA_CAUSES
        if (found := cause.templates(station.conditions.frequency_mhz, per_metre))
    }
    whitened = {cause: _whiten(found, roots) for cause, found in templates.items()}
    scores = []
    for cause, vectors in whitened.items():
        norm = np.linalg.norm(vectors, axis=2)
        amplitude, opposed = np.einsum("akf,maf->mak", vectors, departure) / norm
        unit = vectors[0] / norm[0][:, None]
        z, scatter = _against_others(amplitude, opposed, is_compared, unit @ unit.T, _neighbours(templates[cause]))
        a, k = np.unravel_index(int(np.argmax(np.abs(z))), z.shape)
        trials = int(is_compared.sum()) * trials_factor(unit @ unit.T, seed)
        template, size, length = _refine(cause, templates[cause][int(k)], station, departure[0, a], roots[a])
        similar = []
        for other, others in whitened.items():
            r = float(np.max(np.abs(others[a] @ vectors[a, k]) / np.linalg.norm(others[a], axis=1) / norm[a, k]))
            if other is not cause and z[a, k] ** 2 * (1 - min(r, 1.0) ** 2) < policy.indistinguishable:
                similar.append((other.identifier, r))
        scores.append(
            AntennaScore(
                cause=cause,
                parameters=template.parameters,
                target=antennas[int(a)],
                z=float(np.copysign(z[a, k], size)),
                size=size,
                sigma=float(scatter[a, k]) / length,
                trials=trials,
                departure=template.departure,
                observed=roots[a] @ departure[0, a],
                error=np.diag(np.linalg.inv(roots[a] @ roots[a].T)) ** -0.5,
                similar=similar,
            )
        )
    return sorted(scores, key=lambda score: score.p_value)


def _refine(
    cause: AntennaCause, template: AntennaTemplate, station: Station, departure: Floats, root: Floats
) -> tuple[AntennaTemplate, float, float]:
    """The best template about one that was found, its size, and its norm in units of the error of the fit.

    A ripple and its negative are one template family: the one with a positive size is returned.
    """
    about = cause.finer_templates(template, station.conditions.frequency_mhz)
    vectors = _whiten(about, root[None])[0]
    length = np.linalg.norm(vectors, axis=1)
    amplitude = vectors @ departure / length
    best = int(np.argmax(amplitude))
    return about[best], float(amplitude[best] / length[best]), float(length[best])


def count_comparisons(station: Station) -> int:
    """Independent comparisons of antennas with others of their cable name."""
    names = np.array(station.conditions.cables)[station.class_of]
    pairs = {(str(name), int(antenna)) for name, antenna in zip(names, station.antenna, strict=True)}
    counts = [sum(name == other for other, _ in pairs) for name in {name for name, _ in pairs}]
    return sum(count - 1 for count in counts)


def why_no_comparison(station: Station) -> dict[str, str]:
    """Causes of the antenna comparison that these data can never show, with the reason."""
    per_metre = log_loss_per_metre(_cable_losses(station))
    reasons = {}
    for cause in ANTENNA_CAUSES:
        if not cause.templates(station.conditions.frequency_mhz, per_metre):
            reasons[cause.identifier] = cause.needs
        elif count_comparisons(station) < FEWEST_COMPARISONS:
            reasons[cause.identifier] = "needs more antennas of the same cable name to compare"
    return reasons


def _cable_losses(station: Station) -> dict[str, Floats]:
    conditions = station.conditions
    return dict(zip(conditions.cables, np.exp(conditions.cable_log_loss), strict=True))


def _neighbours(templates: Sequence[AntennaTemplate]) -> NDArray[np.bool_]:
    """Which templates pool their scatter, shape (template, template): those with neighbouring delays."""
    if "delay_us" not in templates[0].parameters:
        return np.eye(len(templates), dtype=bool)
    delay = np.array([template.parameters["delay_us"] for template in templates])
    # In channels of 1 MHz a delay and its complement to 1 us make the same ripple.
    seen = np.minimum(delay, 1.0 - delay)
    reach = np.where(seen < SMOOTH_US, 0.01, REACH_US)
    return np.asarray(np.abs(seen[:, None] - seen) <= np.minimum(reach[:, None], reach) + 1e-9)


def _against_others(
    amplitude: Floats,
    opposed: Floats,
    is_compared: NDArray[np.bool_],
    correlation: Floats,
    neighbours: NDArray[np.bool_],
) -> tuple[Floats, Floats]:
    """Each antenna against the scatter of the others along alike templates: normal equivalent and scatter.

    Parameters
    ----------
    amplitude, opposed
        Departure over its error by the fit, mean and half difference of the dipoles, shape (antenna, template).
    correlation, neighbours
        Correlation of the templates, and which of them are alike; shape (template, template).
    """
    alike = neighbours.astype(float)
    both = np.where(is_compared[:, None], amplitude**2 + opposed**2, 0.0)
    square = both @ alike.T / alike.sum(axis=1)
    others = (is_compared.sum() - 1) * (2 if np.any(opposed) else 1)
    scatter = np.sqrt(np.maximum((square.sum(axis=0) - square) / others, 1e-300))
    # Correlated templates count as fewer: the number of independent ones whose sum has the same scatter.
    independent = alike.sum(axis=1) ** 2 / np.einsum("ki,ij,kj->k", alike, correlation**2, alike)
    ratio = np.where(is_compared[:, None], amplitude / scatter, 0.0)
    p_value = 2 * student.sf(np.abs(ratio), others * np.maximum(independent, 1.0))
    return np.sign(ratio) * np.vectorize(sigma_of)(p_value), scatter


def _whiten(templates: Sequence[AntennaTemplate], roots: Floats) -> Floats:
    """Templates without their flat part in units of each antenna's error, shape (antenna, template, freq)."""
    values = np.stack([template.departure - template.departure.mean() for template in templates])
    return np.swapaxes(np.linalg.solve(roots, np.broadcast_to(values.T, (len(roots), *values.T.shape))), 1, 2)


def _departures(
    station: Station, baseline: Baseline, antennas: Sequence[Target]
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Log slopes against the others of the same cable name, mean and half difference of the dipoles, in their errors.

    Returns
    -------
    Departures, shape (mean or half difference, antenna, freq); the roots that whiten, shape (antenna, freq, freq);
    whether there are others.
    """
    channels = station.power.shape[2]
    solution = baseline.solution
    slope = np.where(solution.x > 0, solution.x, np.nan)
    log_slope, covariance = np.zeros((2, len(antennas), channels)), np.empty((len(antennas), channels, channels))
    cable = np.array([station.conditions.cables[station.class_of[np.flatnonzero(t.is_member)[0]]] for t in antennas])
    of_path = solution.covariance[:, :channels, :channels] / (slope[:, :, None] * slope[:, None, :])
    for a, target in enumerate(antennas):
        own = np.log(slope[target.is_member])
        log_slope[0, a] = own.mean(axis=0)
        log_slope[1, a] = (own[0] - own[-1]) / 2
        covariance[a] = of_path[target.is_member].sum(axis=0) / target.is_member.sum() ** 2
    log_slope -= log_slope.mean(axis=2, keepdims=True)
    is_fitted = np.all(np.isfinite(covariance), axis=(1, 2))
    log_slope[:, ~is_fitted] = 0.0
    precision = np.where(is_fitted, 1.0 / np.einsum("aff->a", np.where(is_fitted[:, None, None], covariance, 1.0)), 0.0)
    departure, is_compared = np.zeros_like(log_slope), np.zeros(len(antennas), dtype=bool)
    roots = np.broadcast_to(np.eye(channels), covariance.shape).copy()
    for a in np.flatnonzero(is_fitted).tolist():
        weight = np.where((cable == cable[a]) & (np.arange(len(antennas)) != a), precision, 0.0)
        if not np.any(weight):
            continue
        weight /= weight.sum()
        is_compared[a] = True
        own = covariance[a] + np.tensordot(weight[weight > 0] ** 2, covariance[weight > 0], axes=1)
        # A gain that is flat in frequency is free: a wide variance for the constant.
        roots[a] = np.linalg.cholesky(own + np.ones((channels, channels)))
        departure[:, a] = np.linalg.solve(roots[a], (log_slope[:, a] - weight @ log_slope).T).T
    return departure, roots, is_compared
