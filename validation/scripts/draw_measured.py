"""Draw the measured LOFAR curve and what is found in it, into docs/images.

Run: .venv/bin/python -m validation.scripts.draw_measured (needs the folder ../shared beside the project)
"""

from __future__ import annotations

from pathlib import Path

from lbacal.cli.curve_page import draw_change, draw_curve, draw_ranking
from lbacal_core.instrument.instrument import load_instrument
from validation.measured import main_questions

IMAGES = Path(__file__).parents[2] / "docs" / "images"


def main() -> None:
    instrument = load_instrument("lofar-superterp")
    own, tables = (question.ask(instrument) for question in main_questions(instrument))
    figures = {
        "measured-own": draw_curve(own, "Measured LOFAR curve against our sky"),
        "measured-tables": draw_curve(tables, "Measured LOFAR curve against the published tables"),
        "measured-ranking": draw_ranking(own),
        "measured-change": draw_change(own),
    }
    for name, figure in figures.items():
        figure.savefig(IMAGES / f"{name}.png", dpi=110)


if __name__ == "__main__":
    main()
