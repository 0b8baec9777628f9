"""`lbacal.budget`: how far C may be off, term by term, each by a refit of the same spectra."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Self

import numpy as np
from astropy import units as u
from astropy.table import QTable

from lbacal.analysis.data import spectra_of
from lbacal.analysis.instrument import Described, simulation_of
from lbacal.analysis.result import Result
from lbacal.pages.chart import BAND, COLOURS, LINE, Chart, Series
from lbacal.pages.curves import FREQUENCY, PERCENT, above_zero, draw_terms
from lbacal.pages.report import Origin, list_origin
from lbacal.with_model import Extended, read_open_terms
from lbacal_core.calibration.budget import compute_budget, measure_electronics
from lbacal_core.calibration.chain_form import compare_forms
from lbacal_core.curves.covariance import Budget, BudgetTerm
from lbacal_core.grids import Floats
from lbacal_core.simulation.prior import DEFAULT_SKY_BUDGET
from lbacal_core.sky.table import SkyPower
from lbacal_core.spectra.spectra import Spectra

PAPER_TOTAL = 0.13
"""Table 1 of Mulrey et al. 2019, below 77 MHz."""
SHOWN = 6
"""Frequencies of the table, from the lowest channel to the highest."""
STACKED = 5
"""Terms with a colour of their own."""


@dataclass(frozen=True, repr=False, kw_only=True)
class ErrorBudget(Result):
    """The systematic errors of C: the terms that all curves share, that of single antennas, and what is left open."""

    budget: Budget

    @property
    def terms(self) -> Sequence[BudgetTerm]:
        """All terms that are printed."""
        return self.budget.terms

    @classmethod
    def of(cls, budget: Budget, origin: Origin = ()) -> Self:
        """Make the result of these terms."""
        nu, terms = budget.frequency_mhz, budget.terms
        of_gain = ["C/|H| has no error of the antenna gain."] if any(term.is_of_gain for term in terms) else []
        return cls(
            title=f"budget {budget.digest}",
            rows=_tabulate(nu, terms),
            notes=[_describe_best(nu, terms), *of_gain],
            charts=partial(draw_budget, budget),
            as_table=partial(_list_sigmas, nu, terms),
            as_dict=lambda: {budget.digest: budget.as_dict()},
            origin=origin,
            budget=budget,
        )


def _list_sigmas(frequency_mhz: Floats, terms: Sequence[BudgetTerm]) -> QTable:
    """A row for each term, polarisation and channel: one standard deviation of ln C."""
    parts = [(term.name, p, np.sqrt(term.variance(p))) for term in terms for p in term.vectors]
    names, polarisations, sigma = zip(*parts, strict=True)
    columns = [np.repeat(one, frequency_mhz.size) for one in (names, polarisations)]
    columns += [np.tile(frequency_mhz, len(parts)) * u.MHz, np.concatenate(sigma)]
    return QTable(columns, names=("term", "polarisation", "frequency_mhz", "sigma"))


def budget(
    spectra: Spectra | str | Path,
    instrument: Described,
    sky_power: SkyPower | str | Path | None = None,
    sky: str = DEFAULT_SKY_BUDGET,
    left_open: Extended = None,
    *,
    tell: Callable[[str], None] = lambda _: None,
) -> ErrorBudget:
    """How far C may be off, term by term as in Table 1 of the paper; every term is a refit of these spectra.

    Parameters
    ----------
    spectra, instrument, sky_power
        As in `lbacal.fit`.
    sky
        Where the error of the sky is taken from: paper (20 %), models (seven models, 12 %), measured (absolute).
    left_open
        An `Investigation` of these data whose findings are not adopted, or its report; one of its findings, or
        ``"R.json#n"``, where that one is.
    tell
        Called with a sentence before each step.

    Examples
    --------
    >>> import lbacal
    >>> spectra = lbacal.simulate("lofar-superterp", events=100, antennas=2)
    >>> lbacal.budget(spectra, "lofar-superterp", sky="paper").save("budget.png")  # doctest: +SKIP
    """
    measured = spectra_of(spectra)
    simulation = simulation_of(instrument, sky_power).on_channels(measured.frequency_mhz).smeared(measured)
    tell("compare the forms of the chain")
    simulation = simulation.with_form(compare_forms(measured, simulation).name)
    tell("refit with each term")
    shared = compute_budget(measured, simulation, sky)
    tell("error of single antennas")
    of_antennas = measure_electronics(measured, simulation)
    terms = [*shared.terms, *([] if of_antennas is None else [of_antennas])]
    members = sorted(set(zip(measured.station.tolist(), measured.antenna.tolist(), strict=True)))
    terms += [one.for_mean_of(members, terms[0].vectors) for one in read_open_terms(left_open, "left_open")]
    return ErrorBudget.of(
        replace(shared, terms=tuple(terms)), list_origin(measured.origin, simulation, measured.time_unix)
    )


# Its table, and its terms stacked against frequency.


def _tabulate(frequency_mhz: Floats, terms: Sequence[BudgetTerm]) -> list[list[str]]:
    """Rows of cells, the head first: error of C by each term and by all, per cent, X / Y at a few frequencies."""
    at = np.unique(np.linspace(0, frequency_mhz.size - 1, SHOWN).round().astype(int))
    rows = [(term.name, {p: term.variance(p) for p in term.vectors}) for term in terms]
    total = {p: np.sum([variance[p] for _, variance in rows], axis=0) for p in rows[0][1]}
    return [
        [f"sigma(C), %, {' / '.join(total)}", *(f"{frequency_mhz[k]:g} MHz" for k in at)],
        *(
            [name, *("/".join(f"{100 * np.sqrt(v[k]):.1f}" for v in variance.values()) for k in at)]
            for name, variance in [*rows, ("total", total)]
        ),
    ]


def _describe_best(frequency_mhz: Floats, terms: Sequence[BudgetTerm]) -> str:
    """Where C is known best, beside the paper's total, and the term that keeps it from being known better."""
    variance = np.array([[term.variance(p) for p in term.vectors] for term in terms])
    at = int(np.argmin(variance.sum(axis=(0, 1))))
    here = variance[:, :, at]
    largest = int(np.argmax(here.sum(axis=1)))
    total, rest = ("/".join(f"{100 * np.sqrt(v):.1f}" for v in here.sum(axis=0) - w) for w in (0.0, here[largest]))
    return (
        f"C is known best at {frequency_mhz[at]:g} MHz, to {total} % (the paper: {PAPER_TOTAL:.0%}); the largest term "
        f"there is {terms[largest].name}, without which {rest} % would be left."
    )


def draw_budget(budget: Budget) -> list[Chart]:
    """Charts of the terms against frequency, one a polarisation, and one of how large each is over the band."""
    return [*(_stack_terms(budget, polarisation) for polarisation in budget.terms[0].vectors), draw_terms(budget)]


def _stack_terms(budget: Budget, polarisation: str) -> Chart:
    """Variances of the largest terms, and of all others together, on the scale of the deviation of what lies below."""
    ranked = sorted(budget.terms, key=lambda term: -float(np.mean(term.variance(polarisation))))
    parts = {term.name: term.variance(polarisation) for term in ranked[:STACKED]}
    if others := [term.variance(polarisation) for term in ranked[STACKED:]]:
        parts[f"{len(others)} more"] = np.sum(others, axis=0)
    ends = PERCENT * np.sqrt(np.cumsum([np.zeros(budget.frequency_mhz.size), *parts.values()], axis=0))
    series = [
        Series(BAND, budget.frequency_mhz, low=low, high=high, name=name, colour=k % len(COLOURS))
        for k, (name, low, high) in enumerate(zip(parts, ends[:-1], ends[1:], strict=True), start=1)
    ]
    series.append(Series(LINE, budget.frequency_mhz, ends[-1], name="total"))
    title, label = f"polarisation {polarisation}, added in quadrature", "systematic error of C (%)"
    return Chart(title, FREQUENCY, label, series, y_limits=above_zero(series))
