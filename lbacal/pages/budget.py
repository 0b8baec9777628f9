"""The error budget of C: its table, and its terms stacked against frequency."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from lbacal_core.curves.covariance import Budget, BudgetTerm
from lbacal_core.grids import Floats

PAPER_TOTAL = 0.13
"""Table 1 of Mulrey et al. 2019, below 77 MHz."""
SHOWN = 6
"""Frequencies of the table, from the lowest channel to the highest."""


def tabulate(frequency_mhz: Floats, terms: Sequence[BudgetTerm]) -> list[list[str]]:
    """The standard deviation of C by each term and by all together, per cent, X / Y at a few frequencies."""
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


def draw_budget(shared: Budget, terms: Sequence[BudgetTerm]) -> Figure:
    """Variances stacked against frequency, on the scale of the standard deviation of what lies below."""
    polarisations = list(terms[0].vectors)
    figure = Figure(figsize=(5.2 * len(polarisations), 5.0), layout="constrained")
    panels: Any = np.atleast_1d(figure.subplots(1, len(polarisations), sharey=True))
    for axes, polarisation in zip(panels, polarisations, strict=True):
        stack_terms(axes, shared.frequency_mhz, terms, polarisation)
    panels[0].set_ylabel("systematic error of C (%), terms added in quadrature")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, frameon=False, ncols=3, loc="outside lower center")
    return figure


def stack_terms(axes: Any, frequency_mhz: Floats, terms: Sequence[BudgetTerm], polarisation: str) -> None:
    """The variances of one polarisation on axes."""
    below = np.zeros(frequency_mhz.size)
    for k, term in enumerate(terms):
        above = below + term.variance(polarisation)
        axes.fill_between(
            frequency_mhz, 100 * np.sqrt(below), 100 * np.sqrt(above), color=f"C{k % 10}",
            alpha=0.75 if k < 10 else 0.4, lw=0, label=term.name,
        )  # fmt: skip
        below = above
    axes.plot(frequency_mhz, 100 * np.sqrt(below), color="black", lw=1.4, label="total")
    axes.set(xlabel="frequency (MHz)", title=f"polarisation {polarisation}", ylim=(0, None))
    axes.set_xlim(frequency_mhz[0], frequency_mhz[-1])
    axes.grid(alpha=0.3)
