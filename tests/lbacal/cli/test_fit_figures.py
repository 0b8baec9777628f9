from __future__ import annotations

import numpy as np
import pytest

from lbacal.cli.fit_page import average_residuals, draw_fit
from lbacal_core.curves.curves import FitReport
from lbacal_core.instrument.instrument import Instrument, load_instrument
from lbacal_core.pipeline import calibrate
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings

INSTRUMENT = load_instrument("lofar-superterp")


@pytest.fixture(scope="module")
def sky() -> SkyPower:
    return compute_sky_power(INSTRUMENT)


@pytest.fixture(scope="module")
def spectra(sky: SkyPower) -> Spectra:
    settings = TwinSettings(stations=("CS002", "CS003"), antennas=3, events_per_year=250)
    return simulate_campaign(settings, INSTRUMENT, sky, np.random.default_rng(1)).spectra


@pytest.mark.parametrize("scope", ["antenna", "station", "array"])
def test_residuals_of_every_scope_are_small_where_the_chain_is_right(
    spectra: Spectra, sky: SkyPower, scope: str
) -> None:
    report = calibrate(spectra, INSTRUMENT, None, scope)
    maps = average_residuals(spectra, report.curves, INSTRUMENT, sky)
    assert sorted(maps) == ["X", "Y"]
    for one in maps.values():
        assert one.shape == (48, 51)
        # gains of events of 5 % in bins of a few events
        assert np.nanmedian(np.abs(one)) < 0.04
    draw_and_check(report, maps, INSTRUMENT, sky)


def draw_and_check(report: FitReport, maps: dict[str, np.ndarray], instrument: Instrument, sky: SkyPower) -> None:
    figure = draw_fit(report, maps, instrument, sky)
    labels = [set(axes.get_legend_handles_labels()[1]) for axes in figure.axes]
    assert {"total error", "statistical error"} <= labels[0]
    assert {"N_LNA", "N_RCU", "N_ADC", "sky, mean over LST"} <= labels[4]
    assert {"noise alone", "sky and pattern free", "expected of noise, 95 %"} <= labels[6]
    assert len(figure.axes[2].images) == 1
    figure.canvas.draw()


def test_a_fit_without_any_curve_is_drawn_empty(spectra: Spectra, sky: SkyPower) -> None:
    few = spectra.select(np.isin(spectra.event_id, np.unique(spectra.event_id)[:10]))
    report = calibrate(few, INSTRUMENT, None, "antenna")
    assert all(curve.c is None for curve in report.curves)
    draw_fit(report, average_residuals(few, report.curves, INSTRUMENT, sky), INSTRUMENT, sky).canvas.draw()
