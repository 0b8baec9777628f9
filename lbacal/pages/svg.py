"""A chart as SVG: classes and no style (`templates/figures.css` has the colours), no script, a title at each value."""

from __future__ import annotations

import base64
import math
import struct
import zlib
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
from markupsafe import Markup, escape

from lbacal.pages.chart import BAND, BARS, IMAGE, NARROW, POINTS, SPAN, Chart, Series
from lbacal_core.grids import DAY_S, Floats

LETTER, ROW = 6.6, 16.0
"""Width of a letter and height of a line of text in `figures.css`, 12 px."""
RIGHT, TOP, BOTTOM, FOR_COLOURS = 14.0, 10.0, 42.0, 64.0
TICKS, APART = 5, 90
"""Steps along an axis, about; and the least distance between two dates."""
DASHES = ("", ' stroke-dasharray="6 3"', ' stroke-dasharray="2 3"', ' stroke-dasharray="8 3 2 3"')
DEPTH = {IMAGE: 0, SPAN: 1, BAND: 2}
"""What is drawn below everything else."""
Place = tuple[float, float]


def draw_svg(chart: Chart) -> Markup:
    """The chart as an element of a page."""
    return Markup(_Drawing(chart).draw())  # noqa: S704 - all text in it was escaped


class _Drawing:
    def __init__(self, chart: Chart) -> None:
        self.chart, self.parts = chart, list[str]()
        self.x = _Scale(chart.scales[0], chart.x_limits or _limits(chart, 0))
        self.y = _Scale(chart.scales[1], chart.y_limits or _limits(chart, 1))
        shown = list(chart.rows) or [text for _, text in self.y.ticks(chart.height)]
        self.left = max(26 + LETTER * max(map(len, shown), default=1), chart.left)
        self.right = chart.width - RIGHT - FOR_COLOURS * any(one.kind == IMAGE for one in chart.series)
        legend = list(_lay_out_legend(chart.series, self.right - self.left))
        self.top, self.bottom = TOP + ROW * (1 + max((row for row, _, _ in legend), default=-1)), chart.height - BOTTOM
        self.x.room, self.y.room = (self.left, self.right), (self.bottom, self.top)
        self._draw_axes()
        for one in sorted(chart.series, key=lambda one: DEPTH.get(one.kind, 3)):
            getattr(self, f"_{one.kind}")(one)
        for row, at, one in legend:
            self._name(one, self.left + at, TOP + ROW * row + 4)

    def draw(self) -> str:
        chart, inside = self.chart, "".join(self.parts)
        role = "group" if "<a " in inside else "img"
        box = '<div class="figure wide" tabindex="0">' if chart.width > NARROW else '<div class="figure">'
        ends = "" if self.x.kind != "time" else ' data-time="{:.0f} {:.0f} {:.4f} {:.4f}"'.format(
            *self.x.limits, self.left / chart.width, self.right / chart.width
        )  # fmt: skip
        size = f'viewBox="0 0 {chart.width} {chart.height}" role="{role}" aria-label="{escape(chart.title)}"'
        return f"{box}<svg {size}{ends}>{inside}</svg></div>"

    def _path(self, kind: str, d: str, one: Series | None = None, k: int | None = None) -> None:
        """A path; of value k of a series with its title and link."""
        look = kind if one is None else f'{kind} c{one.colour}"{DASHES[one.style]}'
        end = '"' if one is None else ""
        self._add(f'<path class="{look}{end} d="{d}"', "path", one, k)

    def _add(self, begin: str, element: str, one: Series | None, k: int | None) -> None:
        title = escape(one.titles[k]) if one is not None and k is not None and one.titles else ""
        drawn = f"{begin}><title>{title}</title></{element}>" if title else f"{begin}/>"
        link = one.links[k] if one is not None and k is not None and one.links else None
        self.parts.append(f'<a href="{escape(link)}">{drawn}</a>' if link else drawn)

    def _text(self, x: float, y: float, text: Any, kind: str = "") -> None:
        look = f' class="{kind}"' if kind else ""
        self.parts.append(f'<text{look} x="{x:.1f}" y="{y:.1f}">{escape(text)}</text>')

    def _draw_axes(self) -> None:
        chart = self.chart
        for value, text in self.x.ticks(self.right - self.left):
            self._path("grid", f"M{self.x.at(value):.1f} {self.bottom:.1f}V{self.top:.1f}")
            is_last = self.x.at(value) + 0.5 * LETTER * len(text) > chart.width
            self._text(
                chart.width if is_last else self.x.at(value), self.bottom + 15, text, "end" if is_last else "mid"
            )
        for value, text in list(enumerate(chart.rows)) or self.y.ticks(chart.height):
            if not chart.rows:
                self._path("grid", f"M{self.left:.1f} {self.y.at(value):.1f}H{self.right:.1f}")
            self._text(self.left - 5, self.y.at(value) + 4, text, "end")
        self._path("frame", f"M{self.left:.1f} {self.top:.1f}V{self.bottom:.1f}H{self.right:.1f}")
        self._text((self.left + self.right) / 2, chart.height - 8, chart.x_label, "mid")
        turned = f'transform="translate(12 {(self.top + self.bottom) / 2:.0f}) rotate(-90)"'
        self.parts.append(f'<text class="mid" {turned}>{escape(chart.y_label)}</text>')

    def _name(self, one: Series, x: float, y: float) -> None:
        if one.kind == POINTS:
            self.parts.append(f'<circle class="dot c{one.colour}" cx="{x + 9:.1f}" cy="{y:.1f}" r="3"/>')
        elif one.kind in (BAND, SPAN, BARS):
            self._path(one.kind, f"M{x:.1f} {y - 4:.1f}h18v8h-18z", one)
        else:
            self._path("line", f"M{x:.1f} {y:.1f}h18", one)
        self._text(x + 23, y + 4, one.name)

    def _places(self, x: Any, y: Any) -> list[Place | None]:
        """Places on the paper; None where there is no value, or none between the ends of the axis."""
        return [
            (self.x.at(a), self.y.at(b)) if b is not None and math.isfinite(b) and self.x.has(a) else None
            for a, b in zip(x, y, strict=True)
        ]

    def _line(self, one: Series) -> None:
        places = self._places(one.x, one.y)
        self._path("line", "".join(map(_join, _split(places))), one)
        for k, place in enumerate(places if one.titles else ()):
            if place is not None:
                self._add(f'<circle class="hover" cx="{place[0]:.1f}" cy="{place[1]:.1f}" r="6"', "circle", one, k)

    def _band(self, one: Series) -> None:
        low, high = self._places(one.x, one.low), self._places(one.x, one.high)
        both = [None if a is None or b is None else (a, b) for a, b in zip(low, high, strict=True)]
        for run in _split(both):
            self._path("band", _join([*(b for _, b in run), *(a for a, _ in reversed(run))]) + "z", one)

    def _points(self, one: Series) -> None:
        low, high = one.y if one.low is None else one.low, one.y if one.high is None else one.high
        ends = zip(self._places(one.x, low), self._places(one.x, high), strict=True)
        for k, (place, (a, b)) in enumerate(zip(self._places(one.x, one.y), ends, strict=True)):
            if place is not None and a is not None and b is not None and a != b:
                self._path("error", f"M{a[0]:.1f} {a[1]:.1f}V{b[1]:.1f}", one)
            if place is not None:
                circle = f'<circle class="dot c{one.colour}" cx="{place[0]:.1f}" cy="{place[1]:.1f}" r="3.2"'
                self._add(circle, "circle", one, k)

    def _bars(self, one: Series) -> None:
        zero = self.x.at(0.0 if self.x.kind == "linear" else min(self.x.limits))
        for k, (x, y) in enumerate(zip(one.x, one.y, strict=True)):
            self._path("bars", f"M{zero:.1f} {self.y.at(y) - 6:.1f}H{self.x.at(x):.1f}v12H{zero:.1f}z", one, k)

    def _span(self, one: Series) -> None:
        first, last = (self.x.at(x) for x in one.x)
        if last > first:
            self._path("span", f"M{first:.1f} {self.bottom:.1f}H{last:.1f}V{self.top:.1f}H{first:.1f}z", one, 0)

    def _mark(self, one: Series) -> None:
        for k, x in enumerate(one.x):
            if self.x.has(x):
                self._path("mark", f"M{self.x.at(x):.1f} {self.bottom:.1f}V{self.top:.1f}", one, k)

    def _image(self, one: Series) -> None:
        (left, right), (low, high) = map(self.x.at, one.x), map(self.y.at, one.y)
        if one.image is not None:
            top, rows = min(low, high), one.image[::-1]
            self._paint(left, top, right - left, abs(low - high), rows, one.limit)
        for k in range(len(one.links)):
            top, bottom = self.y.at(k - 0.5), self.y.at(k + 0.5)
            self._path("row", f"M{left:.1f} {top:.1f}H{right:.1f}V{bottom:.1f}H{left:.1f}z", one, k)
        bar, height = self.right + 8, self.bottom - self.top
        self._paint(bar, self.top, 10, height, np.linspace(one.limit, -one.limit, 65)[:, None], one.limit)
        for share, text in ((0.0, f"+{one.limit:.2g}"), (0.5, "0"), (1.0, f"-{one.limit:.2g}")):
            self._text(bar + 14, self.top + 10 + share * (height - 10), f"{text} {one.name}")

    def _paint(self, x: float, y: float, width: float, height: float, values: Floats, limit: float) -> None:
        place = f'x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}"'
        look = 'preserveAspectRatio="none" image-rendering="pixelated"'
        self.parts.append(f'<image {place} {look} href="{_write_png(values, limit)}"/>')


def _join(run: Sequence[Place]) -> str:
    return "".join(f"{'L' if k else 'M'}{x:.1f} {y:.1f}" for k, (x, y) in enumerate(run))


def _split(places: Sequence[Any]) -> Iterator[list[Any]]:
    """The stretches without a gap."""
    run: list[Any] = []
    for place in [*places, None]:
        if place is not None:
            run.append(place)
        elif run:
            yield run
            run = []


def _lay_out_legend(series: Sequence[Series], room: float) -> Iterator[tuple[int, float, Series]]:
    """Row, place in it, and series of every name, each once."""
    row, at = 0, 0.0
    for one in {one.name: one for one in series if one.name and one.kind != IMAGE}.values():
        width = 36 + LETTER * len(one.name)
        if at and at + width > room:
            row, at = row + 1, 0.0
        yield row, at, one
        at += width


def _limits(chart: Chart, along: int) -> tuple[float, float]:
    """The range of the values along x (0) or y (1)."""
    if along == 1 and chart.rows:
        return len(chart.rows) - 0.4, -0.6
    is_log = chart.scales[along] == "log"
    values = [0.0] if along == 0 and chart.rows and not is_log else []
    for one in chart.series:
        for part in [one.x] if along == 0 else [one.y, one.low, one.high]:
            known = (float(v) for v in (() if part is None else part) if v is not None and math.isfinite(v))
            values += [value for value in known if value > 0 or not is_log]
    low, high = min(values, default=0.1 if is_log else 0.0), max(values, default=1.0)
    if is_log:
        return low / 1.2, high * 1.2
    if low == high:
        low, high = low - 0.5 * (abs(low) or 1.0), high + 0.5 * (abs(high) or 1.0)
    air = 0.05 * (high - low) if along == 1 or chart.rows else 0.0
    return (low - air if low else 0.0), (high + air if high else 0.0)


class _Scale:
    """Values to places along one side of the paper."""

    def __init__(self, kind: str, limits: tuple[float, float]) -> None:
        self.kind, self.limits, self.room = kind, limits, (0.0, 1.0)

    def has(self, value: float) -> bool:
        low, high = sorted(self.limits)
        return low <= value <= high

    def at(self, value: float) -> float:
        """The place of a value, or the nearest end of the axis."""
        low, high = self.limits
        value = min(max(value, min(self.limits)), max(self.limits))
        if self.kind == "log":
            low, high, value = math.log(low), math.log(high), math.log(value)
        return self.room[0] + (value - low) / (high - low) * (self.room[1] - self.room[0])

    def ticks(self, length: float) -> list[tuple[float, str]]:
        low, high = sorted(self.limits)
        if self.kind == "time":
            return list(_ticks_of_time(low, high, length / APART))
        if self.kind == "log":
            fine = (1, 2, 5) if high > 10 * low else (1, 1.5, 2, 3, 4, 5, 7)
            steps, decades = (1,) if high > 1000 * low else fine, range(math.floor(math.log10(low)), 99)
            every = (factor * 10.0**k for k in decades if 10.0**k <= high for factor in steps)
            return [(value, f"{value:g}") for value in every if low <= value <= high]
        rough = (high - low) / TICKS
        decade = 10.0 ** math.floor(math.log10(rough))
        step = next(factor * decade for factor in (1, 2, 5, 10) if factor * decade >= 0.999 * rough)
        digits = max(0, -math.floor(math.log10(step) + 1e-9))
        numbers = range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
        return [(k * step, f"{k * step:.{digits}f}" if digits < 5 else f"{k * step:.3g}") for k in numbers]


def _ticks_of_time(low: float, high: float, most: float) -> Iterator[tuple[float, str]]:
    """Beginnings of years, months or days."""
    if high - low < 60 * DAY_S:
        step = max(math.ceil((high - low) / DAY_S / most), 1)
        for day in range(math.ceil(low / DAY_S), math.floor(high / DAY_S) + 1, step):
            yield day * DAY_S, f"{datetime.fromtimestamp(day * DAY_S, UTC):%Y-%m-%d}"
        return
    first, last = (12 * at.year + at.month - 1 for at in (datetime.fromtimestamp(one, UTC) for one in (low, high)))
    step = next((one for one in (1, 2, 3, 6, 12, 24, 60) if (last - first) / one <= most), 120)
    for month in range(first - first % step, last + 1, step):
        at = datetime(month // 12, month % 12 + 1, 1, tzinfo=UTC).timestamp()
        if low <= at <= high:
            yield at, f"{month // 12}" if step >= 12 else f"{month // 12}-{month % 12 + 1:02d}"


BELOW, ZERO, ABOVE, UNKNOWN = (
    np.array(one, dtype=float) for one in ((0, 90, 170), (247,) * 3, (180, 60, 0), (150,) * 3)
)
"""Blue, white and vermilion are told apart by the colour-blind."""


def _write_png(values: Floats, limit: float) -> str:
    """An image with a value a pixel as a data URL (PNG, ISO/IEC 15948)."""
    share = np.clip(np.nan_to_num(values) / limit, -1.0, 1.0)[..., None]
    colours = ZERO + np.abs(share) * (np.where(share < 0, BELOW, ABOVE) - ZERO)
    pixels = np.where(np.isfinite(values)[..., None], colours, UNKNOWN).astype(np.uint8)
    head = struct.pack(">IIBBBBB", pixels.shape[1], pixels.shape[0], 8, 2, 0, 0, 0)
    body = zlib.compress(b"".join(b"\0" + row.tobytes() for row in pixels), 9)
    png = b"\x89PNG\r\n\x1a\n"
    for name, content in ((b"IHDR", head), (b"IDAT", body), (b"IEND", b"")):
        png += struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))
    return f"data:image/png;base64,{base64.b64encode(png).decode()}"
