"""Figures of the paper as matplotlib draws them, in the style of every printed figure.

Published curves are dashed, ours solid.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from lbacal.cli.report_pages import COLOURS, MARKERS, SETTINGS
from lbacal_paper.figures import BAND, BOXES, LINE, OTHER, PUBLISHED, Panel, PaperFigure, Series

WIDTHS = (1.6, 1.2, 1.2, 1.2, 1.2, 1.2, 1.2)
DASHES: dict[str, Any] = {"ours": "-", PUBLISHED: (0, (5, 2)), OTHER: (0, (1, 1.2))}
LEGEND_ROOM = 4.0
"""Space above the curves of a logarithmic panel, a factor."""
PANEL_INCHES = (3.5, 3.0)


def draw(content: PaperFigure) -> Any:
    """The figure as matplotlib draws it, without a display."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(SETTINGS):
        width, height = PANEL_INCHES
        is_schematic = [any(one.kind == BOXES for one in panel.series) for panel in content.panels]
        if any(is_schematic):
            figure = Figure(figsize=(2 * width, 1.4 * height), layout="constrained")
            axes = figure.subplots(len(content.panels), 1, squeeze=False, height_ratios=[1, 3]).ravel()
        else:
            figure = Figure(figsize=(width * len(content.panels), height), layout="constrained")
            axes = figure.subplots(1, len(content.panels), squeeze=False).ravel()
        for panel, at, has_boxes in zip(content.panels, axes, is_schematic, strict=True):
            if has_boxes:
                _draw_boxes(at, panel.series)
            else:
                _draw_panel(at, panel)
    return figure


def _draw_panel(axes: Any, panel: Panel) -> None:
    groups = list(dict.fromkeys(one.group or one.name for one in panel.series))
    for one in panel.series:
        # matplotlib leaves names that begin with an underscore out of the legend
        place = groups.index(one.group or one.name) % len(COLOURS)
        _draw_series(axes, one, COLOURS[place], MARKERS[place], WIDTHS[place])
    for x in panel.vertical:
        axes.axvline(x, color="0.5", lw=0.7, ls=":")
    if panel.diagonal:
        axes.axline((0.0, 0.0), slope=1.0, color="0.5", lw=0.7)
    for x, y, text in panel.notes:
        axes.annotate(text, (x, y), fontsize=6.5)
    axes.set_xlabel(panel.x_label)
    axes.set_ylabel(panel.y_label)
    if panel.is_log:
        axes.set_yscale("log")
        axes.set_ylim(top=LEGEND_ROOM * axes.get_ylim()[1])
    if panel.title:
        axes.set_title(panel.title, fontsize=8)
    axes.legend(ncols=2 if len(panel.series) > 8 else 1)


def _draw_series(axes: Any, one: Series, colour: str, marker: str, width: float) -> None:
    if one.kind == BAND:
        hatch = "////" if one.origin == PUBLISHED else None
        axes.fill_between(
            one.x, one.low, one.high, facecolor=colour, alpha=0.18, lw=0, hatch=hatch, edgecolor=colour, label=one.name
        )
    elif one.kind == LINE:
        if one.low is not None:
            axes.fill_between(one.x, one.low, one.high, color=colour, alpha=0.35, lw=0)
        axes.plot(
            one.x, one.y, color=colour, lw=width, ls=DASHES[one.origin], label=one.name,
            marker=marker, ms=2.6, mfc="white", mew=0.6, markevery=(0.02, 0.14),
        )  # fmt: skip
    else:
        bars = None if one.low is None or one.high is None else [one.y - one.low, one.high - one.y]
        axes.errorbar(one.x, one.y, bars, fmt=marker, ms=2.6, lw=0.6, color=colour, mfc="white", label=one.name)


def _draw_boxes(axes: Any, boxes: Sequence[Series]) -> None:
    """A row of boxes with arrows from each to the next."""
    for one in boxes:
        x = float(one.x[0])
        is_added = one.name.startswith("+")
        style = {
            "boxstyle": "circle,pad=0.25" if is_added else "round,pad=0.4",
            "fc": "white",
            "ec": "black",
            "lw": 0.8,
        }
        axes.annotate(
            one.name.replace(" G", "\nG").replace(" L", "\nL").replace("sky + ", "sky\n+ "),
            (x, 0.0),
            ha="center",
            va="center",
            bbox=style,
            fontsize=7,
        )
        if x > 0:
            axes.annotate(
                "", (x - 0.37, 0.0), (x - 0.58, 0.0), arrowprops={"arrowstyle": "-|>", "lw": 0.8, "fc": "black"}
            )
    axes.set_xlim(-0.6, len(boxes) - 0.4)
    axes.set_ylim(-1.0, 1.0)
    axes.axis("off")
