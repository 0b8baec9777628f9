"""What a command is asked to write, checked before the work is done."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from threading import Timer
from typing import Annotated, Any

import typer

from lbacal.analysis.result import IMAGES, Result
from lbacal_core.errors import BadInputError

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


FORMS = {"--report": ".json", "--html": ".html"}
"""As what these options are written, whatever the end of the name."""


def require_outputs(
    outputs: Mapping[str, Path | None], inputs: Mapping[str, str | Path | None], spectra: Sequence[Path] = ()
) -> None:
    """Refuse outputs that cannot be written or drawn, that are the same file, or that would replace an input.

    Parameters
    ----------
    outputs, inputs
        The value of each option by its name as the user wrote it (``--report``); None where it was not given. `spectra`
        are inputs too.
    """
    inputs = {**inputs, **{f"SPECTRA {file}": file for file in spectra}}
    taken = {Path(value).resolve(): option for option, value in inputs.items() if value is not None}
    for option, path in outputs.items():
        if path is None:
            continue
        if path.is_dir():
            raise BadInputError(f"{option} {path}", "a file to write", "a folder")
        if not path.parent.is_dir():
            raise BadInputError(f"{option} {path}", "a file in a folder that exists", f"no folder {path.parent}")
        if path.resolve() in taken:
            raise BadInputError(f"{option} {path}", "a file of its own", f"the file of {taken[path.resolve()]}")
        require_ending(option, path, IMAGES if option == "--plot" else (path.suffix.lower(),))
        taken[path.resolve()] = option


def require_ending(option: str, path: Path, endings: Sequence[str]) -> None:
    """Refuse a file to write whose name has none of the endings."""
    if path.suffix.lower() not in endings:
        raise BadInputError(f"{option} {path}", f"a name that ends in {', '.join(endings)}", path.suffix or "no ending")


def save_each(found: Result, outputs: Mapping[str, Path | None]) -> None:
    """Write a result to the value of each option that was given."""
    for option, path in outputs.items():
        if path is not None:
            found.save(path, FORMS.get(option))


def show(found: Any, tell: Callable[[Any], object], *, as_json: bool) -> None:
    """Print an answer in words, or as it is."""
    if as_json:
        print(json.dumps(found, indent=1, ensure_ascii=False, allow_nan=False))
    else:
        tell(found)


def show_each(found: list[Any], tell: Callable[[Any], object], nothing: str, *, as_json: bool) -> None:
    """Print the parts of an answer in words, or all of it as it is."""

    def tell_all(parts: list[Any]) -> None:
        for one in parts:
            tell(one)
        if not parts:
            print(nothing)

    show(found, tell_all, as_json=as_json)


def show_result(found: Result, lines: Sequence[str], *, as_json: bool) -> None:
    """Print a result as lines, or the report that it is saved as."""
    report = found.as_dict() if as_json and found.as_dict else None
    show(report, lambda _: print("\n".join(lines)), as_json=as_json)


PATIENCE_S = 2.0
"""Work that takes less says nothing on the way where nobody sees a bar."""


@contextmanager
def progress(steps: int | None = None) -> Iterator[Callable[..., None]]:
    """Show a bar on a terminal, elsewhere a line a step on standard error once the work takes long.

    The function that it gives takes the name of the step that begins; of many that are alike also its number and how
    many there are, of which a tenth are lines.
    """
    if not sys.stderr.isatty():
        with _print_steps() as begin_line:
            yield begin_line
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task, begun = bar.add_task("", total=steps), count()

        def begin(step: str, k: int | None = None, total: int | None = steps) -> None:
            done = next(begun) if k is None else k
            bar.update(task, completed=done, total=total, description=step, refresh=True)

        yield begin


@contextmanager
def _print_steps() -> Iterator[Callable[..., None]]:
    said: list[str] = []

    def say() -> None:
        if said:
            print(said[-1], file=sys.stderr, flush=True)

    def begin(step: str, k: int = 0, total: int = 0) -> None:
        said.append(step)
        is_due = k == total or k % max(1, total // 10) == 0 if total else not waiting.is_alive()
        if is_due:
            say()

    waiting = Timer(PATIENCE_S, say)
    waiting.start()
    try:
        yield begin
    finally:
        waiting.cancel()
