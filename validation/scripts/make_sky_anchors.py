"""Make lbacal_core/data/sky_anchors.json and sky_level.json: measurements of the brightness of the sky, and its level.

    .venv/bin/python validation/scripts/make_sky_anchors.py ../shared/data/anchor/edges_sky_temperature.csv

The table of EDGES goes in as its means over the sidereal day at five frequencies; the other numbers are those of the
abstracts of the papers that are cited. The level and slope by which the sky `gsm` is multiplied, and their covariance,
follow from `lbacal_core.skypower.sky_terms`.
"""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import numpy as np

from lbacal_core.sky.names import BASE_SKY, load_sky
from lbacal_core.skypower.sky_terms import combine_anchors, predict_left_out, read_anchors

DATA = Path(__file__).parents[2] / "lbacal_core" / "data"
FREQUENCY_MHZ = [50.0, 60.0, 70.0, 80.0, 100.0]

MURCHISON_DEG, GAURIBIDANUR_DEG, LWA1_DEG, SURVEYS_DEG = -26.715, 13.6, 34.07, 0.0


def edges_means(path: Path) -> list[float]:
    """Mean over the sidereal day of the temperature seen by EDGES, K, at FREQUENCY_MHZ."""
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    rows = list(csv.DictReader(lines))
    at_75, index = (np.array([float(row[name]) for row in rows]) for name in ("t75_k", "beta_low"))
    means = [float(np.mean(at_75 * (nu / 75.0) ** index)) for nu in FREQUENCY_MHZ]
    return [round(mean, 1) for mean in means]


def main(table: str) -> None:
    anchors = [
        {
            "experiment": "EDGES", "family": "EDGES", "kind": "temperature", "latitude_deg": MURCHISON_DEG,
            "dipole_height_m": 1.04, "frequency_mhz": FREQUENCY_MHZ, "temperature_k": edges_means(Path(table)),
            "measurement_error": 0.027, "channel_error": 0.01, "model_error": 0.01,
            "source": "sky temperatures of EDGES released with Carter et al. 2025, arXiv 2504.04503; 1 sigma of the "
            "maps calibrated with it 1.6-3.8 % (Monsalve et al. 2021, arXiv 2012.11019); beam not public: "
            "1 %",
        },
        {
            "experiment": "EDGES, 45 MHz map", "family": "EDGES", "kind": "map", "latitude_deg": MURCHISON_DEG,
            "dipole_height_m": 1.04, "frequency_mhz": [45.0], "scale": 1.076, "offset_k": -160.0,
            "measurement_error": 0.018, "channel_error": 0.01, "model_error": 0.1,
            "source": "correction of the map of Guzman et al. 2011: 1.076 +- 0.034, -160 +- 78 K, 2 sigma (Monsalve "
            "et al. 2021, arXiv 2012.11019); we lack the map: its scale error is 10-15 %",
        },
        {
            "experiment": "EDGES, 150 MHz map", "family": "EDGES", "kind": "map", "latitude_deg": MURCHISON_DEG,
            "dipole_height_m": 0.52, "frequency_mhz": [150.0], "scale": 1.112, "offset_k": 0.7,
            "measurement_error": 0.014, "channel_error": 0.01, "model_error": 0.07,
            "source": "correction of the map of Landecker & Wielebinski 1970: 1.112 +- 0.023, 0.7 +- 6 K, 2 sigma "
            "(Monsalve et al. 2021, arXiv 2012.11019); we lack the map: its scale error is 5-7 %",
        },
        {
            "experiment": "SARAS, 150 MHz map", "family": "SARAS", "kind": "map", "latitude_deg": GAURIBIDANUR_DEG,
            "dipole_height_m": 0.5, "frequency_mhz": [150.0], "scale": 1.048, "offset_k": -22.4,
            "measurement_error": 0.025, "channel_error": 0.01, "model_error": 0.07,
            "source": "correction of the map of Landecker & Wielebinski 1970: 1.048 +- 0.008, -22.4 +- 8 K, sky 1.2 "
            "% (Patra et al. 2015, ApJ 801, 138, arXiv 1412.7762); we lack the map: its scale error is 5-7 "
            "%",
        },
        {
            "experiment": "SKALA4.1", "family": "SKALA4.1", "kind": "map", "latitude_deg": MURCHISON_DEG,
            "dipole_height_m": 1.04, "frequency_mhz": [60.0, 80.0], "scale": 1.2, "offset_k": -120.0,
            "measurement_error": 0.03, "channel_error": 0.02, "model_error": 0.06,
            "source": "another receiver and antenna at the place of EDGES: GSM2016 less about 100 K below 100 MHz, "
            "times 1.2 (McKay et al. 2025, arXiv 2509.11846); no error in the abstract: 3 %; we lack "
            "GSM2016: half of the 12 % by which sky models differ (arXiv 2211.03086)",
        },
        {
            "experiment": "LWA1", "family": "LWA1", "kind": "sky", "sky": "lfsm", "latitude_deg": LWA1_DEG,
            "dipole_height_m": 1.5, "frequency_mhz": [40.0, 50.0, 60.0, 70.0, 80.0],
            "measurement_error": 0.14, "channel_error": 0.14, "model_error": 0.02,
            "source": "Low Frequency Sky Model, made of the LWA1 survey (Dowell et al. 2017, MNRAS 469, 4537); scale "
            "errors 20 % (arXiv 2211.03086, table 2)",
        },
        {
            "experiment": "surveys", "family": "surveys", "kind": "sky", "sky": "gsm", "latitude_deg": SURVEYS_DEG,
            "dipole_height_m": 1.5, "frequency_mhz": [45.0, 85.0], "measurement_error": 0.07,
            "channel_error": 0.07, "model_error": 0.05,
            "source": "the surveys that the Global Sky Model is made of: scale errors 10-15 % at 45, 7 % at 85, 5 % "
            "at 150 MHz (arXiv 2211.03086, table 2)",
        },
    ]  # fmt: skip
    (DATA / "sky_anchors.json").write_text(json.dumps(anchors, indent=1) + "\n")
    level = combine_anchors(read_anchors(), load_sky(BASE_SKY))
    (DATA / "sky_level.json").write_text(json.dumps(level.as_dict(), indent=1) + "\n")
    print(level)
    for line in predict_left_out(read_anchors(), load_sky(BASE_SKY)):
        print(line)


if __name__ == "__main__":
    main(sys.argv[1])
