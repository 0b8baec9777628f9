"""A figure as data: what is drawn and what stands in its CSV file are the same numbers."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from lbacal.pages.chart import COLOURS
from lbacal_core.antenna.lofar import ResonanceCircuit
from lbacal_core.antenna.model import zenith_gain
from lbacal_core.antenna.names import load_antenna
from lbacal_core.data.lofar import DIPOLES
from lbacal_core.data.tables import read_table
from lbacal_core.grids import Floats
from lbacal_core.lstcurve.curve import AS_RECORDED, BAND_MHZ, band_weights, in_db, simulate_band_power
from lbacal_core.simulation.simulation import noise_at_input
from lbacal_core.traces.voltage import relative_errors
from lbacal_paper.budget import MEASURED, TIED, Budget
from lbacal_paper.reference_source import (
    CELL,
    CHAMBER,
    add_disagreement,
    compare_with_source,
    stand_in_tables,
    true_field,
)
from lbacal_paper.results import FULL_DAY, mean_loss, published_correction
from lbacal_paper.shower_study import FITTED, ShowerStudy, calibrate_with_stand_in
from lbacal_paper.showers.comparison import MILLI, true_slopes
from lbacal_paper.showers.recording import field_power, true_power
from lbacal_paper.showers.signals import HIGH_MHZ, LOW_MHZ
from lbacal_paper.study import EXCHANGE, Study

MARKERS = ("o", "s", "^", "D", "v", "P", "X")
"""One for each of `COLOURS`, so that no curve is told by colour alone."""
SETTINGS: Any = {
    "font.size": 8,
    "font.family": "serif",
    "mathtext.fontset": "dejavuserif",
    "axes.linewidth": 0.7,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "xtick.top": True,
    "ytick.right": True,
    "legend.fontsize": 6.5,
    "legend.frameon": False,
    "svg.hashsalt": "lbacal",
    "pdf.fonttype": 42,
}
"""Style of printed figures: readable in grey, and at column width."""
LINE, POINTS, BAND, BOXES = "line", "points", "band", "boxes"
KINDS = (LINE, POINTS, BAND, BOXES)
OURS, PUBLISHED, OTHER = "ours", "published", "other"
ORIGINS = (OURS, PUBLISHED, OTHER)


@dataclass(frozen=True)
class Series:
    """One curve, set of points or band.

    Attributes
    ----------
    name
        As it stands in the legend.
    x, y
        Shape (point,).
    low, high
        Shape (point,): the ends of error bars or of a band; None where there are none.
    kind
        One of `KINDS`.
    origin
        `OURS` was computed here, `PUBLISHED` is a number of the paper, `OTHER` a third thing that `name` states.
    group
        Series of one group share a colour: X with X, one noise term with itself.
    """

    name: str
    x: Floats
    y: Floats
    low: Floats | None = None
    high: Floats | None = None
    kind: str = LINE
    origin: str = OURS
    group: str = ""

    def __post_init__(self) -> None:
        for values in (self.y, self.low, self.high):
            if values is not None and values.shape != self.x.shape:
                raise ValueError(f"series {self.name}: {values.shape} values at {self.x.shape} places")
        if self.kind not in KINDS or self.origin not in ORIGINS:
            raise ValueError(f"series {self.name}: {self.kind}, {self.origin}")


@dataclass(frozen=True)
class Panel:
    """One pair of axes; `notes` are texts at (x, y) in it, `diagonal` draws y = x."""

    x_label: str
    y_label: str
    series: Sequence[Series]
    title: str = ""
    is_log: bool = False
    diagonal: bool = False
    vertical: Sequence[float] = ()
    notes: Sequence[tuple[float, float, str]] = field(default=())


@dataclass(frozen=True)
class PaperFigure:
    """One figure of the paper with ours beside it."""

    number: int
    title: str
    caption: str
    panels: Sequence[Panel]

    def as_csv(self) -> str:
        """Every drawn number: panel, series, origin, x, y, low, high."""
        buffer = io.StringIO()
        for line in (self.title, self.caption):
            buffer.write(f"# {line}\n")
        writer = csv.writer(buffer, lineterminator="\n")
        writer.writerow(["panel", "x_label", "y_label", "series", "origin", "x", "y", "low", "high"])
        for number, panel in enumerate(self.panels, start=1):
            for one in panel.series:
                for k in range(one.x.size):
                    ends = ["" if end is None else _cell(end[k]) for end in (one.low, one.high)]
                    head = [number, panel.x_label, panel.y_label, one.name, one.origin]
                    writer.writerow([*head, _cell(one.x[k]), _cell(one.y[k]), *ends])
        return buffer.getvalue()


def _cell(value: float) -> str:
    return f"{value:.8g}" if np.isfinite(value) else ""


# Figures of the paper as matplotlib draws them, in the style of every printed figure.

WIDTHS = (1.6, 1.2, 1.2, 1.2, 1.2, 1.2, 1.2)
DASHES: dict[str, Any] = {"ours": "-", PUBLISHED: (0, (5, 2)), OTHER: (0, (1, 1.2))}
LEGEND_ROOM = 4.0
"""Space above the curves of a logarithmic panel, a factor."""
PANEL_INCHES = (3.5, 3.0)


def draw(content: PaperFigure) -> Any:
    """The figure as matplotlib draws it, without a display."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(SETTINGS):
        width, height = PANEL_INCHES
        is_schematic = [any(one.kind == BOXES for one in panel.series) for panel in content.panels]
        if any(is_schematic):
            figure = Figure(figsize=(2 * width, 1.4 * height), layout="constrained")
            axes = figure.subplots(len(content.panels), 1, squeeze=False, height_ratios=[1, 3]).ravel()
        else:
            figure = Figure(figsize=(width * len(content.panels), height), layout="constrained")
            axes = figure.subplots(1, len(content.panels), squeeze=False).ravel()
        for panel, at, has_boxes in zip(content.panels, axes, is_schematic, strict=True):
            if has_boxes:
                _draw_boxes(at, panel.series)
            else:
                _draw_panel(at, panel)
    return figure


def _draw_panel(axes: Any, panel: Panel) -> None:
    groups = list(dict.fromkeys(one.group or one.name for one in panel.series))
    for one in panel.series:
        # matplotlib leaves names that begin with an underscore out of the legend
        place = groups.index(one.group or one.name) % len(COLOURS)
        _draw_series(axes, one, COLOURS[place], MARKERS[place], WIDTHS[place])
    for x in panel.vertical:
        axes.axvline(x, color="0.5", lw=0.7, ls=":")
    if panel.diagonal:
        axes.axline((0.0, 0.0), slope=1.0, color="0.5", lw=0.7)
    for x, y, text in panel.notes:
        axes.annotate(text, (x, y), fontsize=6.5)
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)
    if panel.is_log:
        axes.set_yscale("log")
        axes.set_ylim(top=LEGEND_ROOM * axes.get_ylim()[1])
    if panel.title:
        axes.set_title(panel.title, fontsize=8)
    axes.legend(ncols=2 if len(panel.series) > 8 else 1)


def _draw_series(axes: Any, one: Series, colour: str, marker: str, width: float) -> None:
    if one.kind == BAND:
        hatch = "////" if one.origin == PUBLISHED else None
        axes.fill_between(
            one.x, one.low, one.high, facecolor=colour, alpha=0.18, lw=0, hatch=hatch, edgecolor=colour, label=one.name
        )
    elif one.kind == LINE:
        if one.low is not None:
            axes.fill_between(one.x, one.low, one.high, color=colour, alpha=0.35, lw=0)
        axes.plot(
            one.x, one.y, color=colour, lw=width, ls=DASHES[one.origin], label=one.name,
            marker=marker, ms=2.6, mfc="white", mew=0.6, markevery=(0.02, 0.14),
        )  # fmt: skip
    else:
        bars = None if one.low is None or one.high is None else [one.y - one.low, one.high - one.y]
        axes.errorbar(one.x, one.y, bars, fmt=marker, ms=2.6, lw=0.6, color=colour, mfc="white", label=one.name)


def _draw_boxes(axes: Any, boxes: Sequence[Series]) -> None:
    """A row of boxes with arrows from each to the next."""
    for one in boxes:
        x = float(one.x[0])
        is_added = one.name.startswith("+")
        style = {
            "boxstyle": "circle,pad=0.25" if is_added else "round,pad=0.4",
            "fc": "white",
            "ec": "black",
            "lw": 0.8,
        }
        axes.annotate(
            one.name.replace(" G", "\nG").replace(" L", "\nL").replace("sky + ", "sky\n+ "),
            (x, 0.0),
            ha="center",
            va="center",
            bbox=style,
            fontsize=7,
        )
        if x > 0:
            axes.annotate(
                "", (x - 0.37, 0.0), (x - 0.58, 0.0), arrowprops={"arrowstyle": "-|>", "lw": 0.8, "fc": "black"}
            )
    axes.set_xlim(-0.6, len(boxes) - 0.4)
    axes.set_ylim(-1.0, 1.0)
    axes.axis("off")


# Figures 1 to 6: the chain, its parts, the LST variation, the noise terms and C(nu), each with ours beside it.

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
    stages = {"1 behind the active antenna": behind_antenna, "2 behind the cable": behind_cable, "3 recorded": recorded}
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
        [Panel(FREQUENCY, "C (µV per ADC unit)", upper), Panel(FREQUENCY, "error of the fit (%)", lower)],
    )


def _band(name: str, x: Floats, y: Floats, relative: Floats | float, origin: str, group: str = "published") -> Series:
    half = y * relative
    return Series(name, x, y, y - half, y + half, BAND, origin, group)


# Figures 7 to 9: slopes of signals, calibrations in ratio, and the field of the reference source.

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
