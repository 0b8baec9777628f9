"""What every verb returns: a result prints, is drawn, shows itself in a notebook, and is saved."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lbacal.files import path_of, write_json, written_beside
from lbacal.pages.chart import Chart, plot_charts
from lbacal.tables import escape_texts
from lbacal_core.errors import BadInputError

if TYPE_CHECKING:
    from astropy.table import QTable
    from matplotlib.figure import Figure

    from lbacal.pages.report import Origin

Row = Sequence[str]
Writer = Callable[[Path], object]
IMAGES = (".png", ".pdf", ".svg")
TABLES = {".ecsv": "ascii.ecsv", ".csv": "ascii.csv", ".fits": "fits", ".h5": "hdf5", ".hdf5": "hdf5"}
"""What astropy calls the format of a table, by the end of its name."""


@dataclass(frozen=True, repr=False, kw_only=True)
class Result:
    """The result of a function of `lbacal`.

    Attributes
    ----------
    title
        What it is, in a few words.
    rows
        The head and the rows that are printed.
    words
        How many of their columns are words, from the first on; the others are numbers.
    notes
        What else there is to know, a sentence each.
    told
        The lines that are printed, where these are not the rows and the notes.
    charts, main
        Make all that there is to see; and what matters most, where that is not the first of them.
    columns
        How many of the charts stand beside each other in a figure.
    as_table, as_dict, page
        Make a table of its numbers, with units; its content as JSON values; an HTML page. None where there is none.
    origin
        What it was made from, by name.
    more
        What writes it in further formats, by the end of a name.
    fallback
        As which it is written into what is no file, such as /dev/stdout.
    """

    title: str
    rows: Sequence[Row]
    charts: Callable[[], Iterable[Chart]]
    main: Callable[[], Chart] | None = None
    columns: int = 2
    words: int = 1
    notes: Sequence[str] = ()
    told: Sequence[str] | None = None
    as_table: Callable[[], QTable] | None = None
    as_dict: Callable[[], Mapping[str, Any]] | None = None
    page: Callable[[], str] | None = None
    origin: Origin = ()
    more: Mapping[str, Writer] = field(default_factory=dict)
    fallback: str = ".json"

    @cached_property
    def table(self) -> QTable:
        """The numbers of the result with units."""
        if self.as_table is None:
            raise AttributeError(f"{type(self).__name__} has no table")
        return self.as_table()

    @property
    def lines(self) -> list[str]:
        """The rows and the notes as lines of text."""
        return [*align(self.rows, self.words), *self.notes] if self.told is None else list(self.told)

    def plot(self, ax: Any = None) -> Figure:
        """All that there is to see as a figure; or what matters most, on axes of matplotlib."""
        if ax is None:
            return plot_charts(list(self.charts()), self.columns)
        if not hasattr(ax, "fill_between"):
            raise BadInputError("plot", "axes of matplotlib (save(path) writes a file)", type(ax).__name__)
        chart = self.main() if self.main else next(iter(self.charts()), None)
        if chart is not None:  # a report made before it carried figures has none
            chart.draw(ax)
        figure: Figure = ax.figure
        return figure

    def save(self, path: str | Path, form: str | None = None) -> None:
        """Write it in the format that the end of the name says, or `form`; what was there stays if that fails."""
        writers: dict[str, Writer] = {}
        if (content := self.as_dict) is not None:
            writers[".json"] = lambda out: write_json(content(), out)
        if self.as_table is not None:
            writers |= {suffix: partial(self._write_table, kind=kind) for suffix, kind in TABLES.items()}
        writers |= {
            **self.more,
            ".html": self._write_page,
            **dict.fromkeys(IMAGES, lambda out: self.plot().savefig(out, dpi=150)),
        }
        file = path_of("save", path)
        if file.is_dir():
            raise BadInputError(f"save {path}", "a file to write", "a folder")
        is_stream = file.exists() and not file.is_file()
        suffix = form or (self.fallback if is_stream else file.suffix.lower())
        if suffix not in writers:
            raise BadInputError(f"save {path}", f"a name that ends in {', '.join(writers)}", suffix or "no ending")
        with written_beside(file) as beside:
            writers[suffix](beside)

    def _write_page(self, path: Path) -> None:
        from lbacal.pages.report import fill_report

        own: dict[str, Any] = {"title": self.title, "rows": self.rows, "notes": self.notes, "made_from": self.origin}
        page = self.page() if self.page else fill_report("result.html", **own, charts=self.charts())
        path.write_text(page, encoding="utf-8")

    def _write_table(self, path: Path, kind: str) -> None:
        """Write the numbers."""
        table = self.table.copy()
        if kind in ("fits", "hdf5"):
            escape_texts(table)
        table.write(path, format=kind, **({"path": "table", "serialize_meta": True} if kind == "hdf5" else {}))

    def __repr__(self) -> str:
        """The title and the lines."""
        return "\n".join([f"<{type(self).__name__} {self.title}>", *self.lines])

    def _repr_html_(self) -> str:
        """A table for notebooks, and the notes."""
        head, *rows = ("".join(f"<td>{escape(cell)}</td>" for cell in row) for row in self.rows)
        body = "".join(f"<tr>{cells}</tr>" for cells in [head.replace("td>", "th>"), *rows])
        notes = "".join(f"<p>{escape(note)}</p>" for note in self.notes)
        return f"<p>{escape(self.title)}</p><table>{body}</table>{notes}"


def align(rows: Sequence[Sequence[str]], words: int = 1) -> list[str]:
    """The rows as lines of equal columns, words flush left and numbers flush right.

    Parameters
    ----------
    words
        How many columns are words, from the first on.
    """
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    cells = (
        [cell.ljust(widths[k]) if k < words else cell.rjust(widths[k]) for k, cell in enumerate(row)] for row in rows
    )
    return ["  ".join(line).rstrip() for line in cells]
