"""What LOFAR's measured LST curve says of two simulations of it, how far to trust that, and what else bears on it.

Needs ../shared. Nothing is tuned: the search of `lbacal investigate --lst-curve`, on curves as they were published.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lbacal_core.discovery.curve_fit import CurveFit
from lbacal_core.discovery.curve_report import describe_curve
from lbacal_core.discovery.lst_curve import CurveInvestigation, best_without, investigate_curve
from lbacal_core.grids import Floats
from lbacal_core.instrument import DIPOLES, Instrument, load_instrument
from lbacal_core.lstcurve.compare import FLAT
from lbacal_core.lstcurve.curve import LstCurve, measured_curve, read_lst_curve
from lbacal_core.lstcurve.noise import PointNoise, estimate_noise
from lbacal_core.provenance import Provenance
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.skypower.table import SkyPower
from proofs.sky_models import MAPS, SHARED, TABLES, WIPL, fourier_series_curve, published_tables
from service.cli.curve_figures import draw_change, draw_curve, draw_ranking, name_hypothesis

BAND = (30.0, 80.0)
IMAGES = Path(__file__).parents[1] / "docs/images"
HARMONICS = 8
"""Of the published tables, which have 24 instants at LSTs rounded to 0.01 h; the beam leaves nothing above."""
DIGITISED_DB = 0.012
"""Noise given to curves that are drawn or computed, not measured: what two readings of the figure differ by."""


def tables_as_sky_power(path: Path, instrument: Instrument, *, one_gain: bool = False) -> SkyPower:
    """The published sky power tables as P_sky of an instrument, on a regular LST grid.

    X and Y contain the antenna gain: each channel is divided by the mean over LST of X/bare (of Y/bare for Y; with
    `one_gain` of both for both). The 24 instants are one UTC day apart in time and wrap at 24 h, so that the grid is
    not regular: a Fourier series is fitted through them.
    """
    _, tables, lst = published_tables(path, instrument)
    gain = {d: (tables[d] / tables["bare"]).mean(axis=0) for d in DIPOLES}
    if one_gain:
        gain = dict.fromkeys(DIPOLES, (gain["X"] + gain["Y"]) / 2)
    grid: Floats = np.arange(24, dtype=float)
    power = {d: _harmonics(grid) @ np.linalg.lstsq(_harmonics(lst), tables[d] / gain[d])[0] for d in DIPOLES}
    return SkyPower(instrument.frequency_mhz, grid, power, path.name)


def drawn_simulation(path: Path, words: str) -> LstCurve:
    """The curves drawn beside the measured points in the same figure: `no_noise` or `noise`."""
    with path.open() as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    lst = np.array([float(row["lst_h"]) for row in rows])
    values = {d: np.array([float(row[f"sim_{d.lower()}_{words}_db"] or "nan") for row in rows]) for d in DIPOLES}
    return LstCurve(lst, values, np.full(lst.size, 0.11), 0.5, is_centre_stated=True, origin="drawn simulation")


@dataclass(frozen=True)
class Question:
    """One curve asked against one simulation."""

    words: str
    curve: LstCurve
    sky: SkyPower
    is_own_sky: bool
    noise: PointNoise | None = None
    weights: str | None = None

    def ask(self, instrument: Instrument) -> CurveInvestigation:
        """Investigate as the command does."""
        chosen = {} if self.weights is None else {"weights": self.weights}
        return investigate_curve(
            self.curve, self.sky, instrument, BAND, is_own_sky=self.is_own_sky, noise=self.noise, **chosen
        )


def variants(main: Question, others: Iterable[Question] = ()) -> list[Question]:
    """The same question with each choice made otherwise."""
    curve, noise = main.curve, estimate_noise(main.curve)
    uncorrelated = replace(noise, correlation=0.0)
    drawn = PointNoise(dict.fromkeys(DIPOLES, float(np.nanmedian(curve.error_db))), 0.0, noise.free)
    index = np.arange(curve.lst_hours.size)
    early = replace(curve, lst_hours=curve.lst_hours - curve.bin_hours / 2, is_centre_stated=True)

    def only(words: str, kept: np.ndarray) -> Question:
        values = {d: np.where(kept, curve.variation_db[d], np.nan) for d in DIPOLES}
        return replace(main, words=words, curve=replace(curve, variation_db=values), noise=noise)

    return [
        main,
        replace(main, words="channels weigh alike", weights=FLAT),
        only("every second point", index % 2 == 0),
        only("the other points", index % 2 == 1),
        only("LST 0-12 h only", curve.lst_hours < 12),
        only("LST 12-24 h only", curve.lst_hours >= 12),
        replace(main, words="noise about 4 harmonics", noise=estimate_noise(curve, 4)),
        replace(main, words="noise about 8 harmonics", noise=estimate_noise(curve, 8)),
        replace(main, words="noise of X and Y independent", noise=uncorrelated),
        replace(main, words="noise = drawn bars", noise=drawn),
        replace(main, words="lst_h is the centre of the bin", curve=early),
        *others,
    ]


def describe(fit: CurveFit) -> str:
    """The causes of a set with sizes and errors."""
    cells = [
        f"{name} ± {sigma * np.sqrt(fit.scale):.2f}"
        for name, sigma in zip(name_hypothesis(fit), fit.sigmas.tolist(), strict=True)
    ]
    return ", ".join(cells) or "nothing"


def per_point(fit: CurveFit) -> str:
    """Chi^2 per point with the estimated noise, and with the drawn bars in brackets."""
    return f"{fit.chi2 / fit.points:.2f} ({fit.chi2_drawn / fit.points:.2f})"


def robustness_table(questions: list[Question], instrument: Instrument) -> tuple[list[str], bool]:
    """One row a variant, and whether every one names the exchange of the letters."""
    lines = [
        "| choice | named | chi2 per point before | after | best of up to 3 causes without an exchange | verdict |",
        "|---|---|---|---|---|---|",
    ]
    is_always = True
    for question in questions:
        found = question.ask(instrument)
        report = describe_curve(found, Provenance({}))
        rival = best_without(found, instrument, "exchange")
        is_always &= "dipole_swap" in [finding["cause"] for finding in report["findings"]]
        cells = [question.words, describe(found.last), per_point(found.first), per_point(found.last)]
        lines.append("| " + " | ".join([*cells, per_point(rival), report["verdict"]]) + " |")
    return lines, is_always


def hypotheses_table(found: CurveInvestigation) -> list[str]:
    """What the report says of every hypothesis: chi^2, whether it is excluded, and what it would do to C."""
    lines = [
        "| hypothesis | chi2 per point (drawn bars) | standing | C of X at 30, 55, 80 MHz | C of Y |",
        "|---|---|---|---|---|",
    ]
    decide = {}
    for one in describe_curve(found, Provenance({}))["hypotheses"]:
        names = [
            f"{cause['cause']} {cause['parameters'].get('source', '')} "
            f"{cause['parameters'].get('fraction_of_mean_sky_power', cause['size']['value']):.2f}"
            for cause in one["causes"]
        ]
        change = [
            ", ".join(f"{100 * one['calibration_change'][d]['at_mhz'][nu]:+.1f} %" for nu in ("30", "55", "80"))
            for d in DIPOLES
        ]
        decide |= {cause["cause"]: cause["would_decide"] for cause in one["causes"]}
        points = one["chi2_per_point"]
        cells = [", ".join(names), f"{points['estimated']:.2f} ({points['drawn_bars']:.2f})", one["standing"]]
        lines.append("| " + " | ".join([*cells, *change]).replace("  ", " ") + " |")
    return [*lines, "", "What would decide: " + "; ".join(f"{name}: {what}" for name, what in decide.items()) + "."]


def witnesses(instrument: Instrument, own: SkyPower, tables: SkyPower) -> list[Question]:
    """Published curves and simulations against each other, none of them the measured points."""
    known = PointNoise(dict.fromkeys(DIPOLES, DIGITISED_DB), 0.0, 60)
    points = SHARED / "measured_lst_variation.csv"
    of_tables = published_tables(TABLES, instrument)[0]
    series = fourier_series_curve(SHARED / "lst_fourier_series.csv")
    smooth = PointNoise(dict.fromkeys(DIPOLES, 0.05), 0.0, 60)
    drawn = "simulation drawn in the figure"
    return [
        Question(
            f"{drawn}, without noise, against the tables", drawn_simulation(points, "no_noise"), tables, False, known
        ),
        Question(f"{drawn}, with noise, against the tables", drawn_simulation(points, "noise"), tables, False, known),
        Question("the tables against our sky, spread of models added", of_tables, own, True, known),
        Question("the tables against our sky at its word", of_tables, own, False, known),
        Question("Fourier series of the measured power, X polarization_1, against our sky", series, own, True, smooth),
    ]


def main_questions(instrument: Instrument) -> tuple[Question, Question]:
    """The measured curve against our sky, and against the published tables."""
    curve = read_lst_curve(measured_curve())
    own = Question("(a) our own sky, spread of models added", curve, compute_sky_power(instrument), True)
    tables = Question("(b) published tables at their word", curve, tables_as_sky_power(TABLES, instrument), False)
    return own, tables


def _harmonics(lst_hours: Floats) -> Floats:
    angle = 2 * np.pi / 24.0 * np.outer(lst_hours, np.arange(1, HARMONICS + 1))
    return np.concatenate([np.ones((angle.shape[0], 1)), np.cos(angle), np.sin(angle)], axis=1)


def _other_skies(main: Question, instrument: Instrument) -> list[Question]:
    models = (
        ("GSM locked to 408 MHz", compute_sky_power(instrument, str(MAPS[0]))),
        ("LFSM", compute_sky_power(instrument, str(MAPS[1]))),
        ("antenna WIPL-D", compute_sky_power(instrument, antenna=str(WIPL))),
        ("LFSM, antenna WIPL-D", compute_sky_power(instrument, str(MAPS[1]), str(WIPL))),
    )
    at_word = replace(main, words="our sky at its word", is_own_sky=False)
    return [at_word, *(replace(main, words=words, sky=sky) for words, sky in models)]


def prove(arguments: list[str]) -> tuple[bool, list[str]]:
    """Both investigations, their hypotheses, every choice made otherwise, and what other publications say."""
    if arguments:
        return False, ["takes no arguments"]
    if not SHARED.is_dir():
        return False, ["needs the folder ../shared beside the project"]
    instrument = load_instrument("lofar-superterp")
    own, tables = main_questions(instrument)
    found_own, found_tables = own.ask(instrument), tables.ask(instrument)
    draw_curve(found_own, "Measured LOFAR curve against our sky").savefig(IMAGES / "measured-own.png", dpi=110)
    draw_curve(found_tables, "Measured LOFAR curve against the published tables").savefig(
        IMAGES / "measured-tables.png", dpi=110
    )
    draw_ranking(found_own).savefig(IMAGES / "measured-ranking.png", dpi=110)
    draw_change(found_own).savefig(IMAGES / "measured-change.png", dpi=110)
    own_rows, own_holds = robustness_table(variants(own, _other_skies(own, instrument)), instrument)
    spread = replace(tables, words="spread of models added", is_own_sky=True)
    gain = replace(tables, words="one gain for X and Y", sky=tables_as_sky_power(TABLES, instrument, one_gain=True))
    tables_rows, tables_holds = robustness_table(variants(tables, [spread, gain]), instrument)
    noise = found_own.noise
    level = f"noise X {noise.sigma_db['X']:.3f} dB, Y {noise.sigma_db['Y']:.3f} dB, correlated by"
    lines = [
        f"{found_own.first.points} points; {level} {noise.correlation:.2f} ({noise.free} degrees of freedom).",
        "Chi2 per point with the estimated noise, in brackets with the drawn bars.",
        "",
        *own_rows,
        "",
        *tables_rows,
        "",
        *(
            f"Best without an exchange, {words}: {describe(best_without(found, instrument, 'exchange'))}."
            for words, found in (("(a)", found_own), ("(b)", found_tables))
        ),
        "",
        "Hypotheses, measured curve against our sky:",
        "",
        *hypotheses_table(found_own),
        "",
        "Hypotheses, measured curve against the published tables:",
        "",
        *hypotheses_table(found_tables),
        "",
        "Other publications, by the same search:",
        "",
        "| curve and simulation | named | chi2 per point before | after |",
        "|---|---|---|---|",
    ]
    for question in witnesses(instrument, own.sky, tables.sky):
        found = question.ask(instrument)
        cells = [question.words, describe(found.last), per_point(found.first), per_point(found.last)]
        lines.append("| " + " | ".join(cells) + " |")
    return own_holds and tables_holds, lines
