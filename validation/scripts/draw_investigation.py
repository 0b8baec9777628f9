"""Draw docs/images/investigation-*.png and measured-*.png: what `lbacal investigate` shows of spectra and of a curve.

    .venv/bin/python -m validation.scripts.draw_investigation

One simulated station has a daytime ionosphere and a gain step of one path, the other follows the working week. The
measured LOFAR curve needs the folder ../shared beside the project.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from lbacal.pages.chart import Chart, plot_charts
from lbacal.pages.curve import draw_change, draw_curve, draw_ranking
from lbacal.pages.finding import draw_finding, draw_station
from lbacal_core.discovery.report import investigate
from lbacal_core.simulation.simulation import Simulation
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.fault import Fault, Where
from lbacal_twin.faults.hardware import GainStep
from lbacal_twin.faults.sky import IonosphericAbsorption
from lbacal_twin.faults.uncatalogued import WorkingWeek
from lbacal_twin.settings import TwinSettings
from validation.machinery.parts import SHARED
from validation.measured import main_questions
from validation.superterp import power_of, superterp

IMAGES = Path(__file__).parents[2] / "docs/images"
SETTINGS = TwinSettings(stations=("CS002",), antennas=12, events_per_year=400)
STEP = GainStep(size=0.05, where=Where(antennas=(2,), dipoles=("Y",)), date="2014-08-07")


def ask(faults: list[Fault]) -> dict[str, Any]:
    instrument, sky = superterp(), power_of()
    spectra = simulate_campaign(SETTINGS, instrument, sky, np.random.default_rng(5), faults).spectra
    content, _ = investigate(spectra, Simulation(instrument, sky, is_own_sky=True))
    print(content["verdict"], [finding["sentence"] for finding in content["findings"]])
    return content


def draw_measured() -> None:
    own, tables = (question.ask(superterp()) for question in main_questions(superterp()))
    figures = {
        "own": list(draw_curve(own)),
        "tables": list(draw_curve(tables)),
        "ranking": [draw_ranking(own)],
        "change": list(draw_change(own)),
    }
    for name, charts in figures.items():
        plot_charts(charts).savefig(IMAGES / f"measured-{name}.png", dpi=100)


def main() -> None:
    if SHARED.is_dir():
        draw_measured()
    spoiled = ask([IonosphericAbsorption(size=0.02), STEP])
    figures: dict[str, list[Chart]] = {}
    for one in spoiled["findings"]:
        charts = draw_finding(one)
        figures[one["cause"]] = [charts["course"], charts["law"]]
        figures.setdefault("maps", [charts["before 0"], charts["after 0"]])
    odd = draw_station(ask([WorkingWeek(size=0.05)])["stations"][0])
    figures["unexplained"] = [odd["structure"], odd["spectrum"]]
    for name, charts in figures.items():
        plot_charts(charts).savefig(IMAGES / f"investigation-{name}.png", dpi=100)


if __name__ == "__main__":
    main()
