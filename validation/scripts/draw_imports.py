"""Draw docs/images/imports.png: which files of discovery and causes import which.

    .venv/bin/python -m validation.scripts.draw_imports

Every file stands above all that it imports. The script fails where an arrow would point up: then there is a cycle.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import grimp
from matplotlib.figure import Figure

IMAGE = Path(__file__).parents[2] / "docs/images/imports.png"
HOUSE = ("lbacal_core.causes", "lbacal_core.chain", "lbacal_core.discovery")
COLOURS = {"causes": "#2b6c8f", "chain": "#6b7280", "discovery": "#b3322b"}


def levels(imports: dict[str, set[str]]) -> dict[str, int]:
    """Longest way down from each file; a cycle has none."""
    known: dict[str, int] = {}
    while len(known) < len(imports):
        ready = [name for name, below in imports.items() if name not in known and below <= known.keys()]
        if not ready:
            message = f"a cycle among {', '.join(sorted(imports.keys() - known.keys()))}"
            raise SystemExit(message)
        known |= {name: 1 + max((known[one] for one in imports[name]), default=-1) for name in ready}
    return known


def main() -> None:
    graph = grimp.build_graph("lbacal_core", include_external_packages=False)
    house = [name for name in graph.modules if name.startswith(HOUSE) and name.count(".") == 2]
    imports = {name: set(graph.find_modules_directly_imported_by(name)) & set(house) for name in house}
    level = levels(imports)
    rows: dict[int, list[str]] = {}
    for name in sorted(house):
        rows.setdefault(level[name], []).append(name)
    widest = max(len(row) for row in rows.values())
    place = {
        name: ((k + 0.5) * widest / len(row), float(height))
        for height, row in rows.items()
        for k, name in enumerate(row)
    }
    figure = Figure(figsize=(1.35 * widest, 0.95 * len(rows)), layout="constrained")
    axes: Any = figure.subplots()
    for name, below in imports.items():
        for other in below:
            axes.annotate("", place[other], place[name], arrowprops={"arrowstyle": "->", "color": "#bbb", "lw": 0.7})
    for name, (x, y) in place.items():
        _, package, file = name.split(".")
        box = {"boxstyle": "round", "fc": "white", "ec": COLOURS[package]}
        axes.text(x, y, file, ha="center", va="center", fontsize=8, color=COLOURS[package], bbox=box)
    axes.set_xlim(0, widest)
    axes.set_ylim(-0.5, len(rows) - 0.5)
    axes.axis("off")
    for k, (package, colour) in enumerate(COLOURS.items()):
        axes.text(0.1, len(rows) - 0.6 - 0.3 * k, package, color=colour, fontsize=9)
    figure.savefig(IMAGE, dpi=110)
    print(f"{len(house)} files, {sum(map(len, imports.values()))} imports, {len(rows)} levels, no cycle, no arrow up")


if __name__ == "__main__":
    main()
