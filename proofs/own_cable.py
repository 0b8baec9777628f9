"""Whatever scope answers for a path, the truth lies within the error that the path is told.

A campaign is a year of an array with cables of 50, 80 and 115 m, simulated by the twin: every path has a gain of its
own, every station a response of its own. One station is simulated but not given to the fit. Each path is then told C by
its own curve, by its station's, by the array's, and in that one station by that of an array without a spectrum of it.
An error counts over all channels; the errors of one campaign have much in common, so the interval of a rate is that of
the mean over campaigns.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.calibration.own_cable import ToldCurve, carry_to_path
from lbacal_core.curves import FitReport
from lbacal_core.grids import Floats
from lbacal_core.instrument import DIPOLES, Instrument, load_instrument
from lbacal_core.skypower.table import SkyPower
from lbacal_core.twin.campaign import Campaign, simulate_campaign
from lbacal_core.twin.nuisances import Nuisances
from lbacal_core.twin.settings import TwinSettings

STATIONS = ("CS002", "CS003", "CS004", "CS005", "CS006", "CS007")
EVENTS = 300
NUISANCES = Nuisances(missing=0.05, departures=0.01)
WITHIN_1, WITHIN_2 = (0.60, 0.76), (0.91, 0.98)
SCOPES = ("own", "station", "array", "array, no data of the station")


@dataclass(frozen=True)
class Told:
    """What paths were told in one campaign by one kind of answer: errors in units of the error told, and flags."""

    by: str
    cables: Sequence[str]
    pull: Floats
    fraction: Floats
    sigma: Floats
    flags: Sequence[str]


def tell_paths(
    settings: TwinSettings, instrument: Instrument, sky_power: SkyPower, seed: int, silent: str
) -> Iterator[Told]:
    """Simulate a campaign, fit it without one station, and tell every path by every scope."""
    campaign = simulate_campaign(settings, instrument, sky_power, np.random.default_rng(seed), nuisances=NUISANCES)
    spectra = campaign.spectra.select(campaign.spectra.station != silent)
    reports = {
        scope: fit_calibration(spectra, instrument, sky_power, scope) for scope in ("antenna", "station", "array")
    }
    for by, scope in zip(SCOPES, ("antenna", "station", "array", "array"), strict=True):
        stations = [s for s in settings.stations if (s == silent) == (by == SCOPES[-1])]
        yield _tell(by, reports[scope], campaign, stations, settings.start_unix)


def _tell(by: str, report: FitReport, campaign: Campaign, stations: Sequence[str], time_unix: float) -> Told:
    chains = {
        (curve.station, curve.antenna, curve.dipole): (curve, chain)
        for curve, chain in zip(report.curves, report.chains, strict=True)
        if curve.c is not None
    }
    told, rows = [], []
    for one in campaign.truth.stations:
        for antenna in one.antennas.tolist() if one.station in stations else []:
            for dipole in DIPOLES:
                keys = [(one.station, antenna, dipole), (one.station, None, dipole), (None, None, dipole)]
                found = next((chains[key] for key in keys if key in chains), None)
                if found is not None:
                    answer = carry_to_path(*found, one.station, antenna, dipole, time_unix)
                    told.append(answer)
                    rows.append(_errors(answer, campaign.truth.curve(dipole, one.station, antenna)))
    pull, fraction, sigma = (np.array(part) for part in zip(*rows, strict=True))
    return Told(by, [str(answer.cable) for answer in told], pull, fraction, sigma, [answer.flag for answer in told])


def _errors(told: ToldCurve, truth: Floats) -> tuple[Floats, Floats, Floats]:
    """Error over the error told, and both as fractions of C."""
    c, of_noise = np.asarray(told.curve.c), np.asarray(told.curve.c_sigma_stat)
    sigma = np.hypot(of_noise, 0.0 if told.curve.c_sigma_sys is None else told.curve.c_sigma_sys)
    return (c - truth) / sigma, c / truth - 1.0, sigma / c


def coverage(told: Sequence[Told], width: float) -> tuple[float, float]:
    """The rate of errors within `width` times the error told, and the standard deviation of this mean."""
    rates = np.array([np.mean(np.abs(one.pull) < width) for one in told])
    return float(rates.mean()), float(rates.std(ddof=1) / np.sqrt(rates.size))


def judge(told: Sequence[Told]) -> tuple[bool, list[str]]:
    """Whether the claims hold, and the figures."""
    lines = [
        "| answered by | cable | paths | within 1 sigma | within 2 sigma | error: median, 95 % | error told, median |",
        "|---|---|---|---|---|---|---|",
    ]
    is_proven = True
    for by in SCOPES:
        of_scope = [one for one in told if one.by == by]
        for cable in ["all", *sorted(set(of_scope[0].cables), key=int)]:
            chosen = of_scope if cable == "all" else [_of_cable(one, cable) for one in of_scope]
            (one_sigma, its), (two_sigma, their) = coverage(chosen, 1.0), coverage(chosen, 2.0)
            error = np.abs(np.concatenate([one.fraction for one in chosen]))
            sigma = np.concatenate([one.sigma for one in chosen])
            lines.append(
                f"| {by} | {cable} | {len(error)} | {one_sigma:.3f} ± {its:.3f} | {two_sigma:.3f} ± {their:.3f} "
                f"| {100 * np.median(error):.2f} %, {100 * np.quantile(error, 0.95):.2f} % "
                f"| {100 * np.median(sigma):.2f} % |"
            )
            if cable == "all":
                is_proven &= WITHIN_1[0] <= one_sigma <= WITHIN_1[1] and WITHIN_2[0] <= two_sigma <= WITHIN_2[1]
    return is_proven, lines


def _of_cable(told: Told, cable: str) -> Told:
    rows = np.array([name == cable for name in told.cables])
    flags = [flag for flag, name in zip(told.flags, told.cables, strict=True) if name == cable]
    return Told(told.by, [cable] * int(rows.sum()), told.pull[rows], told.fraction[rows], told.sigma[rows], flags)


def prove(arguments: Sequence[str]) -> tuple[bool, list[str]]:
    parser = argparse.ArgumentParser(prog="./dev prove own_cable", description=__doc__)
    parser.add_argument("--campaigns", type=int, default=60)
    parser.add_argument("--seed", type=int, default=50_80_115)
    options = parser.parse_args(arguments)
    from lbacal_core.skypower.model import compute_sky_power

    instrument = load_instrument("lofar-superterp")
    sky_power = compute_sky_power(instrument)
    settings = TwinSettings(stations=STATIONS, events_per_year=EVENTS)
    told: list[Told] = []
    for k in range(options.campaigns):
        told += tell_paths(settings, instrument, sky_power, options.seed + k, STATIONS[k % len(STATIONS)])
    holds, lines = judge(told)
    asked = f"{options.campaigns} campaigns of {len(STATIONS)} stations x 96 paths, {EVENTS} events; one "
    asked += (
        f"station in turn is left out of the fit. Asked of every kind of answer: {WITHIN_1[0]:.0%}-{WITHIN_1[1]:.0%}"
    )
    asked += (
        f" of (path, channel) within 1 sigma and {WITHIN_2[0]:.0%}-{WITHIN_2[1]:.0%} within 2 sigma of the error told."
    )
    return holds, [asked, "", *lines]
