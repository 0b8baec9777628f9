"""What LOFAR's measured LST curve says of two simulations of it, how far to trust that, and what else bears on it.

Needs ../shared. Nothing is tuned: the search of `lbacal investigate --lst-curve`, on curves as they were published.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from lbacal.pages.curve import name_hypothesis
from lbacal_core.data.lofar import DIPOLES
from lbacal_core.data.tables import read_columns
from lbacal_core.discovery.curve_fit import CurveFit
from lbacal_core.discovery.curve_search import CurveInvestigation, describe_curve, investigate_curve
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.lstcurve import curve as lst_curve
from lbacal_core.provenance import Provenance
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.table import SkyPower
from validation.machinery.claims import Found, exactly, measured
from validation.machinery.parts import Part, Row
from validation.machinery.tables import by
from validation.sky_models import DATA, MAPS, TABLES, WIPL, fourier_series_curve, published_tables
from validation.superterp import superterp

BAND = (30.0, 80.0)
HARMONICS = 8
"""Harmonics fitted to the published tables, 24 instants at LSTs rounded to 0.01 h; the beam leaves nothing above."""
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


def drawn_simulation(path: Path, words: str) -> lst_curve.LstCurve:
    """The curves drawn beside the measured points in the same figure: `no_noise` or `noise`."""
    read = read_columns(path)
    values, lst = {d: read[f"sim_{d.lower()}_{words}_db"] for d in DIPOLES}, read["lst_h"]
    return lst_curve.LstCurve(
        lst, values, np.full(lst.size, 0.11), 0.5, is_centre_stated=True, origin="drawn simulation"
    )


@dataclass(frozen=True)
class Question:
    """One curve asked against one simulation."""

    words: str
    curve: lst_curve.LstCurve
    sky: SkyPower
    is_own_sky: bool
    noise: lst_curve.PointNoise | None = None
    weights: str = lst_curve.AS_RECORDED
    prior: lst_curve.NoisePrior | None = None

    def ask(self, instrument: Instrument, without: str | None = None) -> CurveInvestigation:
        """Investigate as the command does."""
        return investigate_curve(
            self.curve,
            Simulation(instrument, self.sky, is_own_sky=self.is_own_sky),
            BAND,
            weights=self.weights,
            noise=self.noise,
            prior=self.prior,
            without=without,
        )


def variants(main: Question, others: Iterable[Question] = ()) -> list[Question]:
    """The same question with each choice made otherwise."""
    curve, noise = main.curve, lst_curve.estimate_noise(main.curve)
    uncorrelated = replace(noise, correlation=0.0)
    drawn = lst_curve.PointNoise(dict.fromkeys(DIPOLES, float(np.nanmedian(curve.error_db))), 0.0, noise.free)
    index = np.arange(curve.lst_hours.size)
    early = replace(curve, lst_hours=curve.lst_hours - curve.bin_hours / 2, is_centre_stated=True)

    def only(words: str, kept: np.ndarray) -> Question:
        values = {d: np.where(kept, curve.variation_db[d], np.nan) for d in DIPOLES}
        return replace(main, words=words, curve=replace(curve, variation_db=values), noise=noise)

    return [
        main,
        replace(main, words="channels weigh alike", weights=lst_curve.FLAT),
        only("every second point", index % 2 == 0),
        only("the other points", index % 2 == 1),
        only("LST 0-12 h only", curve.lst_hours < 12),
        only("LST 12-24 h only", curve.lst_hours >= 12),
        replace(main, words="noise about 4 harmonics", noise=lst_curve.estimate_noise(curve, 4)),
        replace(main, words="noise about 8 harmonics", noise=lst_curve.estimate_noise(curve, 8)),
        replace(main, words="noise of X and Y independent", noise=uncorrelated),
        replace(main, words="noise = drawn bars", noise=drawn),
        replace(main, words="lst_h is the centre of the bin", curve=early),
        *others,
    ]


def describe(fit: CurveFit) -> str:
    cells = [
        f"{name} ± {sigma * np.sqrt(fit.scale):.2f}" if sigma else name
        for name, sigma in zip(name_hypothesis(fit), fit.sigmas.tolist(), strict=True)
    ]
    return ", ".join(cells) or "nothing"


def per_point(fit: CurveFit) -> str:
    """Chi^2 per point with the estimated noise, and with the drawn bars in brackets."""
    return "{estimated:.2f} ({drawn_bars:.2f})".format(**fit.per_point)


def witnesses(instrument: Instrument, own: SkyPower, tables: SkyPower) -> list[Question]:
    """Published curves and simulations against each other, none of them the measured points."""
    known = lst_curve.PointNoise(dict.fromkeys(DIPOLES, DIGITISED_DB), 0.0, 60)
    points = DATA / "measured_lst_variation.csv"
    of_tables = published_tables(TABLES, instrument)[0]
    series = fourier_series_curve(DATA / "lst_fourier_series.csv")
    smooth = lst_curve.PointNoise(dict.fromkeys(DIPOLES, 0.05), 0.0, 60)
    drawn = "simulation drawn in the figure"
    published = lst_curve.noise_prior(instrument, BAND, lst_curve.band_weights(instrument, lst_curve.AS_RECORDED, BAND))
    silent, any_noise = replace(published, mean=0.0, sigma=0.001), replace(published, sigma=np.inf)

    def simulated(
        words: str, curve: lst_curve.LstCurve, sky: SkyPower, is_own_sky: bool, prior: lst_curve.NoisePrior
    ) -> Question:
        return Question(words, curve, sky, is_own_sky, known, prior=prior)

    quiet, noisy = (drawn_simulation(points, words) for words in ("no_noise", "noise"))
    return [
        simulated(f"{drawn}, without noise, against the tables", quiet, tables, False, silent),
        simulated(f"{drawn}, with noise, against the tables", noisy, tables, False, any_noise),
        simulated("the tables against our sky, spread of models added", of_tables, own, True, silent),
        simulated("the tables against our sky at its word", of_tables, own, False, silent),
        Question("Fourier series of the measured power, X polarization_1, against our sky", series, own, True, smooth),
    ]


def main_questions(instrument: Instrument) -> tuple[Question, Question]:
    """The measured curve against our sky, and against the published tables."""
    curve = lst_curve.read_lst_curve(lst_curve.measured_curve())
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


@cache
def own_questions() -> list[Question]:
    own, _ = main_questions(superterp())
    return variants(own, _other_skies(own, superterp()))


@cache
def tables_questions() -> list[Question]:
    """The measured curve against the published tables, and every choice made otherwise."""
    _, tables = main_questions(superterp())
    one_gain = tables_as_sky_power(TABLES, superterp(), one_gain=True)
    spread = replace(tables, words="spread of models added", is_own_sky=True)
    return variants(tables, [spread, replace(tables, words="one gain for X and Y", sky=one_gain)])


@cache
def other_questions() -> list[Question]:
    own, tables = main_questions(superterp())
    return witnesses(superterp(), own.sky, tables.sky)


def ask_one(questions: Callable[[], list[Question]], case: int) -> Row:
    question = questions()[case]
    found = question.ask(superterp())
    report, prior = describe_curve(found, Provenance({})), found.fitter.station.prior
    row: Row = {
        "words": question.words,
        "named": describe(found.last),
        "sizes": {
            label: [round(float(size), 4), round(float(sigma * np.sqrt(found.last.scale)), 4)]
            for label, size, sigma in zip(found.last.labels, found.last.sizes, found.last.sigmas, strict=True)
        },
        "noise_of_sky": [
            round(number, 4)
            for number in (found.last.noise, found.last.noise_sigma, prior.mean, prior.sigma)
            if np.isfinite(number)
        ],
        "chi2_before": per_point(found.first),
        "chi2_after": per_point(found.last),
        "verdict": report["verdict"],
    }
    if questions is not other_questions:
        row["best_without_exchange"] = per_point(question.ask(superterp(), "dipole_swap").last)
    if case == 0 and questions is not other_questions:
        noise = found.fitter.noise
        row["noise_db"] = {dipole: round(noise.sigma_db[dipole], 4) for dipole in DIPOLES}
        row["correlation"], row["points"] = round(noise.correlation, 3), found.first.points
    return row


def judge_variants(rows: Sequence[Row]) -> list[Found]:
    named = sum("dipole_swap" in row["sizes"] for row in rows) / len(rows)
    noise, sigma, *_ = rows[0]["noise_of_sky"]
    # a size whose sigma is 0 is a statement, which has no size
    sizes = [
        measured(label, size, error, rows[0]["points"]) for label, (size, error) in rows[0]["sizes"].items() if error
    ]
    exchange = exactly("exchange", named, "%", n=len(rows))
    return [exchange, *sizes, measured("noise", noise, sigma, rows[0]["points"])]


def judge_others(rows: Sequence[Row]) -> list[Found]:
    named = sum("dipole_swap" in row["sizes"] for row in rows[:2]) / 2
    zenith, sigma = rows[3]["sizes"].get("zenith_weighting", [0.0, 1.0])
    noise, noise_sigma = rows[1]["noise_of_sky"][:2]
    return [
        exactly("drawn_exchange", named, "%", n=2),
        measured("drawn_noise", noise, noise_sigma, 1),
        measured("zenith_weighting", zenith, sigma, 1),
    ]


FIXED: dict[str, Any] = {"has_chance": False, "needs_shared": True}
PARTS = (
    Part("own", partial(ask_one, own_questions), judge_variants, 16, by("words"), ("exchange",), **FIXED),
    Part("tables", partial(ask_one, tables_questions), judge_variants, 13, by("words"), **FIXED),
    Part("others", partial(ask_one, other_questions), judge_others, 5, by("words"), **FIXED),
)
