"""HTML reports of commands: one file, its style and its figures inside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader

from lbacal.pages.finding import FILTERS
from lbacal_core.errors import write_chance
from lbacal_core.foreign import write_instant
from lbacal_core.grids import Floats
from lbacal_core.simulation.simulation import Simulation

Origin = Sequence[tuple[str, str]]
"""What a report was made from, by name."""


def fill_report(template: str, package: str = "lbacal.pages", **content: Any) -> str:
    """A report as HTML; every template, of `package` or of this one, fills the blocks of `base.html`."""
    loader = ChoiceLoader([PackageLoader(name) for name in dict.fromkeys((package, "lbacal.pages"))])
    environment = Environment(loader=loader, autoescape=True)
    environment.filters |= {"chance": write_chance, **FILTERS}
    return environment.get_template(template).render(**content)


def list_origin(
    file: str,
    simulation: Simulation | None = None,
    time_unix: Floats | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> Origin:
    """File, dates, instrument, sky and version behind a report, with what its provenance says."""
    stated = provenance or {}
    rows = {"file": file}
    if time_unix is not None and time_unix.size:
        rows["dates"] = " to ".join(write_instant(at)[:10] for at in (time_unix.min(), time_unix.max()))
    if simulation is not None:
        rows |= {
            "instrument": simulation.instrument.name,
            "sky_power": simulation.sky_power.note_for(simulation.instrument),
        }
    rows |= stated.get("notes", {})
    rows |= {f"sha256 of {name}": digest for name, digest in stated.get("inputs", {}).items()}
    rows |= {name: str(stated[name]) for name in ("model_version",) if name in stated}
    return [*rows.items(), ("lbacal", str(stated.get("lbacal", version("lbacal"))))]


def draw_investigation(content: Mapping[str, Any], origin: Origin = (), headline: str = "") -> str:
    """The report of `lbacal_core.discovery.report.investigate` as a page, whose headline is its verdict or another."""
    made_from = origin or list_origin("spectra", provenance=content["provenance"])
    headline = headline or content["verdict"]
    return fill_report("investigation.html", report=content, made_from=made_from, headline=headline)
