"""The one place where the style of printed figures stands: readable in grey, by the colour-blind, and at column width.

Colours are those of Okabe and Ito (2008); each goes with a line style and a marker of its own, so that no curve is
told by colour alone.
"""

from __future__ import annotations

from typing import Any

COLOURS = ("#000000", "#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
"""Black, vermilion, blue, green, purple, orange, sky blue; their lightness differs as well."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
SETTINGS: Any = {
    "font.size": 8,
    "font.family": "serif",
    "mathtext.fontset": "dejavuserif",
    "axes.linewidth": 0.7,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "xtick.top": True,
    "ytick.right": True,
    "legend.fontsize": 6.5,
    "legend.frameon": False,
    "svg.hashsalt": "lbacal",
    "pdf.fonttype": 42,
}
