"""The HTML report of an LST curve: one file with its figures inside."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lbacal.cli.curve_figures import draw_change, draw_curve, draw_ranking
from lbacal.cli.report_pages import embed, fill_report
from lbacal.files import written_beside
from lbacal_core.discovery.curve_search import CurveInvestigation


def write_curve_page(content: dict[str, Any], found: CurveInvestigation, path: Path) -> None:
    """Write the report of `lbacal_core.discovery.curve_search.describe_curve` as a page."""
    figures = {
        "curve": embed(draw_curve(found, found.fitter.curve.origin)),
        "ranking": embed(draw_ranking(found)),
        "change": embed(draw_change(found)),
    }
    with written_beside(path) as beside:
        beside.write_text(fill_report("curve.html", report=content, **figures), encoding="utf-8")
