"""Figures 1 to 6: the chain, its parts, the LST variation, the noise terms and C(nu), each with ours beside it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lbacal_core.antenna.lofar import ResonanceCircuit
from lbacal_core.antenna.model import zenith_gain
from lbacal_core.antenna.names import load_antenna
from lbacal_core.calibration.antenna_noise import noise_at_input
from lbacal_core.data.lofar import DIPOLES
from lbacal_core.data.tables import read_table
from lbacal_core.grids import Floats
from lbacal_core.lstcurve.curve import AS_RECORDED, BAND_MHZ, band_weights, in_db, simulate_band_power
from lbacal_paper.budget import Budget
from lbacal_paper.chain_results import mean_loss, published_correction
from lbacal_paper.figures import BAND, BOXES, OTHER, POINTS, PUBLISHED, Panel, PaperFigure, Series
from lbacal_paper.noise_results import FULL_DAY
from lbacal_paper.shower_study import calibrate_with_stand_in
from lbacal_paper.study import EXCHANGE, Study

FREQUENCY = "frequency (MHz)"
WIPL_D = "antenna/lba_vout.npz"
PUBLISHED_SYSTEMATIC = 0.13
"""Table 1: total below 77 MHz, of C."""
MICRO = 1e6


def make_chain_figures(study: Study, budget: Budget, data: Path | None) -> list[PaperFigure]:
    """Figures 1 to 6."""
    return [
        _draw_chain(study),
        _draw_parts(study, data),
        _draw_pass_band(study),
        _draw_variation(study),
        _draw_noise(study),
        _draw_calibration(study, budget),
    ]


def _draw_chain(study: Study) -> PaperFigure:
    frequency, instrument = study.frequency_mhz, study.instrument
    curve = study.mean_curve("X")
    terms = noise_at_input(curve, instrument)
    sky = study.sky_power.power["X"].mean(axis=0)
    loss = mean_loss(instrument)
    slope = instrument.antenna_gain / np.asarray(curve.c) ** 2
    behind_antenna = (sky + terms["lna"]) * slope / (loss * instrument.receiver_gain)
    behind_cable = behind_antenna * loss
    recorded = (sky + sum(terms.values())) * slope
    reference = float(np.median(recorded))
    stages = {
        "1 behind the active antenna": behind_antenna,
        "2 behind the cable": behind_cable,
        "3 recorded": recorded,
    }
    boxes = ["sky + N_LNA", "antenna G_ant A", "cable L_coax", "+ N_RCU", "receiver G_RCU S", "+ N_ADC", "recorded"]
    schematic = [Series(name, np.array([float(k)]), np.zeros(1), kind=BOXES) for k, name in enumerate(boxes)]
    levels = [
        Series(name, frequency, 10.0 * np.log10(values / reference), group=name) for name, values in stages.items()
    ]
    return PaperFigure(
        1,
        "The signal chain",
        "The chain of eq. full_chain, and the power at its three points for the mean X path of a simulated "
        "Superterp-year, in dB over the median recorded power (S behind point 1 in the same unit). The paper draws "
        "the schematic only.",
        [Panel("", "", schematic), Panel(FREQUENCY, "power (dB)", levels)],
    )


def _draw_parts(study: Study, data: Path | None) -> PaperFigure:
    frequency, instrument = study.frequency_mhz, study.instrument
    gain = instrument.antenna_gain
    models = [
        Series("published", frequency, gain / gain.max(), origin=PUBLISHED, group="published"),
        Series("circuit, ours", frequency, _relative(ResonanceCircuit().gain(frequency)), group="ours"),
        Series("published, with A", frequency, _relative(gain * published_correction(study)), origin=OTHER, group="A"),
    ]
    if data is not None and (data / WIPL_D).is_file():
        table = zenith_gain(load_antenna(str(data / WIPL_D)), frequency)
        models.append(Series("WIPL-D table", frequency, _relative(table), origin=OTHER, group="table"))
    cables = [
        Series(f"{name} m", frequency, 10.0 * np.log10(loss), origin=PUBLISHED, group=name)
        for name, loss in instrument.cables.items()
    ]
    per_metre = np.mean([10.0 * np.log10(loss) / float(name) for name, loss in instrument.cables.items()], axis=0)
    cables.append(Series("100 m, from the three", frequency, 100.0 * per_metre, group="ours"))
    cables.append(Series("mean path, ours", frequency, 10.0 * np.log10(mean_loss(instrument)), group="mean"))
    return PaperFigure(
        2,
        "Antenna gain and cable loss",
        "Left: G_ant over its maximum, the published one from C and N_ADC; 'with A' is what the published C makes of "
        "it. Right: power gain of the cables "
        "on record, and of the mean path of the Superterp, which is what one calibration for all antennas stands for.",
        [Panel(FREQUENCY, "G_ant / maximum", models), Panel(FREQUENCY, "gain (dB)", cables)],
    )


def _relative(gain: Floats) -> Floats:
    return np.asarray(gain / gain.max())


def _draw_pass_band(study: Study) -> PaperFigure:
    frequency = study.frequency_mhz
    level = 10.0 * np.log10(study.instrument.receiver_gain)
    plateau = level[(frequency >= 40) & (frequency <= 60)].mean()
    a = 10.0 * np.log10(published_correction(study))
    series = [
        Series("pass band, mean of units", frequency, level, origin=PUBLISHED, group="published"),
        Series(
            "3 dB below the mean of 40-60 MHz",
            frequency,
            np.full_like(frequency, plateau - 3.0),
            origin=OTHER,
            group="3 dB",
        ),
        Series("A from the published C", frequency, a, group="A"),
    ]
    return PaperFigure(
        3,
        "Receiver pass band",
        "The published mean pass band and the level 3 dB below its plateau; the line marks the published edge. The "
        "published spread of units is not public. A(nu) rises where the pass band falls: the published C follows "
        "only a part of its fall.",
        [Panel(FREQUENCY, "power gain (dB)", series, vertical=(78.0,))],
    )


def _draw_variation(study: Study) -> PaperFigure:
    weights = band_weights(study.instrument, AS_RECORDED, BAND_MHZ)
    panels = []
    for has_noise, title in ((False, "sky alone"), (True, "sky and electronic noise")):
        series = []
        for dipole in DIPOLES:
            fit = study.exchanged.of(dipole, has_noise=has_noise)
            curve = study.exchanged.curve
            at = curve.has_point(dipole)
            points = curve.variation_db[dipole][at]
            name = f"measured, named {EXCHANGE[dipole]}"
            low, high = points - curve.error_db[at], points + curve.error_db[at]
            series.append(Series(name, curve.lst_hours[at], points, low, high, POINTS, PUBLISHED, group=dipole))
            relative = simulate_band_power(study.sky_power, dipole, FULL_DAY, weights)
            line = in_db(relative, fit.noise_share) + fit.offset_db
            label = f"our {dipole}" + (f", noise {fit.noise_share:.2f}" if has_noise else "")
            series.append(Series(label, FULL_DAY, line, group=dipole))
        panels.append(Panel("local sidereal time (h)", "band power (dB, LST 0)", series, title))
    return PaperFigure(
        4,
        "LST variation of the band power",
        "The published measured variation and our simulation of the arm NE-SW (X) and NW-SE (Y). The measured "
        "letters are exchanged against the arms (docs/decisions/dipole-letters.md). Fitted: offset, and right the "
        "noise share.",
        panels,
    )


def _draw_noise(study: Study) -> PaperFigure:
    frequency, table = study.frequency_mhz, read_table("noise_terms")
    curve = study.mean_curve("X")
    sky = study.sky_power.power["X"].mean(axis=0)
    factor = float(np.exp(np.mean(np.log(sky / np.interp(frequency, table["mhz"], table["sky"])))))
    ours = {"sky": sky, **noise_at_input(curve, study.instrument)}
    ours["all noise"] = ours["lna"] + ours["rcu"] + ours["adc"]
    published = {name: table[name] for name in ("sky", "lna", "rcu", "adc")}
    published["all noise"] = published["lna"] + published["rcu"] + published["adc"]
    words = {"lna": "N_LNA", "rcu": "N_RCU", "adc": "N_ADC"}
    series = []
    for name, values in ours.items():
        label = words.get(name, name)
        series.append(Series(f"{label}, ours", frequency, values, group=label))
        other = factor * published[name]
        series.append(Series(f"{label}, published", table["mhz"], other, origin=PUBLISHED, group=label))
    return PaperFigure(
        5,
        "Noise at the start of the chain",
        "Noise terms referred to the start of the chain. Ours: the fit of a simulated Superterp-year whose noise "
        "constants are drawn within 5 % of the published ones, mean X path. Published terms times one factor, that "
        "of the two sky powers.",
        [Panel(FREQUENCY, "power (W m$^{-2}$ MHz$^{-1}$)", series, is_log=True)],
    )


def _draw_calibration(study: Study, budget: Budget) -> PaperFigure:
    frequency, published = study.frequency_mhz, MICRO * study.published_c()
    upper = [
        _band("published, 13 %", frequency, published, PUBLISHED_SYSTEMATIC, PUBLISHED),
        Series("published", frequency, published, origin=PUBLISHED, group="published"),
    ]
    upper += [
        Series(f"source, {one.name}", frequency, MICRO * one.c, origin=OTHER, group=one.name)
        for one in calibrate_with_stand_in(study)
    ]
    lower = []
    for dipole in DIPOLES:
        curve = study.mean_curve(dipole)
        c, sigma = MICRO * np.asarray(curve.c), MICRO * np.asarray(curve.c_sigma_stat)
        planted = MICRO * study.campaign.truth.curve(dipole)
        if dipole == DIPOLES[0]:
            upper.append(_band("ours, systematic", frequency, c, budget.total(dipole), "ours", dipole))
        upper.append(Series(f"ours, {dipole}, statistical", frequency, c, c - sigma, c + sigma, group=dipole))
        ratio, error = 100 * (c / planted - 1.0), 100 * sigma / planted
        lower.append(
            Series(f"{dipole}, fitted over planted", frequency, ratio, ratio - error, ratio + error, group=dipole)
        )
    return PaperFigure(
        6,
        "Calibration factor",
        "C(nu) of the mean path. Ours is the fit of a simulated Superterp-year whose chain is drawn about the "
        "published curve with 3 % of smooth departures: it shows what the method recovers (right), not a new "
        "measurement. Systematic bands: Table 1 of the paper, and our refits. The two reference source calibrations "
        "of the paper are not public; dotted are those with a stand-in.",
        [
            Panel(FREQUENCY, "C (µV per ADC unit)", upper),
            Panel(FREQUENCY, "error of the fit (%)", lower),
        ],
    )


def _band(name: str, x: Floats, y: Floats, relative: Floats | float, origin: str, group: str = "published") -> Series:
    half = y * relative
    return Series(name, x, y, y - half, y + half, BAND, origin, group)
