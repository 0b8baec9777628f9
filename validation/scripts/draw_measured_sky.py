"""Write the tables and the figure of docs/explanation/measured-sky.md: what the measured sky does to C.

.venv/bin/python -m validation.scripts.draw_measured_sky ../shared/data/anchor/edges_sky_temperature.csv
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from lbacal.pages.chart import COLOURS
from lbacal_core.antenna.ideal import ShortDipole
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.data.tables import read_columns, read_table
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument, load_instrument
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.names import load_sky, read_sky_level
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.sky_terms import EDGES_DEG, EDGES_HEIGHT_M, SKY_BUDGETS, dipole_temperature, sky_terms
from lbacal_paper.figures import MARKERS, SETTINGS
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings
from validation.anchors import combine_anchors, predict_left_out, read_anchors
from validation.machinery.tables import replace_tables, write_table

DOCS = Path(__file__).parents[2] / "docs"
PAGE = DOCS / "explanation" / "measured-sky.md"
SHOWN_MHZ = (30, 40, 50, 58, 70, 80)
HEAD = ["", *(f"{mhz} MHz" for mhz in SHOWN_MHZ)]
SEED = 2019  # that of `lbacal paper`

Rows = dict[str, np.ndarray]


def tabulate_families() -> list[str]:
    """Tabulate each family of experiments, and the prediction by the others, in percent of the brightness of gsm."""
    anchors = read_anchors()
    rows = []
    for line in predict_left_out(anchors, load_sky("gsm")):
        names = "; ".join(one.experiment for one in anchors if one.family == line.family)
        measured, predicted, sigma = (100 * value for value in (line.measured, line.predicted, line.sigma))
        rows.append([names, f"{measured:+.1f}", f"{predicted:+.1f} ± {sigma:.1f}", f"{line.pull:+.1f}"])
    return write_table(["left out", "it measures", "the others predict", "pull"], rows)


def sky_error(instrument: Instrument, budget: str) -> Floats:
    """Error of C from the sky: half the root of the summed squares of the terms' means over LST, shape (freq,)."""
    terms = sky_terms(instrument, budget)
    means = [np.mean([v.mean(axis=0) for v in term.d_ln_p.values()], axis=0) for term in terms]
    return np.asarray(0.5 * np.sqrt(np.sum(np.square(means), axis=0)))


def tabulate_budgets(instrument: Instrument) -> list[str]:
    """Error of C from the sky, in percent."""
    at = np.isin(instrument.frequency_mhz, SHOWN_MHZ)
    totals = {budget: 100 * sky_error(instrument, budget)[at] for budget in SKY_BUDGETS}
    return write_table(HEAD, ([f"`{budget}`", *(f"{value:.1f}" for value in of)] for budget, of in totals.items()))


def tabulate_edges(table: Path) -> list[str]:
    """EDGES against gsm at the level that all other families give: mean and rms over LST, in percent."""
    read = read_columns(table)
    nu = np.array([50.0, 60.0, 70.0, 80.0, 100.0])
    others = combine_anchors([one for one in read_anchors() if one.family != "EDGES"], load_sky("gsm"))
    seen = dipole_temperature(load_sky("gsm"), ShortDipole(EDGES_HEIGHT_M), nu, EDGES_DEG, read["lst_h"])
    measured = read["t75_k"][:, None] * (nu / 75.0) ** read["beta_low"][:, None]
    left = 100 * (np.log(measured / seen) - others.ln_ratio(nu))
    error = 100 * np.hypot(others.sigma(nu), others.scatter)
    means = [f"{a:+.1f} ± {b:.1f}" for a, b in zip(left.mean(0), error, strict=True)]
    rows = [
        ["measured less predicted, mean over LST", *means],
        ["rms over LST", *(f"{value:.1f}" for value in left.std(axis=0))],
    ]
    return write_table(["", *(f"{mhz:g} MHz" for mhz in nu)], rows)


def fit_both(instrument: Instrument, settings: TwinSettings, scope: str) -> tuple[Rows, Rows]:
    """C of polarisation X of the same spectra with both skies, and its statistical error: by the name of the sky."""
    powers = {name: compute_sky_power(instrument, name) for name in ("gsm", "measured")}
    campaign = simulate_campaign(settings, instrument, powers["gsm"], np.random.default_rng(SEED))
    c: Rows = {}
    sigma: Rows = {}
    for name, power in powers.items():
        report = fit_calibration(campaign.spectra, Simulation(instrument, power), scope)
        curve = next(one for one in report.curves if one.dipole == "X")
        if curve.c is None or curve.c_sigma_stat is None:
            raise SystemExit(f"{scope}, sky {name}: {curve.status}")
        c[name], sigma[name] = curve.c, curve.c_sigma_stat
    return c, sigma


def tabulate_curves(curves: Rows, sigmas: Rows, frequency_mhz: np.ndarray) -> list[str]:
    at = np.isin(frequency_mhz, SHOWN_MHZ)
    rows = []
    for name, values in curves.items():
        errors = [f" ± {1e6 * value:.2f}" for value in sigmas[name][at]] if name in sigmas else [""] * len(SHOWN_MHZ)
        rows.append([name, *(f"{1e6 * value:.2f}{error}" for value, error in zip(values[at], errors, strict=True))])
    return write_table(HEAD, rows)


def draw(curves: Rows, instrument: Instrument, path: Path) -> None:
    """Experiments with the level that they give, and C with the bands of the sky's error."""
    nu, level = instrument.frequency_mhz, read_sky_level()
    with rc_context(SETTINGS):
        figure = Figure(figsize=(7.2, 3.2), layout="constrained")
        left, right = figure.subplots(1, 2)
        wide = np.geomspace(30.0, 150.0, 60)
        ratio, error = level.ln_ratio(wide), level.sigma(wide)
        left.fill_between(wide, np.exp(ratio - error), np.exp(ratio + error), color="0.85", lw=0)
        left.plot(wide, np.exp(ratio), color=COLOURS[0], label="level and slope, ± sd")
        for k, anchor in enumerate(read_anchors()):
            own = anchor.ln_ratio(load_sky("gsm"))
            size = np.sqrt(anchor.measurement_error**2 + anchor.channel_error**2 + anchor.model_error**2)
            left.errorbar(
                anchor.frequency_mhz * (1 + 0.006 * (k - 3)), np.exp(own), yerr=np.exp(own) * size,
                fmt=MARKERS[k], ms=3.5, lw=0.8, color=COLOURS[k % len(COLOURS)], mfc="white", label=anchor.experiment,
            )  # fmt: skip
        left.set(xscale="log", xlabel="frequency (MHz)", ylabel="brightness over the sky gsm", ylim=(0.78, 1.62))
        left.set_xticks([30, 50, 80, 150], ["30", "50", "80", "150"])
        left.minorticks_off()
        left.legend(loc="upper left", ncols=2, fontsize=5.5, columnspacing=0.8, handlelength=1.5)
        published = curves["published"]
        for k, (name, values) in enumerate(list(curves.items())[1:], 1):
            right.plot(nu, values / published, color=COLOURS[k], ls="-" if "gsm" in name else (0, (5, 2)), label=name)
        total, centre = sky_error(instrument, "measured"), np.exp(level.ln_ratio(nu) / 2)
        label = "measured sky, one standard deviation"
        right.fill_between(nu, centre * (1 - total), centre * (1 + total), color="0.85", lw=0, label=label)
        right.axhline(1.0, color="0.5", lw=0.6)
        right.set(xlabel="frequency (MHz)", ylabel="C over the published C", ylim=(0.88, 1.24))
        right.legend(loc="upper left")
        figure.savefig(path, dpi=130)


def main(table: str) -> None:
    instrument = load_instrument("lofar-superterp")
    read = read_table("published_calibration")
    curves: Rows = {"published": np.interp(instrument.frequency_mhz, read["mhz"], read["c"])}
    sigmas: Rows = {}
    for what, settings, scope in (
        ("simulated station", TwinSettings(stations=("CS002",)), "station"),
        ("paper redone, array", TwinSettings(), "array"),
    ):
        c, sigma = fit_both(instrument, settings, scope)
        for sky, values in c.items():
            curves[f"{what}, `{sky}`"], sigmas[f"{what}, `{sky}`"] = values, sigma[sky]
        print(what, "C measured / C gsm:", (c["measured"] / c["gsm"])[np.isin(instrument.frequency_mhz, SHOWN_MHZ)])
    tables = {
        "families": tabulate_families(),
        "edges": tabulate_edges(Path(table)),
        "budgets": tabulate_budgets(instrument),
        "curves": tabulate_curves(curves, sigmas, instrument.frequency_mhz),
    }
    PAGE.write_text(replace_tables(PAGE.read_text(), tables))
    plain = {name.replace("`", ""): values for name, values in curves.items()}
    draw(plain, instrument, DOCS / "images" / "measured-sky.png")


if __name__ == "__main__":
    main(sys.argv[1])
