"""A figure as data: what is drawn and what stands in its CSV file are the same numbers."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from lbacal_core.grids import Floats

LINE, POINTS, BAND, BOXES = "line", "points", "band", "boxes"
KINDS = (LINE, POINTS, BAND, BOXES)
OURS, PUBLISHED, OTHER = "ours", "published", "other"
ORIGINS = (OURS, PUBLISHED, OTHER)


@dataclass(frozen=True)
class Series:
    """One curve, set of points or band.

    Attributes
    ----------
    name
        As it stands in the legend.
    x, y
        Shape (point,).
    low, high
        Shape (point,): the ends of error bars or of a band; None where there are none.
    kind
        One of `KINDS`.
    origin
        `OURS` was computed here, `PUBLISHED` is a number of the paper, `OTHER` a third thing that `name` states.
    group
        Series of one group share a colour: X with X, one noise term with itself.
    """

    name: str
    x: Floats
    y: Floats
    low: Floats | None = None
    high: Floats | None = None
    kind: str = LINE
    origin: str = OURS
    group: str = ""

    def __post_init__(self) -> None:
        for values in (self.y, self.low, self.high):
            if values is not None and values.shape != self.x.shape:
                raise ValueError(f"series {self.name}: {values.shape} values at {self.x.shape} places")
        if self.kind not in KINDS or self.origin not in ORIGINS:
            raise ValueError(f"series {self.name}: {self.kind}, {self.origin}")


@dataclass(frozen=True)
class Panel:
    """One pair of axes; `notes` are texts at (x, y) in it, `diagonal` draws y = x."""

    x_label: str
    y_label: str
    series: Sequence[Series]
    title: str = ""
    is_log: bool = False
    diagonal: bool = False
    vertical: Sequence[float] = ()
    notes: Sequence[tuple[float, float, str]] = field(default=())


@dataclass(frozen=True)
class PaperFigure:
    """One figure of the paper with ours beside it."""

    number: int
    title: str
    caption: str
    panels: Sequence[Panel]

    def as_csv(self) -> str:
        """Every drawn number: panel, series, origin, x, y, low, high."""
        buffer = io.StringIO()
        for line in (self.title, self.caption):
            buffer.write(f"# {line}\n")
        writer = csv.writer(buffer, lineterminator="\n")
        writer.writerow(["panel", "x_label", "y_label", "series", "origin", "x", "y", "low", "high"])
        for number, panel in enumerate(self.panels, start=1):
            for one in panel.series:
                for k in range(one.x.size):
                    ends = ["" if end is None else _cell(end[k]) for end in (one.low, one.high)]
                    head = [number, panel.x_label, panel.y_label, one.name, one.origin]
                    writer.writerow([*head, _cell(one.x[k]), _cell(one.y[k]), *ends])
        return buffer.getvalue()


def _cell(value: float) -> str:
    return f"{value:.8g}" if np.isfinite(value) else ""
