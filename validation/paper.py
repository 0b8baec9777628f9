"""What is done with a fitted C: slopes of pulses (section 5.1), calibrated traces, and the noise of an antenna.

A campaign of the twin is fitted, with its budget. Systematic errors are drawn from that budget, pulses and traces are
recorded with the planted C, and the stated errors are counted. A campaign is one draw: errors of C are almost fully
correlated along frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.interpolate import PchipInterpolator

from lbacal_core.antenna.names import load_antenna
from lbacal_core.calibration.budget import compute_budget, electronics_sigma
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.curves.covariance import Budget
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.data.lofar import DIPOLES
from lbacal_core.grids import Floats
from lbacal_core.instrument.matching import RESISTANCE_OHM
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.traces.noise import draw_noise
from lbacal_core.traces.voltage import calibrate_trace
from lbacal_paper.reference_source import HEIGHT_M, LABORATORY_M, LEFT_OF_FLOOR, floor_factor, near_field_factor
from lbacal_paper.showers.comparison import Displacement, compare_calibrations
from lbacal_paper.showers.recording import record
from lbacal_paper.showers.signals import SIGNALS, draw_signals
from lbacal_twin.campaign import Campaign, simulate_campaign
from lbacal_twin.settings import TwinSettings
from validation.machinery.claims import Found, count_within, coverage, mean_of, rate_of
from validation.machinery.parts import Part, Row
from validation.superterp import power_of, superterp

RATE_MHZ, SAMPLES = 200.0, 4096
SETTINGS = TwinSettings(stations=("CS002",), antennas=6, events_per_year=600)
OFF_SIGMA = 5.0
SIGNALS_OF_STEPS = 200


@dataclass(frozen=True)
class _Fitted:
    """A campaign, its budget, and the systematic error of ln C that was drawn from it, by polarisation.

    Errors of G_ant are left out: C and H have the same one, so that it is none of a field.
    """

    campaign: Campaign
    curves: Sequence[CalibrationCurve]
    budget: Budget
    drawn: dict[str, Floats]


@cache
def _known_budget() -> Budget:
    """The budget of one campaign, which stands for all: its refits are of the same instrument and sky."""
    instrument, sky_power = superterp(), power_of()
    campaign = simulate_campaign(SETTINGS, instrument, sky_power, np.random.default_rng(3))
    budget = compute_budget(campaign.spectra, Simulation(instrument, sky_power))
    return replace(budget, terms=[term for term in budget.terms if not term.is_of_gain])


def _fit_campaign(rng: np.random.Generator, scope: str) -> _Fitted:
    instrument, sky_power = superterp(), power_of()
    campaign = simulate_campaign(SETTINGS, instrument, sky_power, rng)
    report = fit_calibration(campaign.spectra, Simulation(instrument, sky_power), scope)
    budget = _known_budget()
    drawn = {dipole: np.zeros_like(instrument.frequency_mhz) for dipole in DIPOLES}
    for term in budget.terms:
        sizes = rng.standard_normal(term.vectors[DIPOLES[0]].shape[0])
        for dipole in DIPOLES:
            drawn[dipole] = drawn[dipole] + sizes @ term.vectors[dipole]
    curves = [
        replace(curve, covariance=replace(curve.covariance, budget=budget.digest))
        for curve in report.curves
        if curve.covariance is not None and np.all(curve.has_value)
    ]
    return _Fitted(campaign, curves, budget, drawn)


@cache
def _known_fit() -> _Fitted:
    """The mean path of one campaign, whose covariance and budget stand for all."""
    return _fit_campaign(np.random.default_rng(3), "array")


def calibrate_pulses(seed: int) -> Row:
    """Slopes of 1653 signals of 20 events with the right C, one with statistical errors, and one with all its errors.

    What one standard deviation of each error does to the slopes is found with fewer signals of the same kind: they move
    together.
    """
    rng = np.random.default_rng([3, seed])
    instrument, sky_power = superterp(), power_of()
    channels, fitted = instrument.frequency_mhz, _known_fit()
    by = {str(curve.dipole): curve for curve in fitted.curves}
    c = np.array([by[dipole].c for dipole in DIPOLES])
    vectors = [v for term in fitted.budget.terms for v in np.stack([term.vectors[d] for d in DIPOLES], axis=1)]
    statistical = [np.where(np.array(DIPOLES)[:, None] == d, v, 0.0) for d in DIPOLES for v in _factor(by[d])]
    stat, sys = (np.einsum("k,kdf->df", rng.standard_normal(len(v)), np.array(v)) for v in (statistical, vectors))
    background = np.array([Simulation(instrument, sky_power).background(by[d], np.zeros(1))[0] for d in DIPOLES])
    few, recording = (
        record(draw_signals(rng, signals=n), instrument, load_antenna("hamaker"), c, background, rng)
        for n in (SIGNALS_OF_STEPS, SIGNALS)
    )
    source = near_field_factor(channels, LABORATORY_M) * floor_factor(
        channels, LABORATORY_M, HEIGHT_M, HEIGHT_M, -LEFT_OF_FLOOR
    )
    moved = compare_calibrations(
        recording, channels, {"right": c, "fit": c * np.exp(stat), "all": c * np.exp(stat + sys), "source": c * source}
    )
    every = [*statistical, *vectors]
    single = compare_calibrations(few, channels, {"right": c} | {str(k): c * np.exp(v) for k, v in enumerate(every)})
    steps = [single[str(k)].difference - single["right"].difference for k in range(len(every))]
    of_fit, of_all = np.sum(np.square(steps[: len(statistical)])), np.sum(np.square(steps))

    def pull(one: Displacement, more: float = 0.0) -> Floats:
        return np.array(one.difference / np.hypot(one.difference_sigma, np.sqrt(more)))

    return {
        "difference": {name: round(one.difference, 4) for name, one in moved.items()},
        "sigma": [round(float(one), 4) for one in (moved["right"].difference_sigma, of_fit**0.5, of_all**0.5)],
        **count_within("right", pull(moved["right"])),
        **count_within("fit", pull(moved["fit"], of_fit)),
        **count_within("all", pull(moved["all"], of_all)),
        "is_source_off": bool(abs(moved["source"].significance) > OFF_SIGMA),
    }


def _factor(curve: CalibrationCurve) -> Floats:
    return np.zeros((0, curve.frequency_mhz.size)) if curve.covariance is None else curve.covariance.factor


def judge_pulses(rows: Sequence[Row]) -> list[Found]:
    within = [figure for name in ("right", "fit", "all") for figure in coverage(rows, name)]
    return [*within, rate_of("source", sum(row["is_source_off"] for row in rows), len(rows))]


def calibrate_traces(seed: int) -> Row:
    """Pulses of known energy, recorded by paths of known C, calibrated with the C fitted to their background."""
    rng = np.random.default_rng([4, seed])
    fitted = _fit_campaign(rng, "antenna")
    channels = superterp().frequency_mhz
    bins = np.fft.rfftfreq(SAMPLES, 1 / RATE_MHZ)
    inside = (bins >= channels[0]) & (bins <= channels[-1])
    pull, total, alike = [], [], []
    for curve in fitted.curves:
        dipole = str(curve.dipole)
        pulse = np.where(inside, np.exp(-rng.uniform(0, 0.05) * (bins - 55.0) - 2j * np.pi * bins * 7.0), 0)
        noise = np.where(inside, rng.normal(size=bins.size) + 1j * rng.normal(size=bins.size), 0)
        voltage = pulse + 0.05 * noise
        c = np.exp(PchipInterpolator(channels, np.log(fitted.campaign.truth.curve(dipole, "CS002", curve.antenna)))(
            np.clip(bins, channels[0], channels[-1])))  # fmt: skip
        samples = np.fft.irfft(voltage / c, SAMPLES)
        energy = np.sum(np.abs(voltage) ** 2)
        alone = calibrate_trace(samples, RATE_MHZ, replace(curve, c_sigma_sys=None))
        pull.append((np.sum(np.abs(alone.spectrum) ** 2) / energy - 1.0) / alone.sigma_of_energy())
        off = np.exp(fitted.drawn[dipole])
        moved = replace(curve, c=np.asarray(curve.c) * off, c_sigma_stat=np.asarray(curve.c_sigma_stat) * off)
        whole = calibrate_trace(samples, RATE_MHZ, moved, fitted.budget)
        total.append(0.5 * np.log(np.sum(np.abs(whole.spectrum) ** 2) / energy) / (0.5 * whole.sigma_of_energy()))
        alike.append(np.median(np.abs(alone.c[inside] / c[inside] - 1.0)))
    return {
        "paths": len(pull),
        **count_within("energy", np.array(pull)),
        **count_within("total", np.array(total)),
        "error": float(np.median(alike)),
    }


def judge_traces(rows: Sequence[Row]) -> list[Found]:
    return coverage(rows, "energy") + coverage(rows, "total")


def predict_noise(seed: int) -> Row:
    """The background and electronics of fitted chains against the planted ones, and realisations of it."""
    rng = np.random.default_rng([5, seed])
    instrument, sky_power = superterp(), power_of()
    campaign = simulate_campaign(SETTINGS, instrument, sky_power, rng)
    simulation = Simulation(instrument, sky_power)
    curves = fit_calibration(campaign.spectra, simulation, "antenna").curves
    (planted,) = campaign.truth.stations
    lst = rng.uniform(0, 24, 4)
    pull, off = [], []
    for curve in (curve for curve in curves if curve.c is not None and np.all(curve.has_value)):
        dipole = str(curve.dipole)
        slope = instrument.antenna_gain / campaign.truth.curve(dipole, "CS002", curve.antenna) ** 2
        electronics = slope * planted.n_lna + planted.n_rcu * instrument.receiver_gain + planted.n_adc
        sigma = electronics_sigma(curve, simulation)
        pull.append((simulation.electronics(curve) - electronics) / sigma)
        whole = slope * sky_power.at(dipole, lst) + electronics
        off.append(simulation.background(curve, lst) / whole - 1.0)
    drawn = draw_noise(instrument.frequency_mhz, np.tile(whole[0], (40, 1)), SAMPLES, RATE_MHZ, rng)
    expected = whole[0].sum() * RESISTANCE_OHM
    channel = int(rng.integers(1, whole.shape[1] - 1))
    power = np.abs(np.fft.rfft(drawn, axis=1)) ** 2 * 2 / (SAMPLES * RATE_MHZ) / RESISTANCE_OHM
    near = np.abs(np.fft.rfftfreq(SAMPLES, 1 / RATE_MHZ) - instrument.frequency_mhz[channel]) < 0.1
    return {
        **count_within("electronics", np.array(pull)),
        "background": float(np.median(np.abs(off))),
        "mean_square": float(np.mean(drawn**2) / expected),
        "density": float(power[:, near].mean() / whole[0][channel]),
        "kurtosis": float(np.mean(drawn**4) / np.mean(drawn**2) ** 2),
    }


def judge_noise(rows: Sequence[Row]) -> list[Found]:

    def of(name: str) -> Floats:
        return np.array([row[name] for row in rows])

    moments = [mean_of(name, of(name)) for name in ("mean_square", "density", "kurtosis")]
    return [*coverage(rows, "electronics"), mean_of("background", of("background"), "%"), *moments]


PARTS = (
    Part("slopes", calibrate_pulses, judge_pulses, 600),
    Part("traces", calibrate_traces, judge_traces, 600, headlines=("total_2",)),
    Part("noise", predict_noise, judge_noise, 400),
)
