"""Comparison of antennas: departures of single antennas along frequency that are constant in time.

A(nu) is common to a station's antennas, and every antenna departs from it a little. The scatter of these departures
along each template is measured from all antennas against others of their cable name. An antenna is a finding only if it
lies outside the prediction interval of the others (Student's t, leave one out). Antennas of different cable names are
not compared: the noise of the common event gain moves the slopes of short and long cables apart, all together.

Antennas differ smoothly along frequency, each in its own way and by many times the error of the fit. A band of few
periods does not keep such a departure apart from a ripple: what leaked into ripples of 0.1 us was named as a reflection
in 3 of 220 worlds. A ripple is what remains beside departures as smooth as those that most antennas show. A wrong
length is smooth itself: beside it they are as large as in a typical antenna, not free.

A name must hold against a smooth law without a name: another slope of one gain was a ripple of one period, or a length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray
from scipy.special import stdtr

from lbacal_core.causes.cable import AntennaCause, AntennaTemplate, CableLength, log_loss_per_metre
from lbacal_core.causes.catalogue import ANTENNA_CAUSES
from lbacal_core.causes.cause import signature
from lbacal_core.discovery.baseline import Baseline
from lbacal_core.discovery.hypothesis import Hypothesis, Target, p_of, sigma_of, trials_factor
from lbacal_core.discovery.noise import with_memory
from lbacal_core.discovery.policy import Policy
from lbacal_core.discovery.project import LinearModel
from lbacal_core.discovery.station import Station
from lbacal_core.discovery.view import Seen, View
from lbacal_core.grids import Floats
from lbacal_core.linear import find_whitener, fit_least_squares, invert_symmetric, root_of, solve_symmetric

# One antenna against the others of its cable name, along frequency.

MOST_SMOOTH, CHANNELS_PER_SMOOTH = 8, 6
"""Most half periods within the band of a departure that counts as smooth, and fewest channels for each."""
TYPICAL = 1.3
"""Median departure along a cosine, in errors of the fit, beyond which antennas differ along it; of noise it is 0.67."""
NORMAL_MEDIAN = 0.6745
"""Median of the absolute value of a standard normal number."""
SMALLEST_SHARE = 0.02
"""Share of its information below which a ripple is not told from smooth departures."""


@dataclass(frozen=True)
class SmoothDeparture:
    """Polynomial in frequency by which one antenna departs from the others.

    Attributes
    ----------
    degree
        Degree of the polynomial: 1 is a slope.
    departure
        ln (A L_coax) less that of the others by the law, shape (freq,), without its mean.
    chi2
        Chi^2 of what it leaves, by the errors of the fit.
    description_length
        Chi^2 and what its free numbers cost, each ln of the number of channels (Schwarz 1978, Ann. Stat. 6, 461).
    """

    degree: int
    departure: Floats
    chi2: float
    description_length: float


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
        """The same with departures left free beside those before, within typical amounts where these are given.

        Shapes (departure, freq) and (departure,).
        """
        typical = np.full(len(departures), np.inf) if typical is None else typical
        return replace(
            self, smooth=np.concatenate([self.smooth, departures]), typical=np.concatenate([self.typical, typical])
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
        """The departure of the dipoles' mean less what is smooth beside a found one, (freq,), and less its mean."""
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
        product = self.view.products([left, right], [everyone, everyone])[0][: len(one), len(one) :]
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
        before = self.chi2_without
        length, amplitude = float(self._lengths(self.see([template]))[0]), float(self.amplitudes([template])[0, 0])
        return before, before - 2 * size * amplitude * length + (size * length) ** 2

    @property
    def chi2_without(self) -> float:
        """Chi^2 of the mean of the dipoles against the others."""
        return float(np.sum(self.view.residual[0] * self.view.weighted_residual[0]))

    def fit_smoothly(self, frequency_mhz: Floats) -> SmoothDeparture:
        """The likeliest polynomial in frequency, of degree 1 at least."""
        channels = frequency_mhz.size
        place = 2.0 * (frequency_mhz - frequency_mhz[0]) / max(float(np.ptp(frequency_mhz)), 1e-300) - 1.0
        laws = []
        for degree in range(1, max(1, min(MOST_SMOOTH, channels // CHANNELS_PER_SMOOTH)) + 1):
            every = legvander(place, degree)[:, 1:].T
            departure, chi2 = self.fit(every)[0] @ every, self.beside(every).chi2_without
            cost = degree * float(np.log(channels))
            laws.append(SmoothDeparture(degree, departure - departure.mean(), chi2, chi2 + cost))
        return min(laws, key=lambda law: law.description_length)


def compare(number: int, log_slope: Floats, covariance: Floats, cable: NDArray[np.str_]) -> Comparison | None:
    """One antenna against the weighted mean of the others of its cable name; None where there are none, or no fit.

    Parameters
    ----------
    number
        Row of the antenna, not its number on record.
    log_slope, covariance
        ln (A L_coax), shape (mean or half difference, antenna, freq), and its covariance, shape (antenna, freq, freq),
        NaN where there is no fit.
    cable
        Cable name of each, shape (antenna,).
    """
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
    law
        The smooth law that is likelier by far, so that the cause is no name of what the antenna shows; or None.
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
    law: SmoothDeparture | None = None

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
    changing: Sequence[Target] = (),
) -> list[AntennaScore]:
    """The best score of each static cause, most significant first.

    Parameters
    ----------
    findings
        Causes that were divided out of the power. What a wrong size of one on a single antenna leaves along frequency
        is no cause of that antenna: half a line of interference was a reflection.
    changing
        Who shows what nothing describes, and is no measure of others: the mean of three with one that echoes since a
        date was a reflection in the second.
    """
    antennas = [target for target in targets if target.scope == "antenna"]
    antennas = antennas or [target for target in targets if target.scope == "path"]
    if not antennas or count_comparisons(station) < FEWEST_COMPARISONS:
        return []
    slopes = _log_slopes(station, baseline, antennas)
    for place, antenna in enumerate(antennas):
        if any(np.any(one.is_member & antenna.is_member) for one in changing):
            slopes[1][place] = np.nan
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
        template, size, strength = _refine(cause, own, tried[int(n)], frequency)
        chi2_before, chi2_after = own.chi_squared(template, size)
        law, forms = own.fit_smoothly(frequency), cause.free_forms(template, frequency)
        free = len(forms[0]) + (len(forms) > 1)
        length = min(own.beside(form).chi2_without for form in forms) + free * float(np.log(frequency.size))
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
                sigma=float(scatter[k, n]) / strength,
                trials=int(is_compared.sum()) * trials_factor(correlation, seed, abs(float(z[k, n]))),
                chi2_before=chi2_before,
                chi2_after=chi2_after,
                dof=template.departure.size - 2 - int(np.isinf(own.typical).sum()),
                departure=template.departure,
                observed=own.less_smooth(size * template.departure),
                error=np.diag(invert_symmetric(own.root @ own.root.T)) ** -0.5,
                similar=similar,
                law=law if law.description_length + 2.0 * policy.likelier < length else None,
            )
        )
    return sorted(scores, key=lambda score: score.p_value)


MOST_MOVES = 8
"""Times that templates are tried about the best of those before."""


def _refine(
    cause: AntennaCause, own: Comparison, template: AntennaTemplate, frequency_mhz: Floats
) -> tuple[AntennaTemplate, float, float]:
    """The best template, its size and its length, found from one that was tried.

    The scatter of the others may prefer a delay further from the best one than the closer delays reach.
    """
    best = own.refine([template])
    for _ in range(MOST_MOVES):
        best = own.refine(cause.finer_templates(template, frequency_mhz))
        last, template = template, best[0]
        if np.allclose(list(template.parameters.values()), list(last.parameters.values())):
            break
    return best


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


# Comparison of cable names: whether the length on record of a whole cable name is wrong.
#
# The antennas of a station share A(nu), so that ln s - ln L_coax is the same for all but for the departures of single
# antennas. What moves all antennas of a cable name together must be known as well: the gain of an event that they share
# shifts the slopes of short and long cables differently, as does a sky that is not the true one. The influence of each
# event on the fitted slopes measures the first, whatever form the gains have (the sandwich of a linear estimator,
# events being independent; Huber 1967); the second is the response to the differences between sky models.

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
    of_channel = levels.path_channel**2 * np.eye(len(levels.vectors))
    whole = with_memory(levels.of_all(levels.path_shared[:, c]) + of_channel, levels.path_memory)
    variance, turned = np.linalg.eigh((whole - of_channel) * scale**2)
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
