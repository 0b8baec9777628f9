"""`lbacal.predict` and `lbacal predict`: from a fit, from an instrument alone, printed, drawn and saved."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from astropy import units as u
from astropy.constants import k_B
from matplotlib.figure import Figure

import lbacal
from lbacal_core.errors import BadInputError, UnknownNameError
from tests.lbacal.cli.conftest import Lbacal
from tests.lbacal.cli.conftest import lbacal as command

__all__ = ["command"]
AT = "2014-05-01T12:00:00Z"


def test_a_fit_predicts_its_paths(tmp_path: Path) -> None:
    spectra = lbacal.simulate("lofar-superterp", events=150, antennas=2)
    found = lbacal.fit(spectra, "lofar-superterp")
    told = lbacal.predict(found, at=AT, station="CS002", antenna=1, dipole="X", temperature=285 * u.K)
    assert "measured in 150 events of this path" in repr(told)
    assert ("power, ADC²/Ω/MHz " in repr(told), "adu" in repr(told)) == (True, False)
    assert "no cause of the model follows the temperature" in told.notes[-2]
    assert "sky's own noise" in told.notes[-1]
    events = told.draw_events(2000)
    assert np.cov(events, rowvar=False)[25, 26] == pytest.approx(told.event_covariance[25, 26], rel=0.1)
    for suffix in ("json", "h5", "ecsv", "fits", "csv", "html", "png"):
        told.save(tmp_path / f"p.{suffix}")
    assert told.table["sky_temperature"].unit == u.K
    sensitivity = 2 * k_B / told.table["sefd"]  # of one polarisation: half of an unpolarised flux
    np.testing.assert_allclose(told.table["a_eff_t_sys"].to_value(u.m**2 / u.K), sensitivity.si.value)
    drawn = told.plot(Figure().subplots())
    assert drawn.axes[0].get_title() == f"CS002 1 X at {AT}"
    with pytest.raises(UnknownNameError, match="unknown curve 'CS002 antenna 7 X'"):
        lbacal.predict(found, at=AT, station="CS002", antenna=7, dipole="X")


@pytest.mark.long
@pytest.mark.parametrize("scope", ["station", "array"])
def test_the_curve_of_a_station_or_the_array_predicts_each_of_its_paths(scope: str) -> None:
    spectra = lbacal.simulate("lofar-superterp", events=150, antennas=4)
    own, mean = (lbacal.fit(spectra, "lofar-superterp", scope=one) for one in ("antenna", scope))
    path = {"at": AT, "station": "CS002", "antenna": 2, "dipole": "Y"}
    told, known = lbacal.predict(mean, **path), lbacal.predict(own, **path)
    sigma = np.sqrt(np.diag(told.covariance))
    assert np.mean(np.abs(told.power - known.power) < 2 * sigma) > 0.9
    assert np.median(sigma / np.sqrt(np.diag(known.covariance))) > 1.5  # how far single paths depart is in it
    with pytest.raises(BadInputError, match="antenna 700: expected an antenna of instrument lofar-superterp"):
        lbacal.predict(mean, **{**path, "antenna": 700})


@pytest.mark.long
def test_one_trace_for_all_hours_is_wrong_by_what_the_page_says(repository: Path) -> None:
    """From the faintest hour to the brightest: the Galaxy's part of the power of 30-80 MHz, and all of it."""
    found = lbacal.fit(lbacal.simulate("lofar-superterp", events=150, antennas=2), "lofar-superterp")
    galaxy, recorded = [], []
    for curve in found.report.curves[:2]:
        power = found.simulation.background(curve, np.arange(0.0, 24.0, 0.25))
        for level, into in ((power - found.simulation.electronics(curve), galaxy), (power, recorded)):
            band = level.mean(axis=1)
            into.append(10.0 * np.log10(band.max() / band.min()))
    page = (repository / "docs/how-to/predict.md").read_text()
    assert f"the Galaxy in it by up to {galaxy[0]:.1f} dB (X) and {galaxy[1]:.1f} dB (Y)" in page
    assert recorded == pytest.approx([1.1, 1.5], abs=0.2), "what the page says, by the noise of this fit"
    assert "the power that is recorded by 1.1 dB and 1.5 dB" in page


def test_traces_of_one_event_share_its_gain_and_rates_may_differ() -> None:
    at = {"at": "2014-05-01", "station": "CS002", "dipole": "X"}
    told = [lbacal.predict("lofar-superterp", antenna=antenna, **at) for antenna in (1, 2)]
    drawn = [lbacal.draw_traces(told, 4096, 250.0, seed) for seed in range(300)]
    level = np.log([[np.mean(trace**2) for trace in traces] for traces in drawn])
    # the gain of an event is 5 %, of whose variance 36 % is the station's; a trace of 16.4 us has its own noise
    own = [np.linalg.norm(one.power) / one.power.sum() / 16.384**0.5 for one in told]
    assert np.std(level, axis=0) == pytest.approx(np.hypot(0.05, own), rel=0.12)  # 4 % by 300 events
    assert np.cov(level.T)[0, 1] == pytest.approx(0.03**2, abs=8e-4)  # 4e-4 by as many
    expected = [50.0 * one.power.sum() for one in told]
    assert np.exp(level).mean(axis=0) == pytest.approx(expected, rel=0.02)


def test_the_command_writes_events_of_an_instrument_alone(command: Lbacal, tmp_path: Path) -> None:
    path = ("--station", "CS002", "--antenna", 17, "--dipole", "X", "--at", "2014-05-01")
    alone = (*path, "--simulation", "lofar-superterp")
    code, said, _ = command("predict", *alone, "--realisations", 10, "--output", "P.h5")
    assert (code, "n_lna, n_rcu, n_adc" in said) == (0, True)
    with h5py.File(tmp_path / "P.h5") as root:
        assert root["realisations"].shape == (10, 51)
        assert root["contributions/sky/kelvin"].shape == (51,)
        assert "contributions/known_noise/kelvin" in root
        assert root.attrs["power_unit"] == "W/MHz"
    code, printed, _ = command("predict", *alone)
    assert (code, printed) == (0, said.replace("\nwrote P.h5", "")), "without a file the table is printed alone"
    for wrong, sentence in (
        ((*alone, "--realisations", 10, "--output", "P.json"), "--realisations: expected an --output"),
        ((*alone, "--realisations", 10), "--realisations: expected an --output"),
        ((*path, "--with", "R.json", "--output", "P.h5"), "--with: expected --simulation beside it"),
        ((*alone, "--dipole", "Q", "--output", "P.h5"), "dipole"),
        ((*alone, "--at", "2014", "--output", "P.h5"), "ISO 8601"),
        ((*alone, "--antenna", "99", "--output", "P.h5"), "an antenna of instrument lofar-superterp"),
    ):
        code, _, err = command("predict", *wrong)
        assert (code, err.count("\n"), sentence in err) == (2, 1, True), err


def test_a_time_that_is_none_is_refused_in_words_of_python() -> None:
    with pytest.raises(BadInputError, match=r"^at: expected an ISO 8601 date"):
        lbacal.predict("lofar-superterp", at="May 2014", station="CS002", antenna=1, dipole="X")
