"""What is wrong, and what follows from it, in Python: the numbers of the commands, drawn and saved."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from astropy.table import QTable
from matplotlib.figure import Figure

import lbacal
from lbacal.analysis.investigate import _tell
from lbacal.analysis.result import Result
from lbacal.pages.finding import tell_finding
from lbacal_core.errors import BadInputError
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.lstcurve.curve import measured_curve
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.table import SkyPower
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.hardware import GainStep
from lbacal_twin.faults.sky import LstOffset
from lbacal_twin.settings import TwinSettings
from tests.killed_worker import killing_one_of_two

EVERY = ("json", "html", "ecsv", "csv", "fits", "h5", "png")
pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def sky() -> SkyPower:
    return compute_sky_power(load_instrument("lofar-superterp"))


@pytest.fixture(scope="module")
def late(sky: SkyPower) -> Spectra:
    """A station whose clock is 0.3 h off."""
    settings = TwinSettings(stations=("CS002",), antennas=4, events_per_year=250)
    chain, rng = load_instrument("lofar-superterp"), np.random.default_rng(3)
    return simulate_campaign(settings, chain, sky, rng, [LstOffset(size=0.3)]).spectra


@pytest.fixture(scope="module")
def found(late: Spectra, sky: SkyPower) -> lbacal.Investigation:
    return lbacal.investigate(late, "lofar-superterp", sky)


def save_all(result: object, folder: Path) -> None:
    for suffix in EVERY:
        result.save(folder / f"r.{suffix}")
        assert (folder / f"r.{suffix}").stat().st_size > 100
    assert len(QTable.read(folder / "r.ecsv")) == len(result.table)


def test_a_finding_has_its_size_its_gain_its_figure_and_the_simulation_with_it(found: lbacal.Investigation) -> None:
    (finding,) = found.findings
    assert (found.verdict, finding.cause) == ("explained", "lst_offset")
    assert finding.content["size"]["value"] == pytest.approx(0.3, abs=0.08)
    assert finding.gain["held_out_log_likelihood_gain"] > 50
    assert isinstance(finding.plot(), Figure)
    axes = Figure().subplots()
    assert finding.plot(axes) is found.plot(axes) is axes.figure
    assert axes.get_xlabel().startswith("best score")
    extended = finding.extend()
    assert [one.cause for one in extended.causes.causes] == ["lst_offset"]
    assert "lst_offset in station of CS002" in repr(extended)
    assert "15" in repr(found)
    assert found.table["size"][0] == finding.content["size"]["value"]
    assert (found.table["size_sigma"][0] > 0, found.table["unit"][0]) == (True, "h")
    assert "sidereal time" in found._repr_html_()


def test_the_simulation_with_the_cause_finds_nothing_more(late: Spectra, found: lbacal.Investigation) -> None:
    again = lbacal.investigate(late, found.findings[0].extend())
    assert (again.verdict, len(again.findings)) == ("consistent", 0)
    assert again.report["adopted"][0]["size"]["value"] == pytest.approx(0.3, abs=0.08)


def test_what_the_audit_finds_wrong_is_in_the_headline_of_what_is_consistent(sky: SkyPower) -> None:
    """A wrong cable on record is absorbed by the gain of its antenna, and all read as if it were right."""
    settings = TwinSettings(stations=("CS002",), antennas=6, events_per_year=250)
    chain = load_instrument("lofar-superterp")
    spectra = simulate_campaign(settings, chain, sky, np.random.default_rng(3), []).spectra
    wrong = [replace(one, cable="50" if one.antenna == 3 else one.cable) for one in chain.antennas]
    found = lbacal.investigate(spectra, replace(chain, antennas=tuple(wrong)))
    assert "antenna 3 has the cable" in found.report["provenance"]["notes"]["audit"]
    assert (found.verdict, found.report["verdict"]) == ("consistent", "consistent")
    assert found.headline == "consistent, but the audit finds something wrong (below)"
    assert found.headline in found.title


def test_a_fit_with_a_finding_is_that_of_its_report(late: Spectra, found: lbacal.Investigation, tmp_path: Path) -> None:
    found.save(tmp_path / "R.json")
    value, report = (
        lbacal.fit(late, "lofar-superterp", scope="station", with_=with_)
        for with_ in (found.findings[0], f"{tmp_path / 'R.json'}#0")
    )
    assert value.report.causes[0]["cause"] == "lst_offset"
    np.testing.assert_array_equal(value.table["c"], report.table["c"])
    np.testing.assert_array_equal(value.table["c_sigma_sys"], report.table["c_sigma_sys"])


def test_an_investigation_is_saved_in_every_form(found: lbacal.Investigation, tmp_path: Path) -> None:
    save_all(found, tmp_path)
    assert json.loads((tmp_path / "r.json").read_text())["findings"][0]["left_open"]
    assert "lst_offset along frequency" in (tmp_path / "r.html").read_text()


def test_a_budget_has_a_term_for_what_is_left_open(late: Spectra, found: lbacal.Investigation, tmp_path: Path) -> None:
    budget = lbacal.budget(late, "lofar-superterp", sky="paper", left_open=found)
    assert budget.terms[-1].name == "lst_offset not adopted"
    save_all(budget, tmp_path)
    budget.plot(Figure().subplots())
    with pytest.raises(BadInputError, match=r"sky budget: expected one of paper, .* \(is paper meant\?\)"):
        lbacal.budget(late, "lofar-superterp", sky="papers")


def test_a_result_without_figures_leaves_axes_as_they_are() -> None:
    axes = Figure().subplots()
    assert Result(title="old", rows=[], charts=list).plot(axes) is axes.figure
    assert not axes.has_data()


def test_an_audit_is_a_table_of_its_lines(late: Spectra, tmp_path: Path) -> None:
    audit = lbacal.audit(late, "lofar-superterp")
    assert {"clock", "arms"} <= set(audit.table["check"])
    save_all(audit, tmp_path)
    audit.plot(Figure().subplots())


def test_an_lst_curve_is_compared_and_investigated(tmp_path: Path) -> None:
    curve = lbacal.lst_curve(measured_curve())
    assert [row[0] for row in curve.rows[1:]] == ["X", "Y", "X", "Y"]
    save_all(curve, tmp_path)
    curve.plot(Figure().subplots())
    found = lbacal.investigate(measured_curve())
    assert found.findings[0].cause == "dipole_swap"
    assert isinstance(found.findings[0].plot(), Figure)
    with pytest.raises(BadInputError, match=r"^finding 0: expected"):
        found.findings[0].extend()


def test_spectra_need_an_instrument_and_a_scope_has_a_name(late: Spectra) -> None:
    with pytest.raises(BadInputError, match=r"^instrument: expected an instrument beside spectra"):
        lbacal.investigate(late)
    with pytest.raises(BadInputError, match=r"^scope: expected one of antenna, station, array, found 'paths'$"):
        lbacal.fit(late, "lofar-superterp", scope="paths")


def test_what_has_no_meaning_beside_the_rest_is_refused(late: Spectra, tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="band: expected an LST curve beside it"):
        lbacal.investigate(late, "lofar-superterp", band=(40, 60))
    simulation = Simulation(load_instrument("lofar-superterp"))
    with pytest.raises(BadInputError, match="a simulation has its sky"):
        lbacal.fit(late, simulation, sky_power=simulation.sky_power)
    lbacal.fit(late, simulation).save(tmp_path / "C.ecsv")
    with pytest.raises(BadInputError, match="since, until, stations: expected spectra"):
        lbacal.read(tmp_path / "C.ecsv", stations=["CS002"])


def test_data_are_imported_with_what_was_left_out(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("# time: 2014-05-01T00:00:00Z\nfrequency_mhz,0X\n40,1\n41,3\n")
    spectra = lbacal.import_data(tmp_path / "a.csv", events=True)
    assert spectra.notes[-1] == "1 spectra, 1 events from 1 integrations, 2 channels from 40 to 41 MHz"
    spectra.save(tmp_path / "S.h5")
    read = lbacal.read(tmp_path / "S.h5", since="2014-04-01")
    np.testing.assert_array_equal(read.power, [[1.0, 3.0]])
    with pytest.raises(BadInputError, match=r"^average: expected a number > 0, found 0"):
        lbacal.import_data(tmp_path / "a.csv", average=0)
    with pytest.raises(BadInputError, match=r"^since, until: expected an end after the beginning"):
        lbacal.read(tmp_path / "S.h5", since="2014-04-01", until="2014-03-01")


def test_rivals_and_a_fit_that_has_not_converged_are_told_in_the_terminal_and_on_the_page(late: Spectra, sky) -> None:
    content = json.loads(json.dumps(lbacal.investigate(late, "lofar-superterp", sky).report))
    finding = content["findings"][0]
    finding["evidence"] |= {
        "is_converged": False,
        "rivals": [{"cause": "point_source", "target": "station", "delta_chi2": 9.2, "odds": 0.01}],
        "sentences": ["The sky moves."],
    }
    content["stations"][0]["deaf"] = ["antenna 3 X"]
    told, page = "\n".join(_tell(content)), dict(tell_finding(finding))
    assert "left out of CS002, as hardly any of their power is that of the sky: antenna 3 X" in told
    assert "caution: the fit of all causes together has not converged" in told
    assert "rivals, with their odds to it: point_source (station) 0.01 : 1" in told
    assert "    nearly as likely: The sky moves." in told.splitlines()
    assert page["rivals, with their odds to it"] == "point_source (station) 0.01 : 1"
    assert "not converged" in page["caution"]


def test_stations_searched_on_dask_give_the_same_report_though_a_worker_is_killed(
    sky: SkyPower, tmp_path: Path
) -> None:
    settings = TwinSettings(stations=("CS002", "CS003", "CS004"), antennas=2, events_per_year=120)
    chain, rng = load_instrument("lofar-superterp"), np.random.default_rng(5)
    of_one = GainStep(size=0.2, date="2014-07-01", where=Where(stations=("CS003",), antennas=(1,), dipoles=("Y",)))
    spectra = simulate_campaign(settings, chain, sky, rng, [of_one]).spectra
    here, told = lbacal.investigate(spectra, "lofar-superterp", sky), list[str]()
    with killing_one_of_two(tmp_path, "lbacal_core.discovery.left_open.describe_station") as engine:
        there = lbacal.investigate(spectra, "lofar-superterp", sky, dask=engine.address, tell=told.append)
    assert [one.cause for one in here.findings] == ["gain_step"]
    assert "left_open" in here.findings[0].content
    assert json.dumps(there.report) == json.dumps(here.report)
    assert [words.partition(": ")[2] for words in told] == [f"searched, {k} of 3 stations" for k in (1, 2, 3)]
