"""The report of `lbacal paper`: one HTML file with its figures inside."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from pathlib import Path

from lbacal.cli.report_pages import fill_report
from lbacal.files import written_beside
from lbacal_paper.everything import RedonePaper
from lbacal_paper.statements import describe_verdicts


def write_page(redone: RedonePaper, images: Mapping[int, bytes], path: Path) -> None:
    """Write the report; `images` are the figures as PNG."""
    figures = [
        {"content": figure, "png": base64.b64encode(images[figure.number]).decode()} for figure in redone.figures
    ]
    page = fill_report(
        "paper.html",
        "lbacal_paper",
        claims=redone.claims,
        figures=figures,
        verdicts=describe_verdicts(redone.claims),
        notes=redone.notes,
        tables=redone.tables,
    )
    with written_beside(path) as beside:
        beside.write_text(page, encoding="utf-8")
