"""Comparison of antennas: departures of single antennas along frequency that are constant in time.

A(nu) is common to a station's antennas, and every antenna departs from it a little. The scatter of these departures
along each template is measured from all antennas against others of their cable name. An antenna is a finding only if it
lies outside the prediction interval of the others (Student's t, leave one out). Antennas of different cable names are
not compared: the noise of the common event gain moves the slopes of short and long cables apart, all together.

Antennas differ smoothly along frequency, each in its own way and by many times the error of the fit. A band of few
periods does not keep such a departure apart from a ripple: what leaked into ripples of 0.1 us was named as a reflection
in 3 of 220 worlds. A ripple is what remains beside departures as smooth as those that most antennas show. A wrong
length is smooth itself: beside it they are as large as in a typical antenna, not free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from lbacal_core.causes.cable import AntennaCause, AntennaTemplate, log_loss_per_metre
from lbacal_core.causes.catalogue import ANTENNA_CAUSES
from lbacal_core.causes.cause import signature
from lbacal_core.discovery.baseline import Baseline
from lbacal_core.discovery.hypothesis import Hypothesis, Target
from lbacal_core.discovery.one_antenna import compare, smooth_departures, typical_amounts
from lbacal_core.discovery.policy import Policy
from lbacal_core.discovery.station import Station
from lbacal_core.discovery.trials import p_of, sigma_of, trials_factor
from lbacal_core.grids import Floats
from lbacal_core.linear import invert_symmetric

FEWEST_COMPARISONS = 3
"""Smallest number of independent comparisons: antennas less cable names."""
REACH_US = 0.08
"""Delays that differ by less pool their scatter between antennas, as many shorter as longer ones: departures are larger
the smoother they are, and longer delays alone would tell a scatter that is too small."""


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
    chi2_before, chi2_after, dof
        Chi^2 of the antenna against the others along frequency, by the errors of the fit, without and with the cause.
    departure
        The spectral template, change of ln (A L_coax) per unit of size, shape (freq,).
    observed, error
        ln (A L_coax) of the antenna less that of the others, without its mean and the smooth departure beside which the
        cause is looked for, and the error of each channel by the fit given all others (errors of neighbours move
        together), shape (freq,).
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
    chi2_before: float
    chi2_after: float
    dof: int
    departure: Floats
    observed: Floats
    error: Floats
    similar: list[tuple[str, float]]

    @property
    def p_value(self) -> float:
        """Probability of a score as large, for any cause of the antenna comparison, where nothing is hidden."""
        return p_of(abs(self.z), self.trials * len(ANTENNA_CAUSES))


def compare_antennas(
    station: Station,
    baseline: Baseline,
    targets: Sequence[Target],
    policy: Policy,
    seed: int = 0,
    findings: Sequence[Hypothesis] = (),
) -> list[AntennaScore]:
    """The best score of each static cause, most significant first.

    Parameters
    ----------
    findings
        Causes that were divided out of the power. What a wrong size of one on a single antenna leaves along frequency
        is no cause of that antenna: half a line of interference was a reflection.
    """
    antennas = [target for target in targets if target.scope == "antenna"]
    antennas = antennas or [target for target in targets if target.scope == "path"]
    if not antennas or count_comparisons(station) < FEWEST_COMPARISONS:
        return []
    slopes = _log_slopes(station, baseline, antennas)
    compared = {k: one for k in range(len(antennas)) if (one := compare(k, *slopes)) is not None}
    if not compared:
        return []
    is_compared = np.isin(np.arange(len(antennas)), list(compared))
    frequency = station.conditions.frequency_mhz
    smooth = smooth_departures(list(compared.values()), slopes[2][is_compared], frequency)
    typical = typical_amounts(list(compared.values()), smooth)
    left = [_left_along_frequency(station, baseline, antenna, findings) for antenna in antennas]
    compared = {k: one.beside(left[k]) for k, one in compared.items()}
    templates = {
        cause: found for cause in ANTENNA_CAUSES if (found := cause.templates(frequency, _loss_per_metre(station)))
    }
    scores = []
    for cause, every in templates.items():
        amounts = None if cause.is_beside_smooth else typical
        beside = {k: one.beside(smooth, amounts) for k, one in compared.items()}
        tried = next(iter(beside.values())).told_apart(every) if cause.is_beside_smooth else every
        if not tried:
            continue
        amplitude, opposed = np.zeros((2, len(antennas), len(tried)))
        for place, comparison in beside.items():
            amplitude[place], opposed[place] = comparison.amplitudes(tried)
        correlation = next(iter(beside.values())).correlate(tried, tried)
        z, scatter = _against_others(amplitude, opposed, is_compared, correlation, _neighbours(tried))
        k, n = np.unravel_index(int(np.argmax(np.abs(z))), z.shape)
        own = beside[int(k)]
        template, size, length = own.refine(cause.finer_templates(tried[int(n)], frequency))
        chi2_before, chi2_after = own.chi_squared(template, size)
        similar = []
        for other, others in templates.items():
            r = float(np.abs(compared[int(k)].correlate([tried[int(n)]], others)).max())
            if other is not cause and z[k, n] ** 2 * (1 - min(r, 1.0) ** 2) < policy.indistinguishable:
                similar.append((other.identifier, r))
        scores.append(
            AntennaScore(
                cause=cause,
                parameters=template.parameters,
                target=antennas[int(k)],
                z=float(np.copysign(z[k, n], size)),
                size=size,
                sigma=float(scatter[k, n]) / length,
                trials=int(is_compared.sum()) * trials_factor(correlation, seed, abs(float(z[k, n]))),
                chi2_before=chi2_before,
                chi2_after=chi2_after,
                dof=template.departure.size - 2 - int(np.isinf(own.typical).sum()),
                departure=template.departure,
                observed=own.less_smooth(size * template.departure),
                error=np.diag(invert_symmetric(own.root @ own.root.T)) ** -0.5,
                similar=similar,
            )
        )
    return sorted(scores, key=lambda score: score.p_value)


def count_comparisons(station: Station) -> int:
    """Independent comparisons of antennas with others of their cable name."""
    names = np.array(station.conditions.cables)[station.class_of]
    pairs = {(str(name), int(antenna)) for name, antenna in zip(names, station.antenna, strict=True)}
    counts = [sum(name == other for other, _ in pairs) for name in {name for name, _ in pairs}]
    return sum(count - 1 for count in counts)


def why_no_comparison(station: Station) -> dict[str, str]:
    """Causes of the antenna comparison that these data can never show, with the reason."""
    per_metre = _loss_per_metre(station)
    reasons = {}
    for cause in ANTENNA_CAUSES:
        if not cause.templates(station.conditions.frequency_mhz, per_metre):
            reasons[cause.identifier] = cause.needs
        elif count_comparisons(station) < FEWEST_COMPARISONS:
            reasons[cause.identifier] = "needs more antennas of the same cable name to compare"
    return reasons


def _loss_per_metre(station: Station) -> Floats | None:
    conditions = station.conditions
    return log_loss_per_metre(dict(zip(conditions.cables, np.exp(conditions.cable_log_loss), strict=True)))


def _left_along_frequency(
    station: Station, baseline: Baseline, antenna: Target, findings: Sequence[Hypothesis]
) -> Floats:
    """What wrong sizes of findings on an antenna leave in the mean over its events, shape (finding, freq)."""
    left = np.empty((len(findings), station.power.shape[2]))
    is_own = np.zeros(len(findings), dtype=bool)
    for k, one in enumerate(findings):
        is_own[k] = not one.target.is_wide and np.any(one.target.is_member & antenna.is_member)
        shown = signature(one.cause, baseline.terms, station.conditions, one.template)
        left[k] = shown[station.class_of[antenna.is_member][0]].mean(axis=0)
    return left[is_own]


def _neighbours(templates: Sequence[AntennaTemplate]) -> NDArray[np.bool_]:
    """Which templates (second) pool their scatter for each, shape (template, template): those with alike delays."""
    if "delay_us" not in templates[0].parameters:
        return np.eye(len(templates), dtype=bool)
    delay = np.array([template.parameters["delay_us"] for template in templates])
    # In even channels a delay and its complement make the same ripple.
    seen = np.minimum(delay, [template.parameters.get("or_delay_us", np.inf) for template in templates])
    reach = np.minimum(seen - seen.min(), REACH_US)
    return np.asarray(np.abs(seen[:, None] - seen) <= reach[:, None] + 1e-9)


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
    p_value = 2 * stdtr(others * np.maximum(independent, 1.0), -np.abs(ratio))
    return np.sign(ratio) * np.vectorize(sigma_of)(p_value), scatter


def _log_slopes(
    station: Station, baseline: Baseline, antennas: Sequence[Target]
) -> tuple[Floats, Floats, NDArray[np.str_]]:
    """Ln s of every antenna, mean and half difference of its dipoles, covariance of the mean, and cable name.

    Returns
    -------
    Shape (mean or half difference, antenna, freq), (antenna, freq, freq) and (antenna,); NaN where not identifiable.
    """
    channels = station.power.shape[2]
    solution = baseline.solution
    slope = np.where(solution.x > 0, solution.x, np.nan)
    of_path = solution.covariance[:, :channels, :channels] / (slope[:, :, None] * slope[:, None, :])
    log_slope, covariance = np.empty((2, len(antennas), channels)), np.empty((len(antennas), channels, channels))
    for a, target in enumerate(antennas):
        own = np.log(slope[target.is_member])
        log_slope[0, a] = own.mean(axis=0)
        log_slope[1, a] = (own[0] - own[-1]) / 2
        covariance[a] = of_path[target.is_member].sum(axis=0) / target.is_member.sum() ** 2
    names = np.array(station.conditions.cables)[station.class_of]
    return log_slope, covariance, np.array([names[target.is_member][0] for target in antennas])
