"""HTML reports of commands: one file, its style and its figures inside."""

from __future__ import annotations

import base64
import io
from typing import Any

import numpy as np
from jinja2 import ChoiceLoader, Environment, PackageLoader
from matplotlib.figure import Figure

from lbacal.pages.finding import FILTERS
from lbacal_core.data.lofar import DIPOLES
from lbacal_core.errors import write_chance
from lbacal_core.lstcurve.curve import AS_RECORDED, Comparison, band_weights, in_db, simulate_band_power
from lbacal_core.simulation.simulation import Simulation


def fill_report(template: str, package: str = "lbacal.pages", **content: Any) -> str:
    """A report as HTML; every template, of `package` or of this one, fills the blocks of `base.html`."""
    loader = ChoiceLoader([PackageLoader(name) for name in dict.fromkeys((package, "lbacal.pages"))])
    environment = Environment(loader=loader, autoescape=True)
    environment.filters |= {"chance": write_chance, **FILTERS}
    return environment.get_template(template).render(**content)


def embed(figure: Figure) -> str:
    """Encode the figure as a base64 PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=120)
    return base64.b64encode(buffer.getvalue()).decode()


# The one place where the style of printed figures stands: readable in grey, by the colour-blind, and at column width.
#
# Colours are those of Okabe and Ito (2008); each goes with a line style and a marker of its own, so that no curve is
# told by colour alone.

COLOURS = ("#000000", "#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Black, vermilion, blue, green, purple, orange, sky blue; their lightness differs as well."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
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


# The figures of reports: each takes core values and returns a matplotlib figure, drawn without a display.

DIPOLE_COLOURS = {"X": COLOURS[1], "Y": COLOURS[2]}
GREY = "#666666"
FULL_DAY = np.linspace(0.0, 24.0, 289)


def draw_lst_comparison(comparison: Comparison, simulation: Simulation) -> Figure:
    """Measured LST curve, the simulation with and without noise, and what is left."""
    figure = Figure(figsize=(9.5, 6.2), layout="constrained")
    axes: Any = figure.subplots(2, 2, sharex=True, sharey="row", height_ratios=[2, 1])
    curve = comparison.curve
    for dipole, (top, below) in zip(DIPOLES, axes.T, strict=True):
        draw_lst_panel(top, comparison, simulation, dipole)
        points = {"fmt": "o", "ms": 3.5, "lw": 0.8, "color": DIPOLE_COLOURS[dipole], "label": "with noise"}
        with_noise, alone = (comparison.of(dipole, has_noise=has_noise).residual_db for has_noise in (True, False))
        below.errorbar(curve.lst_hours, with_noise, curve.error_db, **points)
        below.plot(curve.lst_hours, alone, "x", ms=4, color=GREY, label="sky alone")
    label_lst_panels(axes)
    low, high = comparison.band_mhz
    figure.suptitle(f"Band of {low:g}-{high:g} MHz: only noise share and offset fitted", fontsize=11)
    return figure


def draw_lst_panel(axes: Any, comparison: Comparison, simulation: Simulation, dipole: str) -> None:
    """One dipole, measured and simulated, on axes."""
    weights = band_weights(simulation.instrument, AS_RECORDED, comparison.band_mhz)
    simulated = simulate_band_power(simulation.sky_power, dipole, FULL_DAY, weights)
    points = {"fmt": "o", "ms": 3.5, "lw": 0.8, "color": DIPOLE_COLOURS[dipole], "label": f"measured, {dipole}"}
    curve = comparison.curve
    axes.errorbar(curve.lst_hours, curve.variation_db[dipole], curve.error_db, **points)
    for has_noise, style in ((False, "--"), (True, "-")):
        fit = comparison.of(dipole, has_noise=has_noise)
        words = f"sky and {100 * fit.noise_share:.0f} % noise" if has_noise else "sky alone"
        level = in_db(simulated, fit.noise_share) + fit.offset_db
        label = f"{words}: chi² per point {fit.chi2 / fit.points:.1f}"
        axes.plot(FULL_DAY, level, style, color="black" if has_noise else GREY, lw=1.3, label=label)


def label_lst_panels(axes: Any) -> None:
    """Label an upper row of band power and a lower row of what is left of it, both over local sidereal time."""
    for top, below in axes.T:
        below.axhline(0.0, color="black", lw=0.8)
        top.legend(fontsize=7.5, frameon=False)
        below.legend(fontsize=7.5, frameon=False, ncols=2)
        below.set_xlabel("local sidereal time (h)")
    axes[0, 0].set_ylabel("band power, relative to LST 0 (dB)")
    axes[1, 0].set_ylabel("measured - simulated (dB)")
    axes[0, 0].set_xlim(0, 24)
    axes[0, 0].set_xticks(range(0, 25, 4))
