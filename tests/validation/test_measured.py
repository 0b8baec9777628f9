from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.lstcurve.curve import PointNoise
from validation.measured import Question, drawn_simulation, main_questions, tables_as_sky_power
from validation.sky_models import published_tables

pytestmark = pytest.mark.shared


@pytest.fixture(scope="module")
def instrument():
    from lbacal_core.instrument.instrument import load_instrument

    return load_instrument("lofar-superterp")


@pytest.fixture(scope="module")
def tables(shared, instrument):
    return tables_as_sky_power(shared / "data/published_sky_power.csv", instrument)


def test_the_tables_become_sky_power_without_the_antenna_gain(shared, instrument, tables):
    _, rows, lst = published_tables(shared / "data/published_sky_power.csv", instrument)
    for dipole in "XY":
        bare = tables.at(dipole, lst) / rows["bare"]
        # the LSTs of the tables are rounded to 0.01 h: 0.2 % where the Galaxy rises
        assert bare.mean(axis=0) == pytest.approx(1.0, abs=2e-3)
        shape = rows[dipole] / tables.at(dipole, lst)
        assert shape / shape.mean(axis=0) == pytest.approx(1.0, abs=5e-3)


@pytest.mark.usefixtures("shared")
def test_the_measured_curve_asks_both_simulations_to_exchange_the_letters(instrument):
    for question in main_questions(instrument):
        found = question.ask(instrument)
        assert "dipole_swap" in [found.last.labels[finding.place] for finding in found.findings]


def test_the_simulation_drawn_in_the_figure_is_the_tables_exchanged_and_an_hour_later(shared, instrument, tables):
    curve = drawn_simulation(shared / "data/measured_lst_variation.csv", "noise")
    question = Question("drawn", curve, tables, is_own_sky=False, noise=PointNoise({"X": 0.012, "Y": 0.012}, 0.0, 60))
    found = question.ask(instrument)
    sizes = dict(zip(found.last.labels, found.last.sizes, strict=True))
    assert sizes["dipole_swap"] == 1.0
    assert found.last.noise == pytest.approx(0.49, abs=0.02)
    assert sizes["lst_offset"] == pytest.approx(1.0, abs=0.05)
    assert np.nanstd(found.last.residual_db["X"]) < 0.02  # as well as the figure can be read
