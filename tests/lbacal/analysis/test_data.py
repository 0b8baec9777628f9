"""Spectra in Python: what they show of themselves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import lbacal
from lbacal.analysis.data import BackgroundSpectra
from lbacal_core.errors import BadInputError
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


TABLE = """time, antenna, dipole, 40.0, 40.4, 41.2
2014-05-01T03:04:05Z, 17, X, {}
2014-05-01T03:04:05Z, 17, Y, 0.1, 0.2, 0.2
"""


def test_values_below_0_and_paths_without_a_spectrum_are_told(tmp_path: Path) -> None:
    path = tmp_path / "rows.csv"
    path.write_text(TABLE.format("-29.6, -29.2, -29.2"))
    notes = lbacal.import_data(path, station="CS002").notes
    assert notes[1:3] == [
        "3 values of the power are below 0 (decibels? it must be on a linear scale), left out",
        "no spectrum of CS002 antenna 17 X: in none has every channel a power > 0 that is not flagged",
    ]
    path.write_text(TABLE.format("-29.6, -29.2, -29.2").replace("0.1, 0.2, 0.2", "-28, -28, -28"))
    with pytest.raises(
        BadInputError, match=r"power on a linear scale, > 0 where .*, found 6 values below 0 \(decibels"
    ):
        lbacal.import_data(path, station="CS002")
