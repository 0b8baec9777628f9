"""Options that several commands have, each with one type and one help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

SpectraFiles = Annotated[list[Path], typer.Argument(help="Spectra files (HDF5, lbacal-spectra-1), or folders of them.")]
InstrumentName = Annotated[str, typer.Option(help="Instrument: a name such as lofar-superterp, or a JSON file.")]
SkyPowerFile = Annotated[
    Path | None, typer.Option(help="P_sky(LST, nu) file (JSON); without it the package's own sky and antenna.")
]
Since = Annotated[str | None, typer.Option(help="First instant of the events to use, ISO 8601, UTC.")]
Until = Annotated[str | None, typer.Option(help="End of the events to use, not included.")]
Year = Annotated[int | None, typer.Option(help="One calendar year, in the place of both.", min=2009, max=9998)]
Stations = Annotated[list[str] | None, typer.Option(help="Station to use; may be given several times.")]
Dask = Annotated[str | None, typer.Option(help="Address of a dask scheduler, or local; LBACAL_DASK by default.")]
Json = Annotated[bool, typer.Option("--json", help="Print the answer as JSON.")]
Band = Annotated[tuple[float, float], typer.Option(help="First and last channel of the band, MHz.")]
