"""The error budget of C: its table, and its terms stacked against frequency."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lbacal.pages.chart import BAND, COLOURS, LINE, Chart, Series
from lbacal.pages.curves import FREQUENCY, PERCENT, above_zero, draw_terms
from lbacal_core.curves.covariance import Budget, BudgetTerm
from lbacal_core.grids import Floats

PAPER_TOTAL = 0.13
"""Table 1 of Mulrey et al. 2019, below 77 MHz."""
SHOWN = 6
"""Frequencies of the table, from the lowest channel to the highest."""
STACKED = 5
"""Terms with a colour of their own."""


def tabulate(frequency_mhz: Floats, terms: Sequence[BudgetTerm]) -> list[list[str]]:
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


def describe_best(frequency_mhz: Floats, terms: Sequence[BudgetTerm]) -> str:
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


def draw_budget(shared: Budget, terms: Sequence[BudgetTerm]) -> list[Chart]:
    """Charts of the terms against frequency, one a polarisation, and one of how large each is over the band."""
    budget = Budget(shared.frequency_mhz, tuple(terms))
    return [*(_stack_terms(budget, polarisation) for polarisation in terms[0].vectors), draw_terms(budget)]


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
