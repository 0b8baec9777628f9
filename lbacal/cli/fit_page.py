"""The page of a fit: its table, its figure, and the error of C for one event."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from lbacal.cli.fit_summary import MOST_ROWS, explain_chi2, tabulate_curves
from lbacal.cli.report_pages import embed, fill_report
from lbacal_core.curves.covariance import Budget
from lbacal_core.curves.curves import FitReport


def draw_page(report: FitReport, figure: Figure, source: str, sentences: Sequence[str]) -> str:
    """The report as one HTML file.

    Parameters
    ----------
    sentences
        What the command printed beside its table; the first is the error of C.
    """
    rows = tabulate_curves(report.curves)
    every = [] if len(report.curves) <= MOST_ROWS else [
        row for curve in report.curves for row in tabulate_curves([curve])[1:]
    ]  # fmt: skip
    return fill_report(
        "fit.html",
        source=source,
        sentences=list(sentences),
        header=rows[0],
        rows=rows[1:],
        every=every,
        chi2=explain_chi2(report.curves),
        figure=embed(figure),
        terms=[_describe_terms(budget) for budget in report.budgets.values()],
        notes=report.provenance.notes,
        inputs=report.provenance.inputs,
    )


def _describe_terms(budget: Budget) -> dict[str, object]:
    """Rows of the budget: name, largest standard deviation of C in per cent for each polarisation, source."""
    rows = [
        [term.name, " / ".join(f"{100 * float(term.variance(p).max()) ** 0.5:.1f}" for p in term.vectors), term.source]
        for term in budget.terms
    ]
    return {"digest": budget.digest, "rows": rows, "polarisations": " / ".join(budget.terms[0].vectors)}
