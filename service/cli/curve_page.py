"""The HTML report of an LST curve: one file with its figures inside."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment

from lbacal_core.discovery.lst_curve import CurveInvestigation
from service.cli.curve_figures import draw_change, draw_curve, draw_ranking
from service.cli.investigation_page import embed


def write_curve_page(content: dict[str, Any], found: CurveInvestigation, path: Path) -> None:
    """Write the report of `lbacal_core.discovery.curve_report.describe_curve` as a page."""
    template = (files("service.cli") / "templates/curve.html").read_text()
    figures = {
        "curve": embed(draw_curve(found, found.curve.origin)),
        "ranking": embed(draw_ranking(found)),
        "change": embed(draw_change(found)),
    }
    path.write_text(Environment(autoescape=True).from_string(template).render(report=content, **figures))
