"""The HTML report of an investigation: one file, made of the values of its report alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lbacal.pages.report import Origin, fill_report, list_origin


def draw_page(content: Mapping[str, Any], origin: Origin = ()) -> str:
    """The report of `lbacal_core.discovery.report.investigate` as a page."""
    made_from = origin or list_origin("spectra", provenance=content["provenance"])
    return fill_report("investigation.html", report=content, made_from=made_from, source=dict(made_from)["file"])
