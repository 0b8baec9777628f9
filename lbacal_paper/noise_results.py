"""Section 4.1: the LST variation of the band power, and where the sky exceeds the electronic noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lbacal_core.calibration.antenna_noise import noise_at_input
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.calibration.lines import fit_lines
from lbacal_core.data.lofar import DIPOLES
from lbacal_core.data.tables import read_table
from lbacal_core.discovery.curve_fit import GRID_HOURS, CurveFitter, gather_curve, list_choices
from lbacal_core.grids import Floats
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.lstcurve.curve import (
    AS_RECORDED,
    BAND_MHZ,
    Comparison,
    LstCurve,
    band_weights,
    estimate_noise,
    in_db,
    noise_prior,
    simulate_band_power,
)
from lbacal_core.sky.names import DEFAULT_SKY, list_skies
from lbacal_core.skypower.differences import FULL_MAPS, model_difference_modes
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra.blocks import split_into_blocks
from lbacal_paper.budget import has_every_channel
from lbacal_paper.statements import Result, not_testable
from lbacal_paper.study import STATION, Study

FULL_DAY = np.linspace(0.0, 24.0, 289)
CROSSING_SIGMA_MHZ = 0.5
"""What noise constants drawn within 5 % at six stations move the crossings by: 2 % of noise, 0.06 in ln a MHz."""


def find_about_noise(study: Study) -> dict[str, Result]:
    """Results on the electronic noise."""
    share, sigma = find_noise_share(study, study.curve, is_exchanged=True)
    informed, sigma_informed = find_noise_share(study, study.curve, is_exchanged=True, is_published_known=True)
    chi2 = {name: _chi2(one) for name, one in (("exchanged", study.exchanged), ("as named", study.comparison))}
    return {
        "swing-without-noise": _swing(study),
        "swing-with-noise": Result(
            chi2["exchanged"][0] / chi2["exchanged"][1],
            0.0,
            "chi2 of the measured curve (91 points, drawn bars), letters X and Y exchanged "
            f"(docs/decisions/dipole-letters.md): {chi2['exchanged'][0]:.0f} with our sky alone, "
            f"{chi2['exchanged'][1]:.0f} with a noise share for each dipole; letters as named "
            f"{chi2['as named'][0]:.0f} and {chi2['as named'][1]:.0f}",
        ),
        "noise-share": Result(
            share,
            sigma,
            "fit of the measured LST curve with our sky, letters exchanged, the spread of sky and antenna models in "
            f"its covariance, nothing known of the noise. With what is published of it as prior {informed:.3f} +- "
            f"{sigma_informed:.3f}, which is the n = {informed / (1 - informed):.2f} of the sky of "
            "docs/explanation/what-the-simulation-gets-wrong.md",
        ),
        **_crossings(study),
        "noise-without-chain": _gain_by_chain(study),
    }


def _chi2(comparison: Comparison) -> tuple[float, float]:
    without, with_noise = (
        sum(comparison.of(dipole, has_noise=has_noise).chi2 for dipole in DIPOLES) for has_noise in (False, True)
    )
    return without, with_noise


def _swing(study: Study) -> Result:
    weights = band_weights(study.instrument, AS_RECORDED, BAND_MHZ)
    ratio, sigma, words = [], [], []
    curve = study.exchanged.curve
    noise = estimate_noise(curve)
    for dipole in DIPOLES:
        measured = smooth_swing(curve, dipole)
        simulated = float(np.ptp(in_db(simulate_band_power(study.sky_power, dipole, FULL_DAY, weights), 0.0)))
        ratio.append(simulated / measured)
        sigma.append(simulated / measured**2 * noise.sigma_db[dipole])
        words.append(f"{dipole} {simulated:.2f} against {measured:.2f} dB")
    return Result(
        float(np.mean(ratio)),
        float(np.mean(sigma)),
        "largest minus smallest band power, our sky alone against the measured curve, letters exchanged: "
        f"{', '.join(words)}; mean of the two ratios",
    )


def smooth_swing(curve: LstCurve, dipole: str, harmonics: int = 4) -> float:
    """Largest minus smallest value of the Fourier series through the measured points, dB."""
    has_point = curve.has_point(dipole)
    basis = [_harmonics(hours, harmonics) for hours in (curve.lst_hours[has_point], FULL_DAY)]
    fitted = np.linalg.lstsq(basis[0], curve.variation_db[dipole][has_point], rcond=None)[0]
    return float(np.ptp(basis[1] @ fitted))


def _harmonics(hours: Floats, harmonics: int) -> Floats:
    angle = 2 * np.pi / 24.0 * np.outer(hours, np.arange(1, harmonics + 1))
    return np.concatenate([np.ones((hours.size, 1)), np.cos(angle), np.sin(angle)], axis=1)


def find_noise_share(
    study: Study, curve: LstCurve, *, is_exchanged: bool, is_published_known: bool = False
) -> tuple[float, float]:
    """Electronic noise over the total band power, and its error, as `lbacal investigate --lst-curve` fits it.

    Parameters
    ----------
    is_exchanged
        Whether the letters of the curve are exchanged.
    is_published_known
        Whether what is published of the noise is a prior of the fit; it is when a curve is investigated.
    """
    weights = band_weights(study.instrument, AS_RECORDED, BAND_MHZ)
    prior = noise_prior(study.instrument, BAND_MHZ, weights)
    prior = prior if is_published_known else replace(prior, sigma=np.inf)
    station = gather_curve(study.instrument, study.sky_power, weights, prior)
    modes = model_difference_modes(study.instrument, GRID_HOURS, FULL_MAPS)
    exchange = [one for one in list_choices(station) if one.is_statement] if is_exchanged else []
    fitted = CurveFitter(curve, station, estimate_noise(curve), modes).fit(exchange)
    over_total = 1.0 + fitted.noise
    return fitted.noise / over_total, fitted.noise_sigma / over_total**2


def sky_over_noise(study: Study, dipole: str) -> Floats:
    """Sky averaged over LST over the sum of the fitted noise terms, shape (freq,)."""
    terms = noise_at_input(study.mean_curve(dipole), study.instrument)
    return np.asarray(study.sky_power.power[dipole].mean(axis=0) / sum(terms.values()))


def crossings(frequency_mhz: Floats, ratio: Floats) -> tuple[float, float]:
    """The lowest and the highest frequency at which a ratio that peaks inside the band passes 1."""
    above = np.flatnonzero(ratio > 1.0)
    low, high = above[0], above[-1]
    log = np.log(ratio)
    return (
        float(np.interp(0.0, log[low - 1 : low + 1], frequency_mhz[low - 1 : low + 1])),
        float(np.interp(0.0, -log[high : high + 2], frequency_mhz[high : high + 2])),
    )


def _crossings(study: Study) -> dict[str, Result]:
    ratios = {dipole: sky_over_noise(study, dipole) for dipole in DIPOLES}
    found = np.array([crossings(study.frequency_mhz, ratio) for ratio in ratios.values()])
    table = read_table("noise_terms")
    drawn = crossings(table["mhz"], table["sky"] / (table["lna"] + table["rcu"] + table["adc"]))
    mean, half = found.mean(axis=0), np.abs(np.diff(found, axis=0))[0] / 2
    how = (
        "fit of a simulated Superterp-year whose noise constants are drawn within 5 % of the published ones: it "
        "tests that the "
        "fit separates the terms, not their level. X {:.1f}, Y {:.1f} MHz; the published figure itself crosses at "
        "{:.1f} MHz"
    )
    edges = {name: 1.0 / np.mean([ratio[k] for ratio in ratios.values()]) for name, k in (("low", 0), ("high", -1))}
    return {
        "sky-dominates-from": Result(
            mean[0], float(np.hypot(half[0], CROSSING_SIGMA_MHZ)), how.format(*found[:, 0], drawn[0]), True
        ),
        "sky-dominates-to": Result(
            mean[1], float(np.hypot(half[1], CROSSING_SIGMA_MHZ)), how.format(*found[:, 1], drawn[1]), True
        ),
        "noise-at-low-edge": Result(
            float(edges["low"]), 0.0, "sum of the fitted noise terms over the sky at 30 MHz; same fit", True
        ),
        "noise-at-high-edge": Result(
            float(edges["high"]), 0.0, "sum of the fitted noise terms over the sky at 80 MHz; same fit", True
        ),
    }


def _gain_by_chain(study: Study) -> Result:
    """What the chain's three noise constants change: the statistical error of C, and its change with the sky model."""
    spectra = study.campaign.spectra
    station = spectra.select(np.flatnonzero(spectra.station == STATION))
    block = split_into_blocks(station)[0]
    lst_hours = local_sidereal_time(block.time_unix, study.instrument.longitude_deg)
    relative_variance = np.where(block.is_present, 1.0, np.inf)
    channels = study.frequency_mhz.size

    def fit_both(power: SkyPower) -> tuple[Floats, Floats]:
        """The slope of each channel alone, mean over the antennas of its logarithm, and ln C with the chain."""
        lines = fit_lines(block.power, power.at(block.dipole, lst_hours), relative_variance)
        curves = fit_calibration(station, study.instrument, power, "station").curves
        (curve,) = [one for one in curves if one.dipole == block.dipole]
        return np.log(np.median(lines.slope, axis=0)), np.log(np.asarray(curve.c))

    own = fit_lines(block.power, study.sky_power.at(block.dipole, lst_hours), relative_variance)
    variance = np.einsum("pii->pi", np.linalg.inv(own.information))[:, :channels]
    alone = float(np.median(0.5 * np.sqrt(variance) / own.slope))
    tied = [
        np.median(np.asarray(curve.c_sigma_stat) / np.asarray(curve.c))
        for curve in study.paths.curves
        if has_every_channel(curve) and (curve.station, curve.dipole) == (block.station, block.dipole)
    ]
    slope, log_c = fit_both(study.sky_power)
    changes = []
    for name in list_skies():
        if name != DEFAULT_SKY:
            other_slope, other_c = fit_both(compute_sky_power(study.instrument, name))
            changes.append((-0.5 * (other_slope - slope), other_c - log_c))
    moved = np.sqrt(np.mean(np.square(changes), axis=(0, 2)))
    return not_testable(
        "needs the fit of Nelles et al. 2015, whose noise had an uncertainty of 37 %. On a simulated station-year "
        f"the chain's three noise constants bring sigma(C) of an antenna from {100 * alone:.1f} % (a free intercept "
        f"in each channel) to {100 * np.median(tied):.1f} %; but exchanging the sky model ({len(changes)} models) "
        f"moves C by {100 * moved[1]:.0f} % r.m.s. with the chain and by {100 * moved[0]:.0f} % without: the tie "
        "makes C sensitive to the level of the sky"
    )
