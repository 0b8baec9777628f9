"""HTML reports of commands: one file, its style and its figures inside."""

from __future__ import annotations

from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader

from lbacal.pages.finding import FILTERS
from lbacal_core.errors import write_chance


def fill_report(template: str, package: str = "lbacal.pages", **content: Any) -> str:
    """A report as HTML; every template, of `package` or of this one, fills the blocks of `base.html`."""
    loader = ChoiceLoader([PackageLoader(name) for name in dict.fromkeys((package, "lbacal.pages"))])
    environment = Environment(loader=loader, autoescape=True)
    environment.filters |= {"chance": write_chance, **FILTERS}
    return environment.get_template(template).render(**content)
