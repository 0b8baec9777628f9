"""The claims as Markdown, for the documentation."""

from __future__ import annotations

import base64
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from lbacal.files import written_beside
from lbacal.pages.report import fill_report
from lbacal_core.data.lofar import DIPOLES
from lbacal_paper.budget import Budget, compute_budget
from lbacal_paper.figures import PaperFigure, make_chain_figures, make_shower_figures
from lbacal_paper.results import (
    find_about_calibration,
    find_about_chain,
    find_about_noise,
    find_about_showers,
    find_about_sky,
    find_skies,
)
from lbacal_paper.shower_study import describe_displacements, describe_measured_sky, describe_terms, study_showers
from lbacal_paper.showers.coreas import Shower, read_coreas
from lbacal_paper.statements import (
    BY_CONSTRUCTION,
    DISAGREE,
    JUDGED,
    UNTESTED,
    describe_verdicts,
    load_statements,
    make_claims,
)
from lbacal_paper.study import make_study

BEGIN, END = "<!-- claims: written by validation/scripts/write_paper_page.py -->", "<!-- end of claims -->"


def describe_claims(claims: Sequence[Mapping[str, Any]]) -> str:
    """A table of the judged claims, why we disagree, what the untested ones need, and which hold by construction."""
    rows = [
        f"| `{one['id']}` | {one['section']} | {one['claim']} | {_published(one)} | {_ours(one)} | {one['verdict']} |"
        for one in claims
        if one["verdict"] in JUDGED
    ]
    head = ["| id | section | statement | published | ours | verdict |", "|---|---|---|---|---|---|"]
    parts = [f"**{describe_verdicts(claims)}.**", "\n".join([*head, *rows])]
    against = [f"- `{one['id']}`: {one['how'].rstrip('.')}." for one in claims if one["verdict"] == DISAGREE]
    lists = {
        "Where we disagree": against,
        "What cannot be tested here": _list_needs(claims),
        "What holds by construction": _list_by_construction(claims),
    }
    return (
        "\n\n".join([*parts, *(f"## {title}\n" + "\n".join(lines) for title, lines in lists.items() if lines)]) + "\n"
    )


def _list_needs(claims: Sequence[Mapping[str, Any]]) -> list[str]:
    """A line for each thing that is missing, the first sentence of the reasons, with the statements that need it."""
    statements: dict[str, list[str]] = {}
    for one in claims:
        if one["verdict"] == UNTESTED:
            reason = re.split(r"[;:] |\. (?=[A-Z])", one["how"])[0].rstrip(".")
            statements.setdefault(reason, []).append(f"`{one['id']}` ({one['section']}), {one['claim']}")
    return [f"- {'; '.join(several)}: {reason}." for reason, several in statements.items()]


def _list_by_construction(claims: Sequence[Mapping[str, Any]]) -> list[str]:
    names = [f"`{one['id']}`" for one in claims if one["verdict"] == BY_CONSTRUCTION]
    return [f"{', '.join(names)}."] if names else []


def insert_claims(page: str, claims: Sequence[Mapping[str, Any]]) -> str:
    """A page with the claims between its two marks written anew."""
    before, rest = page.split(BEGIN)
    return f"{before}{BEGIN}\n{describe_claims(claims)}{END}{rest.split(END)[1]}"


def _published(one: Mapping[str, Any]) -> str:
    relation = "" if one["relation"] == "equal" else f"{one['relation']} "
    return f"{relation}{one['published']:g} {one['unit']}".strip()


def _ours(one: Mapping[str, Any]) -> str:
    if one["ours"] is None:
        return "-"
    error = f" ± {one['sigma']:g}" if one["sigma"] else ""
    return f"{one['ours']:g}{error} {one['unit']}".strip()


# The whole paper redone: the one call behind `lbacal paper`.

WITHOUT_DATA = (
    "Run without --data: the comparison of sky models is that of those that ship, the spread of the receivers' gains "
    "is not tested, and figure 2 lacks the WIPL-D table. A folder with sky/*.npz, caltables/ and "
    "antenna/lba_vout.npz adds them."
)


WITHOUT_SHOWERS = (
    "Run without --showers: section 5.1 is tested on stand-in pulses, straight by construction. CoREAS showers (HDF5 "
    "or .reas), such as the three examples in the PyPI package nuradiomc, replace them."
)
BUDGET_HEADER = ("term", "published (%)", "ours, largest up to 77 MHz (%)", "above (%)")
DISPLACEMENTS = "What each calibration does to the slopes of section 5.1"
DISPLACED = (
    "calibration",
    "slope 30-58 MHz, change (1e-3/MHz)",
    "slope 62-78 MHz, change",
    "above minus below, mean",
    "in sigma",
)
TERMS = "By how much each term of today's budget moves the slopes of section 5.1"
OF_TERMS = (
    "error of the sky from",
    "term, one standard deviation",
    "slope 30-58 MHz (1e-3/MHz)",
    "slope 62-78 MHz",
    "above minus below",
)


@dataclass(frozen=True)
class Table:
    """A table of the report: cells as text."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class RedonePaper:
    """Claims as in claims.json, figures, tables, and notes on what was and was not at hand."""

    claims: Sequence[dict[str, Any]]
    figures: Sequence[PaperFigure]
    tables: Sequence[Table]
    notes: Sequence[str]


def redo_paper(
    tell: Callable[[str], None], *, antennas: int | None = None, data: Path | None = None, showers: Sequence[Path] = ()
) -> RedonePaper:
    """Compute every result and every figure.

    Parameters
    ----------
    tell
        Is called with every step before it begins.
    antennas
        Antennas of each simulated station; None for all.
    data
        A folder of measured data and models that do not ship with the package.
    showers
        CoREAS showers (HDF5, or .reas).
    """
    # BLAS threads within the threads of a fit cost twice the time
    with threadpool_limits(1):
        return _redo(tell, antennas, data, [read_coreas(path) for path in showers])


def _redo(
    tell: Callable[[str], None], antennas: int | None, data: Path | None, showers: Sequence[Shower]
) -> RedonePaper:
    study = make_study(tell, antennas)
    tell("refit with every exchange of Table 1")
    budget = compute_budget(study)
    tell("calibrate signals of showers in every way")
    signals = study_showers(study, budget, showers)
    tell("judge the statements")
    results = {
        **find_about_sky(find_skies(data), study.frequency_mhz),
        **find_about_chain(study),
        **find_about_noise(study),
        **find_about_calibration(study, budget, data),
        **find_about_showers(signals),
    }
    figures = [*make_chain_figures(study, budget, data), *make_shower_figures(study, budget, signals)]
    notes = [WITHOUT_DATA] if data is None else [f"Run with measured data and models of {data.name}/."]
    if not showers:
        notes.append(WITHOUT_SHOWERS)
    notes.append(describe_measured_sky(budget, signals))
    tables = [
        tabulate_budget(budget),
        Table(DISPLACEMENTS, DISPLACED, describe_displacements(signals)),
        Table(TERMS, OF_TERMS, describe_terms(signals)),
    ]
    return RedonePaper(make_claims(load_statements(), results), figures, tables, notes)


def tabulate_budget(budget: Budget) -> Table:
    """Table 1 of the paper, and what else was refitted."""
    published = {"sky": "11", "antenna": "2.5", "electronics": "6.5 below 77 MHz, 20 above"}
    rows = [
        [
            name,
            published.get(name, ""),
            f"{100 * budget.largest(name):.1f}",
            f"{100 * budget.largest(name, is_above=True):.1f}",
        ]
        for name in budget.terms
    ]
    total = [100 * budget.total(dipole)[budget.below_edge()].mean() for dipole in DIPOLES]
    rows.append(["total (sky, antenna, electronics)", "13 below 77 MHz", f"{max(total):.1f} on average", ""])
    return Table("Table 1: uncertainty of C", BUDGET_HEADER, rows)


# The report of `lbacal paper`: one HTML file with its figures inside.


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
