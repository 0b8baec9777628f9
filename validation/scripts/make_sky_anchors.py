"""Renew what follows from measurements of the brightness of the sky: lbacal_core/data/sky_level.json, and one anchor.

    .venv/bin/python validation/scripts/make_sky_anchors.py ../shared/data/anchor/edges_sky_temperature.csv

The table of EDGES goes into lbacal_core/data/sky_anchors.json as its means over the sidereal day at five frequencies;
the other numbers there are those of the abstracts of the papers that it cites. The level and slope by which the sky
`gsm` is multiplied, and their covariance, follow from `validation.anchors`.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from lbacal_core.data.tables import read_columns
from lbacal_core.sky.names import BASE_SKY, PIVOT_MHZ, load_sky
from validation.anchors import combine_anchors, predict_left_out, read_anchors

DATA = Path(__file__).parents[2] / "lbacal_core" / "data"


def edges_means(path: Path, frequency_mhz: list[float]) -> list[float]:
    """Mean over the sidereal day of the temperature seen by EDGES, K."""
    read = read_columns(path)
    return [round(float(np.mean(read["t75_k"] * (nu / 75.0) ** read["beta_low"])), 1) for nu in frequency_mhz]


def main(table: str) -> None:
    path = DATA / "sky_anchors.json"
    anchors = json.loads(path.read_text())
    (edges,) = (one for one in anchors if one["experiment"] == "EDGES")
    edges["temperature_k"] = edges_means(Path(table), edges["frequency_mhz"])
    path.write_text(json.dumps(anchors, indent=1) + "\n")
    level = combine_anchors(read_anchors(), load_sky(BASE_SKY))
    rounded = {name: round(getattr(level, name), 5) for name in ("level", "slope", "scatter")}
    covariance = [[round(float(value), 8) for value in row] for row in level.covariance]
    content = {"pivot_mhz": PIVOT_MHZ, **rounded, "covariance": covariance}
    (DATA / "sky_level.json").write_text(json.dumps(content, indent=1) + "\n")
    print(level)
    for line in predict_left_out(read_anchors(), load_sky(BASE_SKY)):
        print(line)


if __name__ == "__main__":
    main(sys.argv[1])
