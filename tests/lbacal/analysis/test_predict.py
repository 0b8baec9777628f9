"""`lbacal.predict` and `lbacal predict`: from a fit, from an instrument alone, printed, drawn and saved."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from astropy import units as u
from matplotlib.figure import Figure

import lbacal
from lbacal_core.errors import BadInputError, UnknownNameError
from tests.lbacal.cli.conftest import Lbacal
from tests.lbacal.cli.conftest import lbacal as command

__all__ = ["command"]
pytestmark = pytest.mark.long
AT = "2014-05-01T12:00:00Z"


def test_a_fit_predicts_its_paths(tmp_path: Path) -> None:
    spectra = lbacal.simulate("lofar-superterp", events=150, antennas=2)
    found = lbacal.fit(spectra, "lofar-superterp")
    told = lbacal.predict(found, at=AT, station="CS002", antenna=1, dipole="X", temperature=285 * u.K)
    assert "measured in 150 events of this path" in repr(told)
    assert "no cause of the model follows the temperature" in told.notes[-2]
    assert "sky's own noise" in told.notes[-1]
    events = told.draw_events(2000)
    assert np.cov(events, rowvar=False)[25, 26] == pytest.approx(told.event_covariance[25, 26], rel=0.1)
    for suffix in ("json", "h5", "ecsv", "fits", "csv", "html", "png"):
        told.save(tmp_path / f"p.{suffix}")
    assert told.table["sky_temperature"].unit == u.K
    assert isinstance(told.plot(Figure().subplots()), Figure)
    with pytest.raises(UnknownNameError, match="unknown curve 'CS002 antenna 7 X'"):
        lbacal.predict(found, at=AT, station="CS002", antenna=7, dipole="X")


def test_the_command_writes_events_of_an_instrument_alone(command: Lbacal, tmp_path: Path) -> None:
    path = ("--station", "CS002", "--antenna", 17, "--dipole", "X", "--at", "2014-05-01")
    alone = (*path, "--simulation", "lofar-superterp")
    code, said, _ = command("predict", *alone, "--realisations", 10, "--output", "P.h5")
    assert (code, "n_lna, n_rcu, n_adc" in said) == (0, True)
    with h5py.File(tmp_path / "P.h5") as root:
        assert root["realisations"].shape == (10, 51)
        assert root["contributions/sky/kelvin"].shape == (51,)
        assert root.attrs["power_unit"] == "W/MHz"
    for wrong, sentence in (
        ((*alone, "--realisations", 10, "--output", "P.json"), "--realisations: expected an --output"),
        ((*alone, "--dipole", "Q", "--output", "P.h5"), "dipole"),
        ((*alone, "--at", "2014", "--output", "P.h5"), "ISO 8601"),
        ((*alone, "--antenna", "99", "--output", "P.h5"), "an antenna of instrument lofar-superterp"),
    ):
        code, _, err = command("predict", *wrong)
        assert (code, err.count("\n"), sentence in err) == (2, 1, True), err


def test_a_time_that_is_none_is_refused_in_words_of_python() -> None:
    with pytest.raises(BadInputError, match=r"^at: expected an ISO 8601 date"):
        lbacal.predict("lofar-superterp", at="May 2014", station="CS002", antenna=1, dipole="X")
