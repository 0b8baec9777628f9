"""`./dev demo`: the whole mission in half a minute, in the terminal and on one page (var/report.html)."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lbacal.pages.curve import draw_curve
from lbacal.pages.report import fill_report
from lbacal_core.calibration.budget import add_budget, compute_budget
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.curves.curves import CalibrationCurve, FitReport
from lbacal_core.data.lofar import DIPOLES
from lbacal_core.data.tables import read_table
from lbacal_core.discovery.curve_search import CurveInvestigation, describe_curve, investigate_curve
from lbacal_core.discovery.report import investigate
from lbacal_core.grids import Floats
from lbacal_core.lstcurve.curve import BAND_MHZ, measured_curve, read_lst_curve
from lbacal_core.provenance import Provenance
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.spectra import Spectra, write_spectra
from lbacal_twin.campaign import Campaign, simulate_campaign
from lbacal_twin.faults.sky import SolarEmission
from lbacal_twin.settings import TwinSettings
from validation.demo.figures import draw_calibration, draw_drift
from validation.demo.service_run import (
    AFTER,
    BEFORE,
    STATION,
    STEP,
    ServedRun,
    describe_served,
    running_server,
    serve_years,
)

SETTINGS = TwinSettings(stations=(STATION,), antennas=6, years=1.99, events_per_year=300)
SUN = SolarEmission(size=0.05)
SEED = 2019
NEW_YEAR_2015 = 1_420_070_400.0
SHOWN_MHZ = (30, 40, 50, 58, 70, 77)
SHOWN_ANTENNAS = 2


@dataclass(frozen=True)
class Demonstration:
    """Results from files: fits of the first year, the effect hidden in another year, and the measured curve."""

    campaign: Campaign
    first_year: Spectra
    paths: FitReport
    station: FitReport
    hidden: Spectra
    found: dict[str, Any]
    measured: dict[str, Any]
    curve: CurveInvestigation


def simulate(simulation: Simulation) -> tuple[Campaign, Spectra]:
    """Simulate two years with a gain step in one path, and a year in which the Sun shines."""
    campaign = simulate_campaign(
        SETTINGS, simulation.instrument, simulation.sky_power, np.random.default_rng(SEED), [STEP]
    )
    hidden = simulate_campaign(
        SETTINGS, simulation.instrument, simulation.sky_power, np.random.default_rng(SEED + 1), [SUN]
    ).spectra
    return campaign, hidden.select(hidden.time_unix < NEW_YEAR_2015)


def compute(simulation: Simulation, campaign: Campaign, hidden: Spectra) -> Demonstration:
    """Fit the first year, ask what the simulation of the other year gets wrong, and ask the measured curve the same."""
    first_year = campaign.spectra.select(campaign.spectra.time_unix < NEW_YEAR_2015)
    budget = compute_budget(first_year, simulation)
    scopes = "antenna", "station"
    paths, station = (add_budget(fit_calibration(first_year, simulation, scope), budget) for scope in scopes)
    found, _ = investigate(hidden, simulation, seed=1)
    curve = investigate_curve(read_lst_curve(measured_curve()), simulation, BAND_MHZ)
    measured = describe_curve(curve, Provenance({}, {}))
    return Demonstration(campaign, first_year, paths, station, hidden, found, measured, curve)


def _planted(shown: Demonstration, curve: CalibrationCurve) -> Floats:
    return shown.campaign.truth.curve(str(curve.dipole), curve.station, curve.antenna)


def tabulate(shown: Demonstration) -> list[list[str]]:
    """C of a few paths, of the station and as published at a few frequencies, as text."""
    antennas = sorted({curve.antenna for curve in shown.paths.curves if curve.antenna is not None})[:SHOWN_ANTENNAS]
    rows = []
    for curve in [c for c in shown.paths.curves if c.antenna in antennas] + list(shown.station.curves):
        at = _channels(curve.frequency_mhz)
        if curve.c is None or curve.c_sigma_stat is None:
            rows.append([curve.name, curve.status, *[""] * (len(at) - 1)])
            continue
        c, sigma, has_value = 1e6 * curve.c, 1e6 * curve.c_sigma_stat, curve.has_value
        rows.append([curve.name, *[f"{c[k]:.2f} ± {sigma[k]:.2f}" if has_value[k] else "outside" for k in at]])
        rows.append(["  planted", *[f"{1e6 * _planted(shown, curve)[k]:.2f}" for k in at]])
        if curve.antenna is None and curve.c_sigma_sys is not None:
            systematic = 100 * curve.c_sigma_sys / curve.c
            rows.append(["  systematic error", *[f"{systematic[k]:.1f} %" if has_value[k] else "" for k in at]])
    published = read_table("published_calibration")
    rows.append(["published", *[f"{1e6 * c:.2f}" for c in np.interp(SHOWN_MHZ, published["mhz"], published["c"])]])
    return rows


def describe_recovery(shown: Demonstration) -> str:
    """How well the fit found what was planted, in one sentence."""
    fitted = [curve for curve in shown.paths.curves if curve.c is not None]
    if not fitted:
        return f"No path converged: {shown.paths.status}."
    error = np.concatenate([(np.asarray(c.c) / _planted(shown, c) - 1.0)[c.has_value] for c in fitted])
    sigma = np.concatenate([(np.asarray(c.c_sigma_stat) / np.asarray(c.c))[c.has_value] for c in fitted])
    return (
        f"{len(fitted)} of {len(shown.paths.curves)} paths converged; fitted and planted C differ by "
        f"{100 * np.median(np.abs(error)):.2f} % in the median over paths and channels, where the fit claims "
        f"{100 * np.median(sigma):.2f} % (statistical; sky and antenna are right in this simulation)."
    )


def tabulate_served(served: ServedRun, campaign: Campaign) -> list[list[str]]:
    """C in effect of the stepping path before and after the step, each beside what was planted."""
    rows = []
    for at, factor in ((BEFORE, 1.0), (AFTER, (1.0 + STEP.size) ** -0.5)):
        curve = served.curves[at]
        shown = _channels(np.array(curve["frequency_mhz"]))
        planted = factor * np.asarray(campaign.truth.curve(curve["dipole"], curve["station"], curve["antenna"]))
        c = [
            "outside" if curve["c"][k] is None else f"{1e6 * curve['c'][k]:.2f} ± {1e6 * curve['c_sigma_stat'][k]:.2f}"
            for k in shown
        ]
        rows += [[f"in effect on {at}", *c], ["  planted", *[f"{1e6 * planted[k]:.2f}" for k in shown]]]
    return rows


def describe_hidden(shown: Demonstration) -> list[str]:
    """Describe the error of the simulation of the other year, and the gain of the extended model, in sentences."""
    if not shown.found["findings"]:
        return [f"Nothing was named: {shown.found['verdict']}."]
    finding = shown.found["findings"][0]
    gain, change = finding["gain"], finding["calibration_change"]
    extended = (
        f"The model extended by it explains events on which it was not fitted better by ln L "
        f"{gain['held_out_log_likelihood_gain']:+.0f} ({gain['held_out_events']} events, four folds); chi² falls by "
        f"{gain['chi2_before'] - gain['chi2_after']:.0f}, and C changes by up to {100 * change['max_fraction']:.1f} %. "
        f"Verdict: {shown.found['verdict']}."
    )
    return [f"{finding['sentence']} ({finding['significance_sigma']:.0f} sigma; planted was {SUN.size:g})", extended]


def describe_measured(shown: Demonstration) -> list[str]:
    before, after = (fit.chi2_drawn / fit.points for fit in (shown.curve.first, shown.curve.last))
    named = [finding["sentence"] for finding in shown.measured["findings"]] or [shown.measured["verdict"]]
    return [*named, f"chi² per point with the drawn error bars: {before:.1f} before, {after:.1f} after."]


def render_report(shown: Demonstration, served: ServedRun | None = None) -> str:
    """The report as one self-contained page; with what the service found, if it ran."""
    fitted = [curve for curve in shown.station.curves if curve.c is not None]
    truth = {d: shown.campaign.truth.curve(d, STATION) for d in DIPOLES}
    return fill_report(
        "demo.html",
        "validation.demo",
        spectra=len(shown.first_year),
        paths=len(shown.paths.curves),
        frequencies=SHOWN_MHZ,
        rows=tabulate(shown),
        recovery=describe_recovery(shown),
        hidden=describe_hidden(shown),
        findings=shown.found["findings"][:1],
        measured=describe_measured(shown),
        served=None if served is None else describe_served(served),
        served_rows=[] if served is None else tabulate_served(served, shown.campaign),
        calibration=draw_calibration(fitted, truth),
        curve=list(draw_curve(shown.curve)),
        drift=None if served is None else draw_drift(served.station, served.path),
    )


def main(arguments: Sequence[str] = (), output: Path = Path("var/report.html")) -> int:
    """Run the demonstration; exit 0 when every curve converged, and the step and the Sun are found.

    With ``--serve`` the service stays up until Ctrl-C.
    """
    if unknown := [argument for argument in arguments if argument != "--serve"]:
        print(f"usage: ./dev demo [--serve], found {unknown[0]!r}", file=sys.stderr)
        return 2
    began = time.monotonic()
    output.parent.mkdir(parents=True, exist_ok=True)
    # the service works in processes of its own, beside the fits and the search of this one
    stays = "--serve" in arguments
    with running_server(output.parent / "demo", searches=stays) as server, ThreadPoolExecutor(1) as beside:
        simulation = Simulation.load("lofar-superterp")
        campaign, hidden = simulate(simulation)
        lines: list[str] = []
        serving = beside.submit(serve_years, campaign.spectra, server, lines.append)
        shown = compute(simulation, campaign, hidden)
        head = ["C in µV per ADC unit", *[f"{mhz} MHz" for mhz in SHOWN_MHZ]]
        print(f"1. The calibration C of {STATION}: {len(shown.paths.curves)} paths, a simulated year")
        _print_rows([head, *tabulate(shown)])
        print(f"{describe_recovery(shown)}\n")
        print("2. What the simulation gets wrong: a year in which the Sun shines, which the simulation does not know")
        print("\n".join(describe_hidden(shown)), end="\n\n")
        print("3. What the measured LOFAR curve says (published band power against sidereal time)")
        print("\n".join(describe_measured(shown)), end="\n\n", flush=True)
        served = serving.result()
        print("4. The service: in effect on a date, asked over HTTP before and after a gain step")
        print("\n".join([*lines, describe_served(served)]))
        _print_rows([head, *tabulate_served(served, campaign)])
        output.write_text(render_report(shown, served), encoding="utf-8")
        write_spectra(hidden, output.with_name("spectra.h5"))
        print(f"\n{time.monotonic() - began:.0f} s. Open {output}. Next, on the year with the Sun:")
        data = f"{output.parent}/spectra.h5 --instrument lofar-superterp"
        print(f"  .venv/bin/lbacal fit {data} --output var/C.h5 --report var/C.json --html var/fit.html")
        print(f"  .venv/bin/lbacal investigate {data} --report var/R.json --html var/R.html")
        if stays:
            print(f"The page is {server.url}/, the interface {server.url}/docs; Ctrl-C ends", flush=True)
            _wait_for_interrupt()
        else:
            print("  ./dev demo --serve     (keeps the service and its page up)")
    named = {finding["cause"] for finding in shown.found["findings"]}
    return 0 if shown.paths.status == "converged" and served.is_found and "solar_emission" in named else 1


def _channels(frequency_mhz: Floats) -> list[int]:
    return [int(np.argmin(np.abs(frequency_mhz - mhz))) for mhz in SHOWN_MHZ]


def _wait_for_interrupt() -> None:
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        print()


def _print_rows(rows: Sequence[Sequence[str]]) -> None:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    for name, *cells in rows:
        print(
            name.ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(cells, widths[1:], strict=True)), sep="  "
        )


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except KeyboardInterrupt:
        print("\n./dev demo: stopped", file=sys.stderr)
        sys.exit(130)
