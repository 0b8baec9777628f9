"""Spectra in Python: what they show of themselves."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

import lbacal
from lbacal.analysis.data import BackgroundSpectra
from lbacal_core.spectra.spectra import Spectra
from tests.lbacal.cli.conftest import make_instrument, make_sky_power, make_spectra


def test_spectra_draw_the_median_of_each_dipole_and_the_middle_of_its_events() -> None:
    spectra: Spectra = make_spectra(make_instrument(), make_sky_power())
    shown = BackgroundSpectra.of(spectra)
    (chart,) = shown.shown.charts()
    names = [one.name for one in chart.series if one.name]
    assert names == ["CS002 X, median and 68 %", "CS002 Y, median and 68 %"]
    for band, line, dipole in zip(chart.series[::2], chart.series[1::2], "XY", strict=True):
        power = spectra.power[spectra.dipole == dipole]
        np.testing.assert_allclose(line.y, np.median(power, axis=0))
        assert 0.66 < np.mean((power > band.low) & (power < band.high)) < 0.70
    assert isinstance(shown.plot(Figure().subplots()), Figure)
    assert shown.plot().axes[0].get_yscale() == "log"
    assert shown.shown.rows[1:] == [("CS002", dipole, "2", "120", "240") for dipole in "XY"]
    assert "CS002" in shown._repr_html_()


def test_the_verbs_are_listed_before_they_are_loaded() -> None:
    assert {"fit", "predict", "Client", "effective"} < set(dir(lbacal))
