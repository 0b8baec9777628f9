"""One chain through the years states its errors right, and its years differ by what moved and no more.

A campaign is one path over 3 or 7 years of 400 events, P_sky given: a gain of each year in front of N_RCU (0, 1 or 3 %
from year to year), a season of 3 %, a gain of each event and radiometer noise (`fit.Scene`, which shares nothing with
chain and fit). Each year is fitted together with what is kept of all others. The oracle is the Fisher bound of one who
knows the scatter between years and the noise of the events, in which the season is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.calibration.years import Beside
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.grids import Floats
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.spectra import Spectra
from validation.fit import COMMON_GAIN, PATH_GAIN, RADIOMETER, YEAR_S, YEAR_START, Scene, published_noise_scene
from validation.machinery.claims import Found, mean_of, rate_of, spread_of, worst_of
from validation.machinery.parts import Part, Row

EVENTS, SEASON = 400, 0.03
OF_EVENT = (PATH_GAIN**2 + COMMON_GAIN**2 + SEASON**2 / 2.0) ** 0.5
"""The gain of an event, its season among it."""
YEARS, SCATTERS = (3, 7), (0.0, 0.01, 0.03)
AT_MHZ = (35.0, 55.0, 75.0)
MIDDLE_MHZ = 10.0
"""Channels so near to 55 MHz see the gain alone, and little of its tilt and curvature."""
SIDEREAL_YEAR_S = 366 * 86_164.0905
"""Whole sidereal days: a year later an event sees the same sky."""


def draw_years(scene: Scene, years: int, scatter: float, rng: np.random.Generator) -> tuple[list[Spectra], Floats]:
    """The spectra of each year, and ln of its mean gain in front of N_RCU, shape (year,)."""
    drawn, gains = [], np.empty(years)
    phase, level = rng.uniform(0, 2 * np.pi), scatter * rng.standard_normal(years)
    for k in range(years):
        spectra, sky = scene.draw(rng)
        few = np.sort(rng.choice(len(spectra), EVENTS, replace=False))
        spectra, sky = spectra.select(np.isin(np.arange(len(spectra)), few)), sky[few]
        season = SEASON * np.cos(2 * np.pi * (spectra.time_unix - YEAR_START) / YEAR_S + phase)
        signal = scene.slope * (sky + scene.noise[0])
        moved = signal * np.expm1(level[k] + season)[:, None]
        expected = scene.mean_power(sky)
        names = np.char.add(f"{k}-", spectra.event_id)
        power = spectra.power * (1.0 + moved / expected)
        drawn.append(replace(spectra, power=power, event_id=names, time_unix=spectra.time_unix + k * SIDEREAL_YEAR_S))
        gains[k] = level[k] + season.mean()
    return drawn, gains


def bound_error(scene: Scene, years: int, scatter: float, rng: np.random.Generator) -> Floats:
    """The Fisher bound on ln C of the first year, shape (freq,), for one who knows all scatter.

    Unknown are ln A of each channel, the noise constants and, if there is a scatter, the gain of each year.
    """
    channels, (n_lna, n_rcu, n_adc) = scene.slope.size, scene.noise
    inverse = np.linalg.inv(RADIOMETER**2 * np.eye(channels) + OF_EVENT**2)
    information = np.zeros((channels + 3 + years, channels + 3 + years))
    for k in range(years):
        _, sky = scene.draw(rng)
        for sky_of_event, power in zip(sky[:EVENTS], scene.mean_power(sky[:EVENTS]), strict=True):
            signal = scene.slope * (sky_of_event + n_lna) / power
            of_noise = [scene.slope * n_lna, n_rcu * scene.instrument.receiver_gain, np.full(channels, n_adc)]
            of_years = np.zeros((channels, years))
            of_years[:, k] = signal
            jacobian = np.column_stack([np.diag(signal), *(one / power for one in of_noise), of_years])
            information += jacobian.T @ inverse @ jacobian
    at = channels + 3 + np.arange(years)
    information[at, at] += max(scatter, 1e-6) ** -2.0
    covariance = np.linalg.inv(information)
    to_first = np.concatenate([np.eye(channels), np.zeros((channels, 3 + years))], axis=1)
    to_first[:, channels + 3] = 1.0
    return np.sqrt(np.diag(to_first @ covariance @ to_first.T)) / 2.0


def fit_steady(seed: int) -> Row:
    """Pulls of C of the first and the last year, their difference, and errors over the oracle's."""
    rng = np.random.default_rng([20_261_125, seed])
    scene, years, scatter = published_noise_scene(), YEARS[seed % 2], SCATTERS[seed // 2 % 3]
    drawn, gains = draw_years(scene, years, scatter, rng)
    simulation = Simulation(scene.instrument, scene.sky_power)
    kept = [fit_calibration(one, simulation).lines for one in drawn]
    curves = list[CalibrationCurve]()
    for k in (0, years - 1):
        beside = [Beside(lines, np.ones(1, dtype=bool)) for j in range(years) if j != k for lines in kept[j]]
        curves += fit_calibration(drawn[k], simulation, "antenna", beside).curves
    row: Row = {"years": years, "scatter": scatter, "status": [curve.status for curve in curves]}
    found = [(one.c, one.c_sigma_stat) for one in curves if one.c is not None and one.c_sigma_stat is not None]
    if len(found) < len(curves):
        return row
    at = np.isin(scene.instrument.frequency_mhz, AT_MHZ)
    off = [np.log(c / scene.true_c()) + 0.5 * gain for (c, _), gain in zip(found, gains[[0, -1]], strict=True)]
    sigma = [error / c for c, error in found]
    # the mean gain of a year, the season of its events in it, is known to the scatter of their own gains
    of_gain = 0.5 * ((PATH_GAIN**2 + COMMON_GAIN**2) * 2.0 / EVENTS) ** 0.5
    middle = np.abs(scene.instrument.frequency_mhz - 55.0) <= MIDDLE_MHZ
    bound = bound_error(scene, years, scatter, rng)
    return row | {
        "windows": [0 if one.repeated is None else one.repeated.windows for one in curves],
        "chi2_per_dof": [0.0 if one.repeated is None else round(one.repeated.chi2_per_dof, 4) for one in curves],
        "pull": np.round((off[0] / sigma[0])[at], 4).tolist(),
        "difference": round(float(np.mean((off[1] - off[0])[middle])), 6),
        "of_gain": round(float(of_gain), 6),
        "over_oracle": np.round((sigma[0] / bound)[at], 4).tolist(),
    }


def judge(rows: Sequence[Row]) -> list[Found]:
    good = [row for row in rows if "pull" in row]
    pull, over = (np.array([row[name] for row in good]) for name in ("pull", "over_oracle"))
    n, within = len(good), sum(abs(row["difference"]) < 2.0 * row["of_gain"] for row in good)
    joined = sum(min(row["windows"]) == row["years"] for row in good)
    return [
        rate_of("fitted", n, len(rows)),
        rate_of("joined", joined, n),
        worst_of([spread_of("pulls", float(np.sqrt(np.mean(p**2))), n) for p in pull.T], n),
        worst_of([mean_of("oracle", p) for p in over.T], n),
        rate_of("differences", within, n),
    ]


PARTS = (Part("steady", fit_steady, judge, 240),)
