"""Charts: what is drawn, said once: as SVG in pages (`svg.py`), with matplotlib for `.plot()`, and as numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from lbacal_core.foreign import write_instant
from lbacal_core.grids import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = ("#000000", "#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Black, vermilion, blue, green, purple, orange, sky blue of Okabe and Ito (2008); their lightness differs as well."""
INK, RED, BLUE, GREEN, PURPLE, ORANGE, SKY = range(7)
OF_DIPOLE = {"X": RED, "Y": BLUE}
STYLES = ("-", "--", ":", "-.")
NARROW, WIDE, HEIGHT = 520, 1040, 300
INCH = 105
"""Units of a chart's width and height in an inch of a printed figure."""
TITLE_PAD, LEGEND_ROW, LEGEND_COLUMNS = 6.0, 12.0, 2
"""Points between axes and title, for each row of the legend between them, and its columns."""
LINE, BAND, POINTS, BARS, SPAN, MARK, IMAGE = "line", "band", "points", "bars", "span", "mark", "image"


@dataclass(frozen=True)
class Series:
    """One part of a chart.

    Attributes
    ----------
    kind
        `line`; `band` between `low` and `high`; `points` with errors from `low` to `high`; `bars` from 0 to x in the
        rows y; `span`: from x[0] to x[1] over the whole height; `mark`: a vertical line at each x; `image`, over the
        extents x and y, coloured symmetrically about 0 up to `limit`, NaN in grey.
    style
        Dashes of a line, by its number in `STYLES`; a band of style 1 is darker.
    titles, links
        What a page shows under the pointer at each value, and where a click leads; of an image, of each of its rows.
    """

    kind: str
    x: Any
    y: Any = ()
    low: Any = None
    high: Any = None
    name: str = ""
    colour: int = INK
    style: int = 0
    titles: Sequence[str] = ()
    links: Sequence[str | None] = ()
    image: Floats | None = None
    limit: float = 1.0


@dataclass(frozen=True)
class Chart:
    """A pair of axes with what is drawn on them.

    Attributes
    ----------
    title, x_label, y_label
        With units. The title is also what somebody who does not see the figure is told.
    scales
        Scale of x and of y: `linear`, `log`, or `time`, seconds since 1970.
    x_limits, y_limits
        None: as the data need it.
    rows
        Names of the rows of bars, from the top; row k is at y = k.
    left
        Least room for the numbers of y, so that axes of time stand one below the other.
    """

    title: str
    x_label: str
    y_label: str
    series: Sequence[Series]
    scales: tuple[str, str] = ("linear", "linear")
    x_limits: tuple[float, float] | None = None
    y_limits: tuple[float, float] | None = None
    rows: Sequence[str] = ()
    width: int = NARROW
    height: int = HEIGHT
    left: float = 0.0

    def csv(self) -> str:
        """The numbers drawn: series, x, y, and the lower and upper end of bands and errors.

        An image has a row a cell, with the value behind the name of the series.
        """
        lines = [",".join(map(_quote, ("series", self.x_label, self.y_label, "low", "high")))]
        for one in self.series:
            if one.image is not None:
                (left, right), (low, high), (rows, columns) = one.x, one.y, one.image.shape
                for (j, i), value in np.ndenumerate(one.image):
                    at = left + (i + 0.5) * (right - left) / columns, low + (j + 0.5) * (high - low) / rows
                    lines.append(",".join([_quote(f"{one.name} {_write(value)}"), *map(_write, at), "", ""]))
                continue
            columns_of_y = [
                values if values is not None and len(values) else None for values in (one.y, one.low, one.high)
            ]
            for k, x in enumerate(one.x):
                at_x = write_instant(x) if self.scales[0] == "time" else _write(x)
                rest = ("" if values is None else _write(values[k]) for values in columns_of_y)
                lines.append(",".join([_quote(one.name), at_x, *rest]))
        return "\n".join(lines) + "\n"

    def draw(self, axes: Any) -> None:
        """Draw it on axes of matplotlib."""
        for one in self.series:
            _draw_series(axes, one, is_time=self.scales[0] == "time")
        is_log = {f"{name}scale": "log" for name, kind in zip("xy", self.scales, strict=True) if kind == "log"}
        axes.set(xlabel=self.x_label, ylabel=self.y_label, **is_log)
        if self.rows:
            axes.set_yticks(range(len(self.rows)), self.rows)
            axes.set_ylim(len(self.rows) - 0.4, -0.6)
        if self.x_limits is not None:
            axes.set_xlim(_positions(self.x_limits, is_time=self.scales[0] == "time"))
        if self.y_limits is not None:
            axes.set_ylim(self.y_limits)
        named = sum(bool(one.name) and one.image is None for one in self.series)
        axes.set_title(self.title, pad=TITLE_PAD + LEGEND_ROW * -(-named // LEGEND_COLUMNS))
        if named:
            look: dict[str, Any] = {"fontsize": 8, "frameon": False, "columnspacing": 1.0, "labelspacing": 0.2}
            above = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0), "borderaxespad": 0.2}
            axes.legend(ncols=LEGEND_COLUMNS, **above, **look)


def plot_charts(charts: Sequence[Chart], columns: int = 2) -> Figure:
    """Charts on one figure of matplotlib, row by row."""
    columns = max(min(columns, len(charts)), 1)
    rows = [charts[k : k + columns] for k in range(0, len(charts), columns)]
    heights = [max(chart.height for chart in row) / INCH for row in rows]
    figure: Figure = import_module("matplotlib.figure").Figure(
        figsize=(columns * NARROW / INCH, sum(heights) + 0.5), layout="constrained"
    )
    panels: Any = figure.subplots(max(len(rows), 1), columns, squeeze=False, height_ratios=heights or None)
    for axes, chart in zip(panels.ravel(), charts, strict=False):
        chart.draw(axes)
    for axes in panels.ravel()[len(charts) :]:
        axes.set_axis_off()
    return figure


def _quote(text: str) -> str:
    """A text as a cell of CSV; no spreadsheet takes it for a formula."""
    safe = f"'{text}" if text[:1] in tuple("=+-@") else text
    return '"' + safe.replace('"', '""') + '"'


def _write(value: Any) -> str:
    return "" if value is None or not math.isfinite(value) else f"{float(value):.6g}"


def _positions(x: Any, *, is_time: bool) -> Any:
    """Values of x as matplotlib takes them: dates along an axis of time."""
    values = np.asarray(x, dtype=float)
    return (values * 1e6).astype("datetime64[us]") if is_time else values


def _draw_series(axes: Any, one: Series, *, is_time: bool) -> None:
    x = _positions(one.x, is_time=is_time)
    look: dict[str, Any] = {"color": COLOURS[one.colour], "label": one.name or None}
    if one.kind == BAND:
        low, high = np.array(one.low, dtype=float), np.array(one.high, dtype=float)
        axes.fill_between(x, low, high, alpha=0.25 * (1 + one.style), lw=0, **look)
    elif one.kind == LINE:
        axes.plot(x, np.array(one.y, dtype=float), STYLES[one.style], lw=1.4, **look)
    elif one.kind == POINTS:
        y = np.array(one.y, dtype=float)
        ends = None if one.low is None else np.array([one.low, one.high], dtype=float)
        error = None if ends is None else np.abs(ends - y)
        axes.errorbar(x, y, error, fmt="o", ms=3, lw=0.9, **look)
    elif one.kind == BARS:
        axes.barh(np.asarray(one.y, dtype=float), x, **look)
    elif one.kind == SPAN:
        axes.axvspan(x[0], x[1], alpha=0.15, lw=0, **look)
    elif one.kind == MARK:
        for k, at in enumerate(x):
            axes.axvline(at, ls=STYLES[one.style], lw=0.9, **(look if k == 0 else look | {"label": None}))
    else:
        shown = axes.imshow(
            one.image, origin="lower", aspect="auto", extent=(*x, *one.y), cmap="RdBu_r",
            vmin=-one.limit, vmax=one.limit, interpolation="nearest",
        )  # fmt: skip
        axes.figure.colorbar(shown, ax=axes, label=one.name)
