"""The causes that a model has adopted, as hypotheses about one station's data, and the fit of their sizes.

A size belongs to its target: it is fitted once, jointly with the chains of all paths that the target covers. A cause
that the chain of these data describes already, such as a step before the first event, has no size in them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import log_ndtr, ndtri
from threadpoolctl import threadpool_limits

from lbacal_core.calibration.singles import MIN_EVENTS, has_enough
from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.causes.cause import Template, signature
from lbacal_core.causes.model import AdoptedCause, Model
from lbacal_core.discovery.baseline import fit_baseline, leave_out_deaf
from lbacal_core.discovery.hypothesis import OF_ALL, Hypothesis, Target
from lbacal_core.discovery.policy import Policy
from lbacal_core.discovery.project import LinearModel
from lbacal_core.discovery.refit import FittedModel, fit_chain, fit_sizes, linearise, power_ratio
from lbacal_core.discovery.station import SkyModes, Station, gather_stations, model_modes
from lbacal_core.discovery.view import SMALLEST_SHARE
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.linear import invert_symmetric
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.spectra import Spectra


@dataclass(frozen=True)
class FittedSize:
    """The size of an adopted cause in some data.

    Attributes
    ----------
    adopted
        The cause as the model has it.
    value, sigma
        The size in these data; that of the model where it is fixed.
    is_fitted
        Whether these data determined it.
    """

    adopted: AdoptedCause
    value: float
    sigma: float
    is_fitted: bool


@dataclass(frozen=True)
class FittedSizes:
    """A station's chains fitted together with the sizes of the adopted causes.

    Attributes
    ----------
    model
        The fitted model; its hypotheses are the causes of `sizes`.
    sizes
        Only causes that act in these data and that the chain does not describe.
    covariance
        Covariance of the sizes, shape (size, size).
    """

    model: FittedModel
    sizes: Sequence[FittedSize]
    covariance: Floats


def describe_size(size: FittedSize) -> dict[str, Any]:
    """An adopted cause with its `size` in some data, and as `adopted` the one it was adopted with, as JSON values."""
    adopted = size.adopted
    return {
        **adopted.as_dict(),
        "size": {"value": size.value, "sigma": size.sigma, "unit": adopted.in_catalogue.unit},
        "adopted": {"value": adopted.size, "sigma": adopted.sigma},
    }


def find_members(station: Station, label: str) -> NDArray[np.bool_]:
    """Whether each path belongs to a target that a report named, shape (path,)."""
    scope, *words = label.split(" ")
    rest = " ".join(words)
    if scope == "station" and not words:
        return np.ones(station.antenna.size, dtype=bool)
    if scope == "antenna" and words and words[0].isdigit():
        is_member = station.antenna == int(words[0])
        return np.asarray(is_member if len(words) == 1 else is_member & (station.dipole == " ".join(words[1:])))
    if scope == "cable":
        return np.asarray(np.array(station.conditions.cables)[station.class_of] == rest)
    if scope == "group":
        return np.asarray(station.group == rest)
    if scope == "dipole" and rest.endswith(OF_ALL):
        return np.asarray(station.dipole == rest.removesuffix(OF_ALL))
    expected = f"station, dipole X{OF_ALL}, antenna N, antenna N X, cable NAME or group NAME"
    raise BadInputError(f"adopted cause: target in {station.name}", expected, repr(label))


def list_hypotheses(model: Model, station: Station) -> list[tuple[AdoptedCause, Hypothesis]]:
    """The adopted causes that act on paths of a station within its data, at the sizes of the model."""
    found = []
    for adopted in model.of_stations([station.name]).causes:
        cause = replace(adopted.in_catalogue, since_unix=adopted.since_unix, until_unix=adopted.until_unix)
        is_member = find_members(station, adopted.target)
        if not np.any(cause.is_inside(station.conditions)) or not np.any(is_member):
            continue
        for name in cause.covariates(Template(adopted.parameters)):
            if name not in station.conditions.covariates:
                raise BadInputError(
                    f"spectra of {station.name}", f"the column {name}, {cause.identifier} needs it", "none"
                )
        words = len(adopted.target.split(" "))
        scope = "path" if adopted.target.startswith("antenna") and words > 2 else adopted.target.split(" ")[0]
        hypothesis = Hypothesis(
            cause, Template(adopted.parameters), Target(scope, adopted.target, is_member), adopted.size, adopted.sigma
        )
        found.append((adopted, hypothesis))
    return found


def gather_adopted(spectra: Spectra, name: str, simulation: Simulation) -> list[Station]:
    """Lay out the spectra of a station that has adopted causes, if a path of its has enough events for a fit."""
    own = spectra.select(spectra.station == name)
    return gather_stations(own, simulation) if has_enough(own) else []


def fit_adopted(
    station: Station, model: Model, modes: SkyModes | None = None, *, are_sizes_kept: bool = False
) -> FittedSizes:
    """Fit the chains of a station's paths together with the free sizes of a model.

    Parameters
    ----------
    modes
        Relative changes of P_sky by which sky and antenna models differ, or None where P_sky is exact.
    are_sizes_kept
        Whether all sizes stay as they were adopted, so that these data test them.

    Raises
    ------
    BadInputError
        Where the data cannot tell the adopted causes apart, or lack the covariate of one of them.
    """
    named = list_hypotheses(model, station)
    if not named:
        return FittedSizes(fit_chain(station, modes), [], np.zeros((0, 0)))
    for _, one in named:
        station = station.on_events(one.cause.known_events(station.conditions, one.template))
    if station.is_used.sum() < MIN_EVENTS:
        expected = f"{MIN_EVENTS} events or more on which the covariates of the adopted causes are known"
        raise BadInputError(f"spectra of {station.name}", expected, str(int(station.is_used.sum())))
    baseline = fit_baseline(station)
    plain = linearise(station, baseline, modes)
    named = [pair for pair in named if is_seen(plain, pair[1])]
    hypotheses = [one for _, one in named]
    if not hypotheses:
        return FittedSizes(fit_chain(station, modes), [], np.zeros((0, 0)))
    is_free = np.array([adopted.is_free and not are_sizes_kept for adopted, _ in named])
    baseline = fit_baseline(station, power_ratio(station, baseline.terms, hypotheses))
    levels = linearise(station, baseline, modes, hypotheses=hypotheses).residuals.levels
    found = fit_sizes(station, baseline, hypotheses, levels, modes, is_free=is_free)
    if found is None:
        names = ", ".join(one.cause.identifier for one in hypotheses)
        raise BadInputError(
            f"spectra of {station.name}",
            f"data that tell the adopted causes apart ({names})",
            "no joint fit of their sizes",
        )
    fitted, information = found
    covariance = _covariance(information, is_free, np.array([adopted.sigma for adopted, _ in named]))
    sigma = np.sqrt(np.diag(covariance))
    sizes = [
        FittedSize(adopted, one.size, float(s), bool(free))
        for (adopted, _), one, s, free in zip(named, fitted.hypotheses, sigma, is_free, strict=True)
    ]
    final = [replace(one, sigma=size.sigma) for one, size in zip(fitted.hypotheses, sizes, strict=True)]
    return FittedSizes(replace(fitted, hypotheses=final), sizes, covariance)


def is_seen(linear: LinearModel, hypothesis: Hypothesis) -> bool:
    """Whether anything of a hypothesis is left beside the free vectors of the chain."""
    conditions = linear.station.conditions
    template = signature(hypothesis.cause, linear.terms, conditions, hypothesis.template)
    everyone = np.zeros(conditions.time_unix.size, dtype=np.int64)
    _, information, whole = linear.by_fold(template, np.ones((1, everyone.size)), hypothesis.target, everyone)
    return bool(information[0, 0] > SMALLEST_SHARE * whole[0, 0])


def _covariance(information: Floats, is_free: NDArray[np.bool_], sigma: Floats) -> Floats:
    """Covariance of sizes: fitted ones by their information, fixed ones by their own sigma, which moves the others."""
    covariance = np.diag(np.where(is_free, 0.0, sigma**2))
    if np.any(is_free):
        free, fixed = np.flatnonzero(is_free), np.flatnonzero(~is_free)
        own = invert_symmetric(information[np.ix_(free, free)])
        moved = -own @ information[np.ix_(free, fixed)]
        of_fixed = np.diag(sigma[fixed] ** 2)
        covariance[np.ix_(free, free)] = own + moved @ of_fixed @ moved.T
        covariance[np.ix_(free, fixed)] = moved @ of_fixed
        covariance[np.ix_(fixed, free)] = (moved @ of_fixed).T
    return covariance


# What an adopted cause gains on data that did not serve to adopt it: promised beforehand, measured afterwards.
#
# The chain of every path is fitted with the cause, at the size as it was adopted, and without it. With the residuals e
# of the first fit, d those of the second less those of the first, and the noise levels of the first, the log-likelihood
# with the cause less that without it is
#
# gain = <e, d> + <d, d> / 2,
#
# summed over the new events. It is the difference of two likelihoods, right for effects of any size. Where the true
# size is the adopted one, its mean is <d, d> / 2 = SNR^2 / 2 and its standard deviation SNR. Gains of different events
# add up.


@dataclass(frozen=True)
class MeasuredGain:
    """The gain of one adopted cause on some events.

    Attributes
    ----------
    number
        Number of the cause in the model.
    events
        Number of events counted: those on which the target recorded and the cause acts.
    gain
        Log-likelihood with the cause less that without it, the size as adopted and the chain fitted both times.
    expected, expected_sigma
        What these events gain if the size is the adopted one within its error; both 0 where the chain of these data
        describes the cause.
    """

    number: int
    events: int
    gain: float
    expected: float
    expected_sigma: float


@dataclass(frozen=True)
class Promise:
    """The gain in log-likelihood that a finding promises for as many events again, a year later, and its error."""

    gain: float
    sigma: float


def measure_gains(
    spectra: Spectra, simulation: Simulation, is_new: NDArray[np.bool_] | None = None
) -> list[MeasuredGain]:
    """Measure what every adopted cause gains on new events, its size as it was adopted.

    Parameters
    ----------
    spectra
        A window of whole stations, with which the chain is fitted: old events and new ones.
    simulation
        Where its sky is its own, the differences between sky and antenna models are profiled out.
    is_new
        Spectra whose events count, shape (row,); None for all.
    """
    counted = np.ones(len(spectra), dtype=bool) if is_new is None else is_new
    new = {
        (str(name), str(event)) for name, event in zip(spectra.station[counted], spectra.event_id[counted], strict=True)
    }
    found: list[MeasuredGain] = []
    with threadpool_limits(1):
        names = sorted({one.station for one in simulation.causes.causes})
        stations = [one for name in names for one in gather_adopted(spectra, name, simulation)]
        known = simulation.differences if stations else None
        for gathered in stations:
            station = leave_out_deaf(gathered)[0]
            modes = None if known is None else model_modes(station, known)
            fitted = fit_adopted(station, simulation.causes, modes, are_sizes_kept=True)
            events = fitted.model.station.event_id.tolist()
            is_new = np.array([(station.name, event) in new for event in events], dtype=bool)
            found += _gains_of(station, simulation.causes, fitted, modes, is_new)
    return sorted(found, key=lambda one: one.number)


def _gains_of(
    station: Station, model: Model, fitted: FittedSizes, modes: SkyModes | None, is_new: NDArray[np.bool_]
) -> list[MeasuredGain]:
    seen = [size.adopted for size in fitted.sizes]
    linear, found = fitted.model.linear, []
    for number, adopted in enumerate(model.causes):
        if adopted.station != station.name:
            continue
        at = next((k for k, one in enumerate(seen) if one is adopted), None)
        if at is None or not np.any(is_new):
            found.append(MeasuredGain(number, 0, 0.0, 0.0, 0.0))
            continue
        one = fitted.model.hypotheses[at]
        acts = np.any(linear.station.is_present[one.target.is_member], axis=0) & is_new
        rest = fit_adopted(linear.station, model.without(number), modes, are_sizes_kept=True).model.linear
        # weighed alike, each beside what its own fit leaves free
        without = rest.with_levels(linear.residuals.levels)
        moved = without.with_residuals(
            rest.residuals.mean - linear.residuals.mean, rest.residuals.deviation - linear.residuals.deviation
        )
        gain = 0.5 * (without.chi_squared_by_event() - linear.chi_squared_by_event())[is_new].sum()
        noise = float(moved.chi_squared_by_event()[is_new].sum())
        of_size = noise * adopted.sigma / one.size
        error = float(np.sqrt(noise + of_size**2))
        found.append(MeasuredGain(number, int(acts.sum()), float(gain), 0.5 * noise, error))
    return found


def promise_of(finding: Mapping[str, Any]) -> Promise:
    """The gain that a finding of a report promises for as many events again, a year later.

    Among all templates that were tried the most significant one is reported, and only above a threshold: the true size
    is smaller than the one found. It is that at which a score above the threshold has the one found as its mean. From N
    events the variance of their noise is known to (2/N)^1/2, in this year and in the later one.
    """
    evidence, size = finding["evidence"], finding["size"]
    # By chi^2 of the last model: the sigma of a size was fitted with noise levels that contain the effect.
    found = float(np.sqrt(finding["gain"]["chi2_before"] - finding["gain"]["chi2_after"]))
    uncertain = size["sigma"] * found / abs(size["value"])
    true = found * true_share(abs(evidence["score_sigma"]), evidence["trials"] * len(CAUSES))
    gain = found * true - 0.5 * found**2
    of_noise = gain * 2.0 / float(np.sqrt(evidence["events"]))
    return Promise(gain, float(np.sqrt(found**2 * (1.0 + uncertain**2) + of_noise**2)))


def true_share(z: float, trials: float) -> float:
    """The true score over the one found, which is the largest of so many and above the threshold of a search."""
    threshold = float(-ndtri(0.5 * Policy().catalogue_alpha / max(trials, 1.0)))
    if z <= threshold:
        return 0.0

    def surplus(true: float) -> float:
        """Mean score above the threshold less the one found."""
        above = threshold - true
        return float(true + np.exp(-0.5 * above**2 - 0.5 * np.log(2.0 * np.pi) - log_ndtr(-above)) - z)

    return float(brentq(surplus, 0.0, z)) / z if surplus(0.0) < 0 else 0.0
