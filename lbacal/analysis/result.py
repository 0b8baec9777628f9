"""What every verb returns: a result prints, is drawn, shows itself in a notebook, and is saved."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lbacal.files import written_beside
from lbacal.pages.tables import align
from lbacal_core.errors import BadInputError

if TYPE_CHECKING:
    from astropy.table import QTable
    from matplotlib.figure import Figure

Row = Sequence[str]
Writer = Callable[[Path], object]
IMAGES = (".png", ".pdf", ".svg")
TABLES = {".ecsv": "ascii.ecsv", ".csv": "ascii.csv", ".fits": "fits", ".h5": "hdf5", ".hdf5": "hdf5"}
"""What astropy calls the format of a table, by the end of its name."""


class Result(ABC):
    """What a verb found: a title, rows of text below a head, notes and a figure.

    Attributes
    ----------
    words
        How many columns of the rows are words, from the first on; the others are numbers.
    fallback
        As which it is written into what is no file, such as /dev/stdout.
    """

    words = 1
    fallback = ".json"

    @property
    @abstractmethod
    def title(self) -> str:
        """What it is, in a few words."""

    @property
    @abstractmethod
    def rows(self) -> Sequence[Row]:
        """The head and the rows that are printed."""

    @property
    def notes(self) -> Sequence[str]:
        """What else there is to know, a sentence each."""
        return ()

    @abstractmethod
    def draw(self) -> Figure:
        """Everything there is to see."""

    @abstractmethod
    def draw_on(self, axes: Any) -> None:
        """What matters most."""

    def page(self) -> str:
        """An HTML page."""
        from lbacal.pages.report import embed, fill_report

        return fill_report("result.html", title=self.title, rows=self.rows, notes=self.notes, figure=embed(self.draw()))

    @property
    def lines(self) -> list[str]:
        """The rows and the notes as lines of text."""
        return [*align(self.rows, self.words), *self.notes]

    def plot(self, ax: Any = None) -> Figure:
        """All that there is to see as a figure; or what matters most, on axes of matplotlib."""
        if ax is None:
            return self.draw()
        self.draw_on(ax)
        figure: Figure = ax.figure
        return figure

    def writers(self) -> dict[str, Writer]:
        """What writes it, by the end of a name."""
        return {
            ".html": lambda path: path.write_text(self.page(), encoding="utf-8"),
            **dict.fromkeys(IMAGES, lambda path: self.draw().savefig(path, dpi=150)),
        }

    def save(self, path: str | Path) -> None:
        """Write it in the format that the end of the name says; a file of that name is replaced when all went well."""
        file, writers = Path(path), self.writers()
        is_stream = file.exists() and not file.is_file()
        suffix = self.fallback if is_stream else file.suffix.lower()
        if suffix not in writers:
            raise BadInputError(f"save {path}", f"a name that ends in {', '.join(writers)}", suffix or "no ending")
        with written_beside(file) as beside:
            writers[suffix](beside)

    def __repr__(self) -> str:
        """The title and the lines."""
        return "\n".join([f"<{type(self).__name__} {self.title}>", *self.lines])

    def _repr_html_(self) -> str:
        """A table for notebooks, and the notes."""
        head, *rows = ("".join(f"<td>{escape(cell)}</td>" for cell in row) for row in self.rows)
        body = "".join(f"<tr>{cells}</tr>" for cells in [head.replace("td>", "th>"), *rows])
        notes = "".join(f"<p>{escape(note)}</p>" for note in self.notes)
        return f"<p>{escape(self.title)}</p><table>{body}</table>{notes}"


class TabledResult(Result):
    """A result that has its numbers as a table too, and its content as JSON values."""

    @property
    @abstractmethod
    def table(self) -> QTable:
        """Its numbers with units."""

    @abstractmethod
    def as_dict(self) -> Mapping[str, Any]:
        """Its content as JSON values."""

    def writers(self) -> dict[str, Writer]:
        """JSON, tables, and what every result is written as."""
        return {
            ".json": self._write_json,
            **{suffix: partial(self._write_table, kind=kind) for suffix, kind in TABLES.items()},
            **super().writers(),
        }

    def _write_json(self, path: Path) -> None:
        path.write_text(json.dumps(self.as_dict(), indent=1, allow_nan=False) + "\n", encoding="utf-8")

    def _write_table(self, path: Path, kind: str) -> None:
        """Write the numbers. FITS and HDF5 hold ASCII: other characters are written as escapes."""
        table = self.table
        for name in table.colnames if kind in ("fits", "hdf5") else ():
            if table[name].dtype.kind == "U":
                table[name] = np.char.encode(np.asarray(table[name]), "ascii", "backslashreplace")
        table.write(path, format=kind, **({"path": "table"} if kind == "hdf5" else {}))
