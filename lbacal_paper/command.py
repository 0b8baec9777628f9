"""`lbacal paper`: every figure and every quantitative statement of the paper, redone."""

from __future__ import annotations

import csv
import json
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from lbacal.cli.main import app
from lbacal_core.errors import BadInputError

DPI = 200


@app.command()
def paper(
    output: Annotated[Path, typer.Option(help="Folder to write; it is made if it does not exist.")],
    data: Annotated[
        Path | None,
        typer.Option(
            help="Folder of measured data and models that do not ship (sky/, antenna/, caltables/): tests more."
        ),
    ] = None,
    showers: Annotated[
        list[Path] | None,
        typer.Option(help="CoREAS shower (HDF5, or .reas with its folder); may be given several times."),
    ] = None,
    antennas: Annotated[int, typer.Option(help="Antennas of each simulated station.", min=4, max=48)] = 48,
) -> None:
    """Redo the paper: report.html, claims.json, and figures 1-9 as PDF and PNG with their numbers as CSV.

    Example: lbacal paper --output paper

    Every statement is judged: agree, disagree, undecided, or cannot be tested here, with what is missing.
    """
    from lbacal_paper.everything import redo_paper, write_page
    from lbacal_paper.statements import describe_verdicts

    if data is not None and not data.is_dir():
        raise BadInputError(f"--data {data}", "a folder", "none")
    if output.exists() and not output.is_dir():
        raise BadInputError(f"--output {output}", "a folder", "a file")
    output.mkdir(parents=True, exist_ok=True)
    began = time.monotonic()

    def tell(step: str) -> None:
        print(f"{time.monotonic() - began:5.1f} s  {step}", flush=True)

    redone = redo_paper(tell, antennas=antennas, data=data, showers=showers or ())
    tell("draw the figures and write the report")
    (output / "claims.json").write_text(json.dumps(redone.claims, indent=1, allow_nan=False, ensure_ascii=False) + "\n")
    images = {}
    for figure in redone.figures:
        images[figure.number] = _write_figure(figure, output)
    for number, table in enumerate(redone.tables, start=1):
        _write_table(table, output / f"table-{number}.csv")
    write_page(redone, images, output / "report.html")
    print(f"{describe_verdicts(redone.claims)}; wrote {output / 'report.html'}, claims.json and {len(images)} figures")


def _write_table(table: Any, path: Path) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(table.header)
        writer.writerows(table.rows)


def _write_figure(figure: Any, output: Path) -> bytes:
    """Write one figure as PDF, PNG and CSV; returns the PNG."""
    from lbacal_paper.figures import draw

    name = output / f"figure-{figure.number}"
    drawn = draw(figure)
    drawn.savefig(name.with_suffix(".pdf"), metadata={"CreationDate": None})
    drawn.savefig(name.with_suffix(".png"), dpi=DPI)
    name.with_suffix(".csv").write_text(figure.as_csv(), encoding="utf-8")
    return name.with_suffix(".png").read_bytes()
