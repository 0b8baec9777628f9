"""Draw the figures and write the tables of docs/explanation/other-instruments.md from measured data beside the project.

.venv/bin/python -m validation.scripts.draw_other_instruments ../shared/data
"""

from __future__ import annotations

import re
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from lbacal.pages.chart import COLOURS
from lbacal_core.antenna.ideal import ShortDipole
from lbacal_core.antenna.model import AntennaModel
from lbacal_core.audit.antennas import compare_paths
from lbacal_core.audit.audit import AuditReport, audit
from lbacal_core.data.tables import read_columns
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import AntennaRecord, Instrument
from lbacal_core.readers.open import choose_channels, open_source
from lbacal_core.readers.source import average
from lbacal_core.sky.names import load_sky
from lbacal_core.sky.sky_terms import dipole_temperature
from lbacal_core.spectra.spectra import Spectra
from lbacal_paper.figures import SETTINGS
from validation.machinery.tables import replace_tables, write_table

DOCS = Path(__file__).parents[2] / "docs"
PAGE = DOCS / "explanation" / "other-instruments.md"
HERA_DEG, EDA2_DEG, RS509_DEG = (-30.7215, 21.4283), (-26.70, 116.67), (53.41, 6.79)
EDGES_DEG = -26.715
HEIGHTS_M = {75.0: (0.5, 1.04, 1.5), 150.0: (0.25, 0.52, 0.75)}
"""Heights of short horizontal dipoles over a perfect plane that stand for the antennas of EDGES, whose beam is not
public: 1.04 m and 0.52 m are their own heights; half and one and a half times that bracket them."""
DIRECTIONS = (0.0, 90.0)
"""Azimuths of the dipole, deg."""
RCUS = 96
EAST_DEG = 90.0


def make_instrument(name: str, place_deg: tuple[float, float], spectra: Spectra, arms: dict[str, float]) -> Instrument:
    """A record that says nothing but where the antennas stand: flat gains and one cable."""
    flat = np.ones(spectra.frequency_mhz.size)
    records = [AntennaRecord(str(spectra.station[0]), int(a), "none") for a in np.unique(spectra.antenna)]
    return Instrument(name, *place_deg, 100.0, spectra.frequency_mhz, arms, flat, flat, {"none": flat}, records)


def read_hera(data: Path) -> tuple[Spectra, Instrument]:
    source = open_source(data / "other" / "hera_2459122.25108_autos.uvh5")
    spectra = average(source, 60.0, choose_channels(source, band_mhz=(50, 225), width_mhz=1.0)).spectra
    return spectra, make_instrument("HERA", HERA_DEG, spectra, dict(spectra.arms_deg))


def _one_integration(station: str, mhz: float, time_unix: float, powers: dict[tuple[int, str], float]) -> Spectra:
    paths = sorted(path for path, power in powers.items() if power > 0)
    rows = len(paths)
    return Spectra(
        np.array([mhz]), np.array([[powers[path]] for path in paths]), np.full(rows, "one"), np.full(rows, time_unix),
        np.full(rows, station), np.array([a for a, _ in paths]), np.array([d for _, d in paths]),
        np.ones(rows, dtype=np.int64),
    )  # fmt: skip


def read_eda2(data: Path) -> tuple[Spectra, Instrument]:
    read = read_columns(data / "other" / "eda2_autos_78mhz.csv")
    powers = {
        (int(antenna), letter.upper()): float(power)
        for letter in "xy"
        for antenna, power in zip(read["antenna"], read[letter], strict=True)
    }
    # nothing says where the arms of X and Y point, and one instant does not use it
    spectra = _one_integration("EDA2", 78.125, 1_639_180_800.0, powers)
    return spectra, make_instrument("EDA2", EDA2_DEG, spectra, {"X": EAST_DEG, "Y": 0.0})


def read_rs509(data: Path) -> tuple[Spectra, Instrument, Floats]:
    """The autocorrelations of RS509 by parity of the receiver, and the coherence of all receivers."""
    raw = (data / "rs509" / "20170621_072634_sb350_xst.dat").read_bytes()
    matrix = np.frombuffer(raw, dtype=np.complex128).reshape(RCUS, RCUS)
    auto = np.diag(matrix).real
    powers = {(rcu // 2, "XY"[rcu % 2]): float(auto[rcu]) for rcu in range(RCUS)}
    spectra = _one_integration("RS509", 350 * 100.0 / 512, 1_498_029_994.0, powers)
    with np.errstate(invalid="ignore", divide="ignore"):
        coherence = np.abs(matrix) / np.sqrt(np.outer(auto, auto))
    return spectra, make_instrument("RS509", RS509_DEG, spectra, {"X": 45.0, "Y": 135.0}), coherence


def tabulate_audit(report: AuditReport) -> list[str]:
    """A line for each that is wrong, and one for all that one spectrum a path leaves open."""
    wrong = [f"- {one.verdict}: {_shorten(one.sentence)}" for one in report.lines if one.verdict != "undecided"]
    left = ", ".join(one.check for one in report.lines if one.verdict == "undecided")
    return [*wrong, f"- undecided: {left}"]


def _shorten(sentence: str) -> str:
    """The sentence without what stands in brackets, and without what its level is compared with."""
    return re.sub(r" \([^)]*\)", "", sentence).removesuffix(" from the others")


def read_edges(data: Path) -> dict[str, Floats]:
    return read_columns(data / "anchor" / "edges_sky_temperature.csv")


def expect_edges(mhz: float, lst: Floats) -> dict[tuple[float, float], Floats]:
    """Temperature of a short dipole of some height and direction under our sky, K, shape (lst,)."""
    sky = load_sky("gsm-wide")

    def seen(antenna: AntennaModel, arm: float) -> Floats:
        return dipole_temperature(sky, antenna, np.array([mhz]), EDGES_DEG, lst, arm)[:, 0]

    return {(height, arm): seen(ShortDipole(height), arm) for height in HEIGHTS_M[mhz] for arm in DIRECTIONS}


def tabulate_edges(data: Path) -> list[str]:
    """Level and shape of what EDGES measured over what our sky gives assumed dipoles, in percent."""
    read = read_edges(data)
    columns = []
    for mhz in HEIGHTS_M:
        measured = read[f"t{mhz:.0f}_k"]
        expected = expect_edges(mhz, read["lst_h"])
        level = {one: 100 * (measured.mean() / values.mean() - 1) for one, values in expected.items()}
        shape = {one: 100 * float(np.std(np.log(measured / values))) for one, values in expected.items()}
        largest = {one: float(values.max() / values.min()) for one, values in expected.items()}
        own = (HEIGHTS_M[mhz][1], DIRECTIONS[0])
        levels = f"{level[own]:+.1f}; {min(level.values()):+.1f} to {max(level.values()):+.1f}"
        shapes = f"{shape[own]:.1f}; {min(shape.values()):.1f} to {max(shape.values()):.1f}"
        ours = f"{largest[own]:.2f}; {min(largest.values()):.2f} to {max(largest.values()):.2f}"
        columns.append((levels, shapes, f"{measured.max() / measured.min():.2f}; {ours}"))
    names = (
        "measured over ours, mean over LST (%): own height, north-south; all beams",
        "r.m.s. of the rest over LST (%)",
        "highest over lowest temperature: measured; own height; all beams",
    )
    return write_table(["", "75 MHz", "150 MHz"], zip(names, *columns, strict=True))


def audit_quietly(spectra: Spectra, instrument: Instrument) -> AuditReport:
    """The audit with a short dipole's pattern, which one instant does not use."""
    return audit(spectra, instrument, antenna="short-dipole")


def draw_hera(report: AuditReport, axes: Any) -> None:
    """Spectra of all paths; those that the audit names stand out."""
    (station,) = report.stations
    wrong = {a for line in report.lines if line.verdict == "wrong" for a in line.antennas}
    for axis, d in zip(axes, range(2), strict=True):
        for a, antenna in enumerate(station.antennas):
            values = 10 * np.log10(station.power[a, d, 0])
            is_wrong = int(antenna) in wrong
            colour = COLOURS[1 + sorted(wrong).index(int(antenna))] if is_wrong else "0.6"
            label = f"antenna {antenna}" if is_wrong else None
            axis.plot(station.frequency_mhz, values, color=colour, lw=1.3 if is_wrong else 0.6, label=label)
        axis.set(xlabel="frequency (MHz)", title=f"HERA, {station.dipoles[d]}, LST 20.05 h")
        axis.legend()
    axes[0].set_ylabel("power (dB, correlator's unit)")


def draw_levels(report: AuditReport, axis: Any) -> None:
    station = report.stations[0]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "All-NaN|Mean of empty|Degrees of freedom", RuntimeWarning)
        level = 10 / np.log(10) * compare_paths(station).level
    for d, letter in enumerate(station.dipoles):
        axis.plot(station.antennas, level[:, d], ".os"[d + 1], ms=2.5, color=COLOURS[d + 1], label=letter, mew=0)
    named = [line for line in report.lines if line.verdict == "wrong" and line.antennas]
    for antenna in dict.fromkeys(line.antennas[0] for line in named):
        letters = [str(line.dipole) for line in named if line.antennas[0] == antenna]
        lowest = min(level[np.searchsorted(station.antennas, antenna), station.dipoles.index(d)] for d in letters)
        place = (antenna, lowest)
        axis.annotate(f"{antenna} {', '.join(letters)}", place, (4, -2), textcoords="offset points", fontsize=6)
    axis.set(xlabel="antenna", ylabel="power over the median (dB)")
    axis.set_title(f"{station.name}, {station.frequency_mhz[0]:.1f} MHz")
    axis.legend(loc="lower left")


def draw_coherence(coherence: Floats, axis: Any) -> None:
    """Coherence of all receivers: even ones of inner antennas and odd ones of outer ones, then the others."""
    even = np.arange(0, RCUS, 2)
    is_outer = np.arange(RCUS // 2) % 2
    order = np.concatenate([even + is_outer, even + 1 - is_outer])
    image = axis.imshow(coherence[np.ix_(order, order)], vmin=0, vmax=0.12, cmap="cividis")
    axis.set_title("coherence of the receivers")
    at, names = [RCUS // 4, 3 * RCUS // 4], ["even inner,\nodd outer", "odd inner,\neven outer"]
    axis.set_xticks(at, names)
    axis.set_yticks(at, names, rotation=90, va="center")
    axis.figure.colorbar(image, ax=axis)


def draw_edges(data: Path, axes: Any) -> None:
    read = read_edges(data)
    for axis, mhz in zip(axes, HEIGHTS_M, strict=True):
        expected = expect_edges(mhz, read["lst_h"])
        values = np.array(list(expected.values()))
        own = expected[HEIGHTS_M[mhz][1], DIRECTIONS[0]]
        axis.fill_between(read["lst_h"], values.min(0), values.max(0), color=COLOURS[2], alpha=0.25, lw=0,
                          label="our sky, dipoles of three heights and two directions")  # fmt: skip
        axis.plot(read["lst_h"], own, color=COLOURS[2], label="our sky, own height, north-south")
        axis.plot(read["lst_h"], read[f"t{mhz:.0f}_k"], "o", ms=2, color=COLOURS[0], label="EDGES, measured")
        axis.set(xlabel="local sidereal time (h)", ylabel="antenna temperature (K)", title=f"{mhz:.0f} MHz")
        axis.set(xlim=(0, 24), ylim=(0, 1.35 * values.max()))
        axis.legend()


def make_tables(data: Path) -> dict[str, list[str]]:
    hera, eda2, (spectra, instrument, _) = read_hera(data), read_eda2(data), read_rs509(data)
    return {
        "hera": tabulate_audit(audit_quietly(*hera)),
        "eda2": tabulate_audit(audit_quietly(*eda2)),
        "rs509": tabulate_audit(audit_quietly(spectra, instrument)),
        "edges": tabulate_edges(data),
    }


def main(folder: str) -> None:
    data = Path(folder)
    spectra, instrument, coherence = read_rs509(data)
    with rc_context(SETTINGS | {"xtick.top": False}):
        figures = {name: Figure(figsize=(7, 3), layout="constrained") for name in ("hera", "eda2", "rs509", "edges")}
        draw_hera(audit_quietly(*read_hera(data)), figures["hera"].subplots(1, 2, sharey=True))
        draw_levels(audit_quietly(*read_eda2(data)), figures["eda2"].subplots())
        left, right = figures["rs509"].subplots(1, 2)
        draw_levels(audit_quietly(spectra, instrument), left)
        draw_coherence(coherence, right)
        draw_edges(data, figures["edges"].subplots(1, 2))
        for name, figure in figures.items():
            figure.savefig(DOCS / "images" / f"other-{name}.png", dpi=130)
    PAGE.write_text(replace_tables(PAGE.read_text(), make_tables(data)))


if __name__ == "__main__":
    main(sys.argv[1])
