"""`./dev demo`: the main job end to end, by the fit and through the service; writes var/report.html and its data."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lbacal.cli.figures import (
    FULL_DAY,
    draw_calibration,
    draw_drift,
    draw_lst_comparison,
    draw_noise,
    draw_residuals,
)
from lbacal.cli.report_pages import embed, fill_report
from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.calibration.freedom import free_own_sky
from lbacal_core.curves import OK, CalibrationCurve, FitReport
from lbacal_core.data.lofar import DIPOLES
from lbacal_core.data.tables import read_table
from lbacal_core.in_words import name_path
from lbacal_core.instrument import Instrument, load_instrument
from lbacal_core.lstcurve.compare import (
    AS_RECORDED,
    BAND_MHZ,
    Comparison,
    band_weights,
    compare_lst_curve,
    simulate_band_power,
)
from lbacal_core.lstcurve.curve import measured_curve, read_lst_curve
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra import write_spectra
from lbacal_core.spectra_blocks import split_into_blocks
from lbacal_core.uncertainty.departures import map_departures
from lbacal_core.uncertainty.refit import add_budget, compute_budget
from lbacal_twin.campaign import Campaign, simulate_campaign
from lbacal_twin.settings import TwinSettings
from service.cli.demo_service import ServedRun, describe_served, serve_demonstration

STATION = "CS002"
SHOWN_ANTENNAS = 3
SHOWN_MHZ = (30, 40, 50, 58, 70, 80)
EXPECTED = (
    "Expected of one campaign are 44 to 80 % (95 % of 300 simulated ones; 68 % in their mean), because errors are "
    "almost fully correlated along frequency, and part of them is common to all paths of a station."
)
SYSTEMATIC = (
    "The systematic error is how far sky, antenna and ground may be from what the fit takes them to be "
    "(lbacal budget); in this simulation they are right."
)


@dataclass(frozen=True)
class Demonstration:
    """Everything that the report shows."""

    instrument: Instrument
    sky_power: SkyPower
    campaign: Campaign
    paths: FitReport
    station: FitReport
    real: Comparison


def demonstrate(instrument: Instrument, sky_power: SkyPower, settings: TwinSettings, seed: int) -> Demonstration:
    """Simulate a station, fit every path and the station, and compare the measured LST curve."""
    with _step("simulate spectra"):
        campaign = simulate_campaign(settings, instrument, sky_power, np.random.default_rng(seed))
    with _step("fit every path, and the station"):
        inputs, freedom = (campaign.spectra, instrument, sky_power), free_own_sky(instrument)
        budget = compute_budget(*inputs, freedom=freedom)
        paths, station = (
            add_budget(fit_calibration(*inputs, scope, freedom), budget) for scope in ("antenna", "station")
        )
    with _step("compare the measured LST curve"):
        real = compare_lst_curve(read_lst_curve(measured_curve()), sky_power, instrument)
    return Demonstration(instrument, sky_power, campaign, paths, station, real)


def tabulate(shown: Demonstration) -> list[list[str]]:
    """C of a few paths, of the station and as published at a few frequencies, as text."""
    frequency = shown.instrument.frequency_mhz
    at = [int(np.argmin(np.abs(frequency - mhz))) for mhz in SHOWN_MHZ]
    antennas = sorted({curve.antenna for curve in shown.paths.curves if curve.antenna is not None})[:SHOWN_ANTENNAS]
    rows = []
    for curve in [c for c in shown.paths.curves if c.antenna in antennas] + list(shown.station.curves):
        if curve.c is None or curve.c_sigma_stat is None:
            rows.append([curve.name, curve.status, *[""] * (len(at) - 1)])
            continue
        c, sigma, has_value = 1e6 * curve.c, 1e6 * curve.c_sigma_stat, curve.has_value
        rows.append([curve.name, *[f"{c[k]:.2f} ± {sigma[k]:.2f}" if has_value[k] else "outside" for k in at]])
        planted = _planted(shown.campaign, curve)
        rows.append(["  planted", *[f"{1e6 * planted[k]:.2f}" for k in at]])
        if curve.antenna is None and curve.c_sigma_sys is not None:
            systematic = 100 * curve.c_sigma_sys / curve.c
            rows.append(["  systematic error", *[f"{systematic[k]:.1f} %" if has_value[k] else "" for k in at]])
    published = read_table("published_calibration")
    c = np.interp(frequency, published["mhz"], published["c"])
    rows.append(["published", *[f"{1e6 * c[k]:.2f}" for k in at]])
    return rows


def describe_recovery(shown: Demonstration) -> str:
    """How well the fit found what was planted, in one sentence."""
    fitted = [curve for curve in shown.paths.curves if curve.c is not None]
    if not fitted:
        return f"No path converged: {shown.paths.status}."
    error = np.array([np.asarray(curve.c) / _planted(shown.campaign, curve) - 1.0 for curve in fitted])
    sigma = np.array([np.asarray(curve.c_sigma_stat) / np.asarray(curve.c) for curve in fitted])
    has_value = np.array([curve.has_value for curve in fitted])
    error, sigma = error[has_value], sigma[has_value]
    inside = float(np.mean(np.abs(error) < sigma))
    flagged = int(np.sum([curve.flags != OK for curve in fitted]))
    off, claimed = 100 * np.median(np.abs(error)), 100 * np.median(sigma)
    return (
        f"{len(fitted)} of {len(shown.paths.curves)} paths converged, {flagged} of {has_value.size} channels are "
        f"flagged; the median |fitted / planted - 1| over paths and channels is {off:.2f} %, the median error claimed "
        f"{claimed:.2f} %, and {100 * inside:.0f} % of the values lie within one standard deviation. {EXPECTED}"
    )


def describe_real(comparison: Comparison) -> str:
    """Compare the measured LST curve with the simulation, in one sentence for each dipole."""
    sentences = []
    for dipole in DIPOLES:
        alone, noisy = (comparison.of(dipole, has_noise=has_noise) for has_noise in (False, True))
        sentences.append(
            f"{dipole}: sky alone leaves chi² per point {alone.chi2 / alone.points:.1f} ({alone.rms_db:.2f} dB rms); "
            f"with a noise share of {noisy.noise_share:.2f} it is {noisy.chi2 / noisy.points:.1f} "
            f"({noisy.rms_db:.2f} dB rms)."
        )
    return " ".join(sentences)


def render_report(shown: Demonstration, served: ServedRun | None = None) -> str:
    """The report as one self-contained page; with what the service found, if it ran."""
    spectra, station = shown.campaign.spectra, shown.campaign.truth.stations[0]
    weights = band_weights(shown.instrument, AS_RECORDED, BAND_MHZ)
    sky_curves = {d: simulate_band_power(shown.sky_power, d, FULL_DAY, weights) for d in DIPOLES}
    fitted = [curve for curve in shown.station.curves if curve.c is not None]
    maps = {
        block.dipole: map_departures(block, shown.paths.curves, shown.instrument, shown.sky_power)
        for block in split_into_blocks(spectra)
    }
    figures = {
        "calibration": draw_calibration(
            fitted, shown.paths.curves, {d: shown.campaign.truth.curve(d, station.station) for d in DIPOLES}
        ),
        "noise": draw_noise(fitted[0], shown.instrument, shown.sky_power),
        "residuals": draw_residuals(maps, shown.instrument.frequency_mhz),
        "lst": draw_lst_comparison(shown.real, sky_curves),
    }
    if served is not None:
        figures["drift"] = draw_drift(served.station, served.path)
    return fill_report(
        "demo.html",
        opening=(
            f"One simulated year of station {station.station}: {len(spectra):,} background spectra of "
            f"{len(station.antennas)} antennas, two dipoles each, on {spectra.frequency_mhz.size} channels of 1 MHz. "
            "The fit sees the spectra and the simulated Galaxy, and finds the calibration that was planted."
        ),
        table={"frequencies": SHOWN_MHZ, "rows": tabulate(shown)},
        figures={name: embed(figure) for name, figure in figures.items()},
        recovery=f"{SYSTEMATIC} {describe_recovery(shown)}",
        real=describe_real(shown.real),
        served=None if served is None else describe_served(served),
        sky=shown.sky_power.origin,
    )


def write_year(shown: Demonstration, output: Path) -> Path:
    """Write the spectra of the simulated year beside the report."""
    path = output.with_name("spectra.h5")
    write_spectra(shown.campaign.spectra, path)
    return path


def main(arguments: Sequence[str] = (), output: Path = Path("var/report.html")) -> int:
    """Run the demonstration on the shipped instrument and sky; exit 0 when every curve converged and the step is found.

    A channel that is flagged costs a curve that channel and no more.
    With ``--serve`` the service stays up until Ctrl-C.
    """
    if unknown := [argument for argument in arguments if argument != "--serve"]:
        print(f"usage: ./dev demo [--serve], found {unknown[0]!r}", file=sys.stderr)
        return 2
    from lbacal_core.skypower.model import compute_sky_power

    with _step("sky power of the embedded Galaxy over lofar-superterp"):
        instrument = load_instrument("lofar-superterp")
        sky_power = compute_sky_power(instrument)
    shown = demonstrate(instrument, sky_power, TwinSettings(stations=(STATION,)), seed=2019)
    print(f"\nC(nu) in µV per ADC unit, {STATION}, one simulated year:")
    _print_rows([["path", *[f"{mhz} MHz" for mhz in SHOWN_MHZ]], *tabulate(shown)])
    print(f"{SYSTEMATIC}\n\n{describe_recovery(shown)}\n")
    print(f"Measured LST variation against our sky:\n{describe_real(shown.real)}\n")
    print("The same through the service, two years with a gain step in one path:")
    with serve_demonstration(instrument, sky_power, output.parent / "demo", tell=_tell) as served:
        print(f"\n{describe_served(served)}")
        _print_curve(served)
        with _step("draw the report"):
            output.write_text(render_report(shown, served), encoding="utf-8")
        print(f"wrote {output}; the simulated year, for the commands that read files: {write_year(shown, output)}")
        if "--serve" in arguments:
            print(f"the page is {served.url}/drift, the interface {served.url}/docs; Ctrl-C ends", flush=True)
            _wait_for_interrupt()
    return 0 if shown.paths.status == "converged" and served.is_found else 1


def _planted(campaign: Campaign, curve: CalibrationCurve) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.asarray(campaign.truth.curve(curve.dipole or DIPOLES[0], curve.station, curve.antenna))


def _print_curve(served: ServedRun) -> None:
    curve = served.curve
    at = [curve["frequency_mhz"].index(mhz) for mhz in SHOWN_MHZ]
    cells = [f"{1e6 * curve['c'][k]:.2f} ± {1e6 * curve['c_sigma_stat'][k]:.2f}" for k in at]
    name = name_path(curve["station"], curve["antenna"], curve["dipole"])
    print("C(nu) in effect, in µV per ADC unit:")
    _print_rows([["path", *[f"{mhz} MHz" for mhz in SHOWN_MHZ]], [name, *cells]])
    print()


def _tell(sentence: str) -> None:
    print(f"  {sentence}", flush=True)


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


@contextmanager
def _step(name: str) -> Iterator[None]:
    started = time.monotonic()
    yield
    print(f"{name}: {time.monotonic() - started:.1f} s", flush=True)


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except KeyboardInterrupt:
        print("\n./dev demo: stopped", file=sys.stderr)
        sys.exit(130)
