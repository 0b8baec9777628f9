"""What a command is asked to write, checked before the work is done."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from lbacal.analysis.result import IMAGES
from lbacal_core.errors import BadInputError


def require_outputs(outputs: Mapping[str, Path | None], inputs: Mapping[str, str | Path | None]) -> None:
    """Refuse outputs that cannot be written, that are the same file, or that would replace an input.

    Parameters
    ----------
    outputs, inputs
        The value of each option by its name as the user wrote it (``--report``); None where it was not given.
    """
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
        taken[path.resolve()] = option


def require_image(plot: Path | None) -> None:
    """Refuse a figure in a form that cannot be drawn."""
    if plot is not None and plot.suffix.lower() not in IMAGES:
        raise BadInputError(f"--plot {plot}", f"a name that ends in {', '.join(IMAGES)}", plot.suffix or "no ending")


# A bar on the terminal while a command works; nothing where standard error is a file or a pipe.


@contextmanager
def progress(steps: int) -> Iterator[Callable[[str], None]]:
    """A bar of some steps; the function that it gives takes the name of the next step."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        BarColumn(),
        TextColumn("{task.completed}/{task.total}"),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task("", total=steps)
        begun = 0

        def begin(step: str) -> None:
            nonlocal begun
            bar.update(task, completed=begun, description=step, refresh=True)
            begun += 1

        yield begin
