"""What an adopted cause gains on data that did not serve to adopt it: promised beforehand, measured afterwards.

The chain of every path is fitted with the cause, at the size as it was adopted, and without it. With the residuals e of
the first fit, d those of the second less those of the first, and the noise levels of the first, the log-likelihood with
the cause less that without it is

    gain = <e, d> + <d, d> / 2,

summed over the new events. It is the difference of two likelihoods, right for effects of any size. Where the true size
is the adopted one, its mean is <d, d> / 2 = SNR^2 / 2 and its standard deviation SNR. Gains of different events add up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import log_ndtr, ndtri
from threadpoolctl import threadpool_limits

from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.discovery.adopted import FittedSizes, fit_adopted, gather_adopted
from lbacal_core.discovery.deaf import leave_out_deaf
from lbacal_core.discovery.policy import Policy
from lbacal_core.discovery.station import SkyModes, Station, model_modes
from lbacal_core.instrument import Instrument
from lbacal_core.model import Model
from lbacal_core.skypower.differences import compute_model_differences
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra import Spectra


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
    spectra: Spectra,
    instrument: Instrument,
    sky_power: SkyPower,
    model: Model,
    *,
    is_own_sky: bool,
    is_new: NDArray[np.bool_] | None = None,
) -> list[MeasuredGain]:
    """Measure what every adopted cause gains on new events, its size as it was adopted.

    Parameters
    ----------
    spectra
        A window of whole stations, with which the chain is fitted: old events and new ones.
    is_own_sky
        Whether `sky_power` is the package's own, so that the differences between sky and antenna models are profiled
        out. A sky power from a file is taken as exact.
    is_new
        Spectra whose events count, shape (row,); None for all.
    """
    counted = np.ones(len(spectra), dtype=bool) if is_new is None else is_new
    new = {
        (str(name), str(event)) for name, event in zip(spectra.station[counted], spectra.event_id[counted], strict=True)
    }
    found: list[MeasuredGain] = []
    with threadpool_limits(1):
        stations = gather_adopted(spectra, instrument, sky_power, model)
        known = compute_model_differences(instrument) if is_own_sky and stations else None
        for gathered in stations:
            station = leave_out_deaf(gathered)[0]
            modes = None if known is None else model_modes(station, known)
            fitted = fit_adopted(station, model, modes, are_sizes_kept=True)
            events = fitted.model.station.event_id.tolist()
            is_new = np.array([(station.name, event) in new for event in events], dtype=bool)
            found += _gains_of(station, model, fitted, modes, is_new)
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
