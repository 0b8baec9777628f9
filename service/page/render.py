"""Fill the templates; every page is complete without script, which adds polling, and zooming by the pointer."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cache
from importlib.resources import files
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from lbacal.instants import format_instant
from lbacal.pages.chart import Chart
from lbacal.pages.finding import FILTERS
from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.drift.members import name_members, split_by_size
from lbacal_core.errors import name_path, write_chance, write_change, write_percent
from service.errors import NotFoundError
from service.page import charts
from service.page.charts import EVERYTHING
from service.usecases.gate import tell_shapes, tell_size

# Files of the page under names that hold their hash: a browser may keep them for ever, and never shows an old one.

_FILES = {"page.css": "text/css", "page.js": "text/javascript", "icon.svg": "image/svg+xml"}


@dataclass(frozen=True)
class Asset:
    """One file as it is served."""

    name: str
    content: bytes
    media_type: str

    @property
    def url(self) -> str:
        """The address of the file, which changes with its content."""
        return f"/static/{hashlib.sha256(self.content).hexdigest()[:16]}/{self.name}"


@cache
def load_assets() -> dict[str, Asset]:
    """All files of the page by name."""
    folder = files("service.page") / "static"
    found = {name: Asset(name, folder.joinpath(name).read_bytes(), media) for name, media in _FILES.items()}
    shared = (files("lbacal.pages") / "templates/figures.css").read_bytes()
    return found | {"page.css": replace(found["page.css"], content=shared + found["page.css"].content)}


def find_asset(digest: str, name: str) -> Asset:
    """Find a file by its address."""
    asset = load_assets().get(name)
    if asset is None or asset.url != f"/static/{digest}/{name}":
        raise NotFoundError(f"no file /static/{digest}/{name}")
    return asset


@dataclass(frozen=True)
class Figure:
    """A chart on a page, the address of its numbers, and that of the page with another scale of y, if there is one."""

    chart: Chart
    csv: str
    other: str = ""
    scale: str = ""


SHORT_DAYS = 10.0
"""Fewer days are written with a digit behind the point."""


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=ChoiceLoader([PackageLoader("service.page"), PackageLoader("lbacal.pages")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"day": format_day, "moment": format_moment, "percent": format_percent, "scope": name_scope}
    environment.filters["days"] = lambda days: f"{days:.1f}" if days < SHORT_DAYS else f"{days:.0f}"
    environment.filters |= {"short": lambda text: text[:10], "chance": write_chance, "change": write_change}
    environment.filters |= {
        "members": name_members,
        "shapes": tell_shapes,
        "sizes": split_by_size,
        "amount": tell_size,
        **FILTERS,
    }
    environment.filters |= {"whose": charts.name_members, "address": charts.address_of}
    environment.globals["assets"] = {name: asset.url for name, asset in load_assets().items()}
    return environment


_DEFAULTS = {"span": EVERYTHING, "q": "", "leave": None, "address_here": "/"}


def render_page(name: str, **content: Any) -> bytes:
    """Render a page as HTML."""
    return render_part(name, **content).encode()


def render_part(name: str, **content: Any) -> str:
    """A page, or the part of one that a template puts in as it is, as HTML."""
    return _TABLE.sub(_name_cells, _environment().get_template(name).render(**{**_DEFAULTS, **content}))


_TABLE = re.compile(r"<table>\s*<thead>(.*?)</thead>(.*?)</table>", re.DOTALL)


def _name_cells(table: re.Match[str]) -> str:
    """Give every cell the name of its column, which a narrow screen shows beside it instead of a head."""
    names = [re.sub(r"<[^>]*>", "", one) for one in re.findall(r"<th[^>]*>(.*?)</th>", table[1], re.DOTALL)]
    rows = re.split(r"(?=<tr)", table[2])
    for k, row in enumerate(rows):
        cells = re.split(r"(?=<td)", row)
        if len(cells) == len(names) + 1:
            named = (f'<td data-name="{name}"{cell[3:]}' for name, cell in zip(names, cells[1:], strict=True))
            rows[k] = cells[0] + "".join(named)
    return f'<table class="fold"><thead>{table[1]}</thead>{"".join(rows)}</table>'


def format_day(instant: Instant | None) -> str:
    """The date of an instant; an open end in words."""
    return "further notice" if instant is None else format_instant(instant)[:10]


def format_moment(instant: Instant) -> str:
    """Write an instant to the second, such as 2014-05-01 00:00:00, UTC."""
    return datetime.fromtimestamp(instant // 1_000_000, UTC).strftime("%Y-%m-%d %H:%M:%S")


def format_percent(fraction: float | None, digits: int = 1) -> str:
    """Write a signed change in percent."""
    return "" if fraction is None else write_percent(fraction, digits)


def name_scope(scope: Scope) -> str:
    """Name a scope in words."""
    return name_path(*scope.parts)
