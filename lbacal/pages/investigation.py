"""The HTML report of an investigation: one file, made of the values of its report alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

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
