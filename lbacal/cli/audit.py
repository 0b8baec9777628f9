"""`lbacal audit`: what is wrong with a station, in seconds."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lbacal.cli.outputs import require_outputs

if TYPE_CHECKING:
    from lbacal_core.instrument.instrument import Instrument
    from lbacal_core.spectra.spectra import Spectra

EXIT_WRONG = 3
"""Exit code when something is wrong with a station: the work was done, so neither 1 nor 2."""


def audit(
    data: Annotated[Path, typer.Argument(help="Spectra file, or data in any format of `lbacal import`.")],
    instrument: Annotated[str, typer.Option(help="Instrument: a name such as lofar-superterp, or a JSON file.")],
    report: Annotated[Path | None, typer.Option(help="Report to write (JSON).")] = None,
    html: Annotated[Path | None, typer.Option(help="Page to write, with figures.")] = None,
    sky: Annotated[str | None, typer.Option(help="Sky model that a working station sees: a name, or a file.")] = None,
    antenna: Annotated[str | None, typer.Option(help="Antenna model: a name, or a file.")] = None,
    average: Annotated[float, typer.Option(help="Seconds to average, for data that are no spectra file.")] = 900.0,
) -> None:
    """Check a station: dead, deaf, oscillating or outlying paths, exchanged dipoles, cables, clock, arms, place, unit.

    Example: lbacal audit S.h5 --instrument lofar-superterp --report audit.json --html audit.html

    Minutes of data find what differs from antenna to antenna; clock, arms, place and unit need hours of sidereal
    time. Exit 0 if nothing is wrong, 3 if something is.
    """
    from lbacal_core.audit.audit import audit as audit_spectra
    from lbacal_core.instrument.instrument import load_instrument

    require_outputs({"--report": report, "--html": html}, {"DATA": data, "--instrument": instrument})
    chain = load_instrument(instrument)
    spectra = _read(data, chain, average)
    found = audit_spectra(spectra, chain, sky, antenna)
    for station in found.stations:
        print(f"{station.name}: {station.antennas.size} antennas, {station.hours:.2f} h of sidereal time")
    for line in found.lines:
        odds = "" if line.log_odds is None else f" (ln odds {line.log_odds:+.0f})"
        print(f"{line.verdict:9} {line.check:12} {line.station}: {line.sentence}{odds}")
    if report is not None:
        report.write_text(json.dumps(found.as_dict(), indent=1, allow_nan=False))
    if html is not None:
        from lbacal.pages.audit import draw_page

        html.write_text(draw_page(found, data.name), encoding="utf-8")
    wrong = [line for line in found.lines if line.verdict == "wrong"]
    print(f"{len(wrong)} wrong" if wrong else "nothing wrong")
    if wrong:
        raise typer.Exit(EXIT_WRONG)


def _read(data: Path, chain: Instrument, average_s: float) -> Spectra:
    """Spectra from their file, or averaged from another format to the channels of the instrument."""
    import h5py

    from lbacal_core.readers.open import choose_channels, open_source
    from lbacal_core.readers.source import average
    from lbacal_core.readers.statistics import is_statistics
    from lbacal_core.spectra.spectra import read_spectra

    is_hdf5 = data.is_file() and data.suffix != ".uvh5" and (data.suffix in (".h5", ".hdf5") or h5py.is_hdf5(data))
    if is_hdf5 and not is_statistics(data):
        return read_spectra(data)
    source = open_source(data)
    return average(source, average_s, choose_channels(source, chain)).spectra
