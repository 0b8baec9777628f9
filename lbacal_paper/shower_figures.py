"""Figures 7 to 9: slopes of signals, calibrations in ratio, and the field of the reference source."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lbacal_core.data.lofar import DIPOLES
from lbacal_core.grids import Floats
from lbacal_core.traces.voltage import relative_errors
from lbacal_paper.budget import MEASURED, TIED, Budget
from lbacal_paper.figures import BAND, OTHER, OURS, POINTS, Panel, PaperFigure, Series
from lbacal_paper.reference_source import add_disagreement, compare_with_source
from lbacal_paper.shower_study import FITTED, ShowerStudy
from lbacal_paper.showers.comparison import MILLI, true_slopes
from lbacal_paper.showers.recording import field_power, true_power
from lbacal_paper.showers.slopes import HIGH_MHZ, LOW_MHZ
from lbacal_paper.stand_in_source import CELL, CHAMBER, stand_in_tables, true_field
from lbacal_paper.study import Study

FREQUENCY = "frequency (MHz)"
SHOWN = (FITTED, CHAMBER, CELL, "+1 sigma: antenna")


def make_shower_figures(study: Study, budget: Budget, showers: ShowerStudy) -> list[PaperFigure]:
    """Figures 7 to 9."""
    return [_draw_slopes(study, showers), _draw_ratio(study, budget, showers), _draw_field(study)]


def _draw_slopes(study: Study, showers: ShowerStudy) -> PaperFigure:
    recording = showers.recording
    bins = recording.signals.frequency_mhz
    truth = true_power(recording)
    strength = truth.sum(axis=1)
    example = int(np.argsort(strength)[int(0.9 * strength.size)])
    reference = float(np.median(truth[example]))
    series = [Series("simulated field", bins, np.log10(truth[example] / reference), origin=OTHER, group="truth")]
    for name in SHOWN[:3]:
        power, background = field_power(recording, showers.calibrations[name], study.frequency_mhz)
        seen = power[example] > 0
        values = np.log10(np.where(seen, power[example], 1.0) / reference)
        error = np.sqrt(power[example] * background[example]) / np.maximum(power[example], 1e-300) / np.log(10.0)
        low, high = (values + sign * error for sign in (-1, 1))
        series.append(Series(name, bins[seen], values[seen], low[seen], high[seen], POINTS, group=name))
        slopes = showers.displacements[name].slopes
        for band, slope in ((LOW_MHZ, slopes.low[example]), (HIGH_MHZ, slopes.high[example])):
            inside = seen & (bins >= band[0]) & (bins <= band[1])
            if np.isfinite(slope) and np.any(inside):
                x = bins[inside]
                level = np.median(values[inside] - slope * (x - np.mean(band)))
                series.append(Series(f"_line, {name}", x, level + slope * (x - np.mean(band)), group=name))
    before = true_slopes(recording)
    contours = [
        _contour("simulated field", *before.contour(), OTHER, "truth"),
        *(_contour(name, *showers.displacements[name].slopes.contour(), OURS, name) for name in SHOWN),
    ]
    return PaperFigure(
        7,
        "Slopes of power spectra",
        "Left: one signal. Right: 68 % contours of the slopes below and above the resonance, "
        f"{recording.signals.event.size} signals of {int(recording.signals.event.max()) + 1} events "
        f"({recording.signals.origin}), recorded with the simulated Superterp. The published signals and both "
        "published reference calibrations are not public; the two of the reference source are a stand-in.",
        [
            Panel(FREQUENCY, "log10 power (median of the field = 0)", series),
            Panel("slope 30-58 MHz (10$^{-3}$/MHz)", "slope 62-78 MHz (10$^{-3}$/MHz)", contours, diagonal=True),
        ],
    )


def _contour(name: str, low: Floats, high: Floats, origin: str, group: str) -> Series:
    return Series(name, MILLI * low, MILLI * high, origin=origin, group=group)


def _draw_ratio(study: Study, budget: Budget, showers: ShowerStudy) -> PaperFigure:
    frequency = study.frequency_mhz
    curve = study.mean_curve(DIPOLES[0])
    c = np.asarray(curve.c)
    # G_ant is in both calibrations and cancels
    of_sky = [term for term in budget.today[TIED].terms if not term.is_of_gain]
    factors = [*relative_errors(replace(curve, c_sigma_sys=None)), *(v for t in of_sky for v in t.vectors[DIPOLES[0]])]
    covariance = np.asarray(factors).T @ np.asarray(factors)
    series: list[Series] = []
    words = []
    tied = c * np.exp(budget.terms[MEASURED][DIPOLES[0]])
    for source, other in zip(showers.sources, reversed(showers.sources), strict=True):
        found = compare_with_source(c, covariance, add_disagreement(source, other))
        low, high = found.ratio * np.exp(-found.sigma), found.ratio * np.exp(found.sigma)
        if not series:
            series.append(Series("one standard deviation", frequency, found.ratio, low, high, BAND, group=source.name))
        series.append(Series(f"Galactic fit / {source.name}", frequency, found.ratio, group=source.name))
        if source is showers.sources[-1]:
            name = f"sky measured / {source.name}"
            series.append(Series(name, frequency, tied / source.c, origin=OTHER, group=MEASURED))
        words.append(
            f"{source.name}: trend {1e3 * found.trend:+.1f} +- {1e3 * found.trend_sigma:.1f} per mille a MHz, chi2 "
            f"{found.chi2:.0f} for {frequency.size} channels"
        )
    stated = (
        "Errors: C by the budget with the sky tied to absolute measurements, the stated 18 % of the field, and the "
        "difference of both characterisations in full; the near field is in no stated error"
    )
    return PaperFigure(
        8,
        "Calibrations in ratio",
        "Galactic over reference source calibration of the simulated Superterp, with a stand-in for the source. "
        f"Dotted: the fit with the {MEASURED}. {stated}. {'; '.join(words)}. "
        "The paper's ratio and that of Tunka-Rex are not public as numbers.",
        [Panel(FREQUENCY, "ratio of C", series)],
    )


def _draw_field(study: Study) -> PaperFigure:
    frequency = study.frequency_mhz
    series = [
        Series("stand-in, in free space", frequency, 1e3 * true_field(frequency), origin=OTHER, group="truth"),
        *(Series(one.name, frequency, 1e3 * one.field, group=one.name) for one in stand_in_tables(frequency)),
    ]
    return PaperFigure(
        9,
        "Field of the reference source",
        "Field at 10 m as two laboratories would state it of a stand-in source with a known field: measured at 3 m, "
        "in the near field, scaled with 1/r; in the chamber 15 % of the floor's reflection is left. The published "
        "tables are not public.",
        [Panel(FREQUENCY, "field at 10 m (mV m$^{-1}$ MHz$^{-1/2}$)", series)],
    )
