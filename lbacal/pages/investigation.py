"""The HTML report of an investigation: one file, made of the values of its report alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from lbacal.pages.chart import Chart
from lbacal.pages.finding import draw_finding, draw_scores
from lbacal.pages.report import fill_report


def draw_page(content: Mapping[str, Any], source: str = "spectra", instrument: str = "") -> str:
    """The report of `lbacal_core.discovery.report.investigate` as a page.

    Parameters
    ----------
    source, instrument
        Names of the file of the spectra and of the instrument.
    """
    provenance = content["provenance"]
    made_from = [*provenance.get("notes", {}).items(), *provenance["inputs"].items()]
    made_from += [(name, str(provenance[name])) for name in ("model_version", "lbacal") if name in provenance]
    made_from = [("spectra of", source), *([("instrument", instrument)] if instrument else []), *made_from]
    return fill_report("investigation.html", report=content, made_from=made_from, source=source)


def plot_finding(finding: Mapping[str, Any], on: Any = None) -> Figure:
    """The course of a finding and its law along frequency; what matters most of it on axes, if they are given."""
    shown = [chart for name, chart in draw_finding(finding).items() if name in ("course", "law", "against")]
    if on is None:
        return plot_charts(shown)
    shown[0].draw(on)
    figure: Figure = on.figure
    return figure


def plot_charts(charts: Sequence[Chart]) -> Figure:
    """Charts side by side."""
    figure = Figure(figsize=(9.5, 3.4), layout="constrained")
    panels: Any = figure.subplots(1, len(charts), squeeze=False)[0]
    for chart, axes in zip(charts, panels, strict=True):
        chart.draw(axes)
    return figure


def plot_scores(content: Mapping[str, Any], on: Any = None) -> Figure:
    """The best scores of the causes in the first station; on axes if they are given."""
    chart = draw_scores(next(iter(content["scores"].values())))
    axes: Any = on or Figure(figsize=(9.5, 0.27 * len(chart.rows) + 1.2), layout="constrained").subplots()
    chart.draw(axes)
    figure: Figure = axes.figure
    return figure
