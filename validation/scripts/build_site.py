"""Build the site of the documentation: the pages of docs/, the notebooks with what they give, the API, a gallery.

    .venv/bin/python validation/scripts/build_site.py [--without-notebooks]

The site is in var/site/html; a link that leads nowhere ends the build.
"""

from __future__ import annotations

import argparse
import logging
import os
import re
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import nbformat
from mkdocs.commands.build import build
from mkdocs.config import load_config
from nbclient import NotebookClient
from nbconvert import MarkdownExporter
from nbformat.v4 import new_code_cell

HERE = Path(__file__).resolve().parents[2]
DOCS, PAGES = HERE / "docs", HERE / "var/site/pages"
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s#]+)(#[^)\s]*)?\)")
TIGHT = re.compile(r"^(?!- |\* |\d+\. |\||>|#| ).+\n(?=- |\d+\. |\|)", re.MULTILINE)
"""The end of a paragraph that a list or a table follows at once: on the site they need an empty line between them."""
INDEX = re.compile(r"(```.*?```|`[^`]*`)|\]\[", re.DOTALL)
"""Code, or the indices of an array in prose, which are no reference to another page."""
FIRST = ["README.md", {"First hour": "notebooks/first-hour.md"}]
FOLDERS = ["notebooks", "tutorials", "how-to", "explanation", "formats"]
LAST = ["reference", "commands", "settings", "causes", "logbook", "glossary", "gallery", "validation"]
TASKS = {
    "Calibrate": ("fit.fit", "fit.Calibration", "budget.budget", "audit.audit"),
    "Question the simulation": (
        "investigate.investigate",
        "investigate.Investigation",
        "investigate.Finding",
        "lst_curve.lst_curve",
    ),
    "Predict": ("predict.predict", "predict.Prediction"),
    "Data and instruments": (
        "data.read",
        "data.import_data",
        "data.simulate",
        "instrument.Instrument",
        "instrument.Antenna",
        "instrument.Site",
    ),
    "Ask the service": ("life.life",),
}
"""What `lbacal.analysis` offers, by task; beside it chains and the client."""
ELSEWHERE = {"Data and instruments": ("chain.Chain", "chain.Stage"), "Ask the service": ("client.Client",)}
SECONDS = 300


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--without-notebooks", action="store_true", help="show their code and do not run it")
    chosen = parser.parse_args(arguments)
    logging.basicConfig(level=logging.WARNING, format="%(message)s")  # what ends the build
    shutil.rmtree(PAGES, ignore_errors=True)
    shutil.copytree(DOCS, PAGES, ignore=shutil.ignore_patterns("notebooks"))
    for notebook in sorted((DOCS / "notebooks").glob("*.ipynb")):
        print(f"{notebook.relative_to(HERE)}", flush=True)
        write_notebook(notebook, is_run=not chosen.without_notebooks)
    for page in sorted(PAGES.rglob("*.md")):
        text = TIGHT.sub(lambda end: f"{end[0]}\n", page.read_text(encoding="utf-8"))
        text = INDEX.sub(lambda one: one[1] or r"]\[", text)
        page.write_text(keep_inside(text, page.parent), encoding="utf-8")
    pictures = sorted((DOCS / "images").glob("*.png"))
    gallery = (f"## {one.stem.replace('-', ' ')}\n![]({one.relative_to(DOCS)})\n" for one in pictures)
    (PAGES / "gallery.md").write_text("\n".join(["# Gallery\n", *gallery]), encoding="utf-8")
    (PAGES / "reference.md").write_text("\n".join(list_reference()), encoding="utf-8")
    menu = [*FIRST, *(list_pages(folder) for folder in FOLDERS), *(f"{page}.md" for page in LAST)]
    config = load_config(str(HERE / "mkdocs.yml"), nav=menu, strict=True)
    build(config)


def keep_inside(text: str, folder: Path) -> str:
    """The text of a page without links to what is not on the site; a link to a folder leads to its index."""

    def write(link: re.Match[str]) -> str:
        picture, words, target, anchor = link[1], link[2], link[3], link[4] or ""
        if "://" in target:
            return link[0]
        place = (folder / target).resolve()
        if not place.is_relative_to(PAGES) or (place.is_dir() and not (place / "README.md").exists()):
            return words
        target = re.sub(r"\.ipynb$", ".md", target.rstrip("/"))
        return f"{picture}[{words}]({target}{'/README.md' if place.is_dir() else ''}{anchor})"

    return LINK.sub(write, text)


def write_notebook(notebook: Path, *, is_run: bool) -> None:
    """The page of a notebook with its outputs, and the notebook itself to be fetched."""
    read, folder = nbformat.read(notebook, as_version=4), PAGES / "notebooks"
    read.cells.insert(0, new_code_cell("%matplotlib inline"))
    folder.mkdir(exist_ok=True)
    if is_run:
        os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        NotebookClient(read, timeout=SECONDS, kernel_name="python3", resources={"metadata": {"path": folder}}).execute()
    nbformat.write(read, folder / notebook.name)
    del read.cells[0]
    body, files = MarkdownExporter().from_notebook_node(read, {"unique_key": notebook.stem})
    for name, picture in files["outputs"].items():
        (folder / name).write_bytes(picture)
    fetch = f"\n[The notebook]({notebook.stem}.ipynb)\n"
    (folder / f"{notebook.stem}.md").write_text(body + fetch, encoding="utf-8")


def list_reference() -> Iterator[str]:
    """The lines of the page of the API."""
    yield "# The API by task\n"
    for task, names in TASKS.items():
        yield f"## {task}\n"
        yield from (f"::: lbacal.analysis.{name}\n" for name in names)
        yield from (f"::: lbacal.{name}\n" for name in ELSEWHERE.get(task, ()))


def list_pages(folder: str) -> dict[str, list[str]]:
    """The part of the menu with the pages of a folder, its index first."""
    pages = sorted((PAGES / folder).glob("*.md"), key=lambda page: (page.name != "README.md", page.name))
    return {folder.replace("-", " ").capitalize(): [str(page.relative_to(PAGES)) for page in pages]}


if __name__ == "__main__":
    main(sys.argv[1:])
