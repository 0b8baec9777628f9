"""The page on the measured sky says what the code computes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lbacal_core.calibration.fit import fit_calibration
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.names import read_sky_level
from lbacal_core.sky.power import compute_sky_power
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings
from validation.scripts.draw_measured_sky import PAGE, tabulate_budgets, tabulate_edges, tabulate_families


def test_the_tables_of_the_page_are_those_that_the_code_makes() -> None:
    page = PAGE.read_text()
    assert "\n".join(tabulate_families()) in page
    assert "\n".join(tabulate_budgets(load_instrument("lofar-superterp"))) in page


@pytest.mark.shared
def test_the_prediction_of_edges_on_the_page_is_that_of_its_table(shared: Path) -> None:
    table = tabulate_edges(shared / "data/anchor/edges_sky_temperature.csv")
    assert "\n".join(table) in PAGE.read_text()


def test_the_level_beyond_the_map_that_the_page_on_skies_states_is_that_of_the_anchors() -> None:
    level, nu = read_sky_level(), np.array([100.0, 120.0, 150.0])
    values, errors = 100 * np.expm1(level.ln_ratio(nu)), 100 * level.sigma(nu)
    row = " | ".join(f"{value:+.1f} ± {error:.1f}" for value, error in zip(values, errors, strict=True))
    assert f"| measured over modelled, % | {row} |" in (PAGE.parent / "sky-and-antennas.md").read_text()


def test_the_measured_sky_raises_c_by_half_of_its_level() -> None:
    instrument = load_instrument("lofar-superterp")
    gsm, measured = (compute_sky_power(instrument, name) for name in ("gsm", "measured"))
    settings = TwinSettings(stations=("CS002",), antennas=6, events_per_year=300)
    spectra = simulate_campaign(settings, instrument, gsm, np.random.default_rng(7)).spectra
    low, high = (
        fit_calibration(spectra, Simulation(instrument, power), "station").curves[0] for power in (gsm, measured)
    )
    assert low.c is not None
    assert high.c is not None
    half = np.exp(read_sky_level().ln_ratio(instrument.frequency_mhz) / 2)
    # three noise constants tie the intercepts: a slope of the sky that is not that of the data moves C by 0.6 % up to
    # 70 MHz, and by 1-2 % at 80 MHz, where the electronics are louder than the sky (three seeds)
    np.testing.assert_allclose(high.c / low.c, half, atol=0.025)
    np.testing.assert_allclose((high.c / low.c)[:41], half[:41], atol=0.008)
    assert high.c_over_h is not None
    assert low.c_over_h is not None
    np.testing.assert_allclose(high.c_over_h / low.c_over_h, high.c / low.c)
