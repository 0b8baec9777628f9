"""HTML reports of commands: one file, its style and its figures inside."""

from __future__ import annotations

import base64
import io
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader
from matplotlib.figure import Figure

from lbacal_core.errors import write_chance


def fill_report(template: str, package: str = "lbacal.cli", **content: Any) -> str:
    """A report as HTML; every template, of `package` or of this one, fills the blocks of `base.html`."""
    loader = ChoiceLoader([PackageLoader(name) for name in dict.fromkeys((package, "lbacal.cli"))])
    environment = Environment(loader=loader, autoescape=True)
    environment.filters["chance"] = write_chance
    return environment.get_template(template).render(**content)


def embed(figure: Figure) -> str:
    """The figure as a base64 PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=120)
    return base64.b64encode(buffer.getvalue()).decode()
