"""`--with`: fits and investigations of a model that findings of a report extend."""

from __future__ import annotations

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from lbacal.cli.main import app
from lbacal.with_model import read_model, read_open_terms
from lbacal_core.causes.model import PLAIN, AdoptedCause, Model
from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.table import write_sky_power
from lbacal_core.spectra.spectra import read_spectra, write_spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.sky import LstOffset
from lbacal_twin.settings import TwinSettings


def finding(cause, size):
    return {
        "cause": cause, "size": {"value": size, "sigma": 0.02, "unit": "h"}, "parameters": {},
        "where": {"station": "CS002", "dates": ["2014-01-01T00:00:00Z", "2014-12-31T00:00:00Z"]},
        "evidence": {"target": "station"},
    }  # fmt: skip


@pytest.fixture
def report(tmp_path):
    path = tmp_path / "R.json"
    content = {"verdict": "explained", "findings": [finding("lst_offset", 0.27), finding("cable_length", 3.0)]}
    path.write_text(json.dumps(content))
    return path


@pytest.fixture(scope="module")
def late(tmp_path_factory):
    """A station whose clock is 0.3 h off, and the sky power that it was simulated with."""
    folder = tmp_path_factory.mktemp("late")
    chain = load_instrument("lofar-superterp")
    sky = compute_sky_power(chain)
    settings = TwinSettings(stations=("CS002",), antennas=4, events_per_year=250)
    spectra = simulate_campaign(settings, chain, sky, np.random.default_rng(3), [LstOffset(size=0.3)]).spectra
    write_spectra(spectra, folder / "S.h5")
    write_sky_power(sky, folder / "P.json")
    return folder


def run(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


def fit(late, *more):
    return run(
        "fit", late / "S.h5", "--instrument", "lofar-superterp", "--sky-power", late / "P.json", "--scope", "station",
        "--output", late / "C.ecsv", "--report", late / "fit.json", *more,
    )  # fmt: skip


def test_a_finding_is_named_by_its_number(report):
    assert [one.cause for one in read_model(f"{report}#0").causes] == ["lst_offset"]
    assert read_model(None) is PLAIN


def test_all_findings_are_adopted_without_a_number(report):
    with pytest.raises(BadInputError, match="cable_length"):
        read_model(str(report))


def test_the_model_of_a_report_with_nothing_left_is_the_one_it_was_made_with(tmp_path):
    made_with = Model((AdoptedCause("lst_offset", "CS002", "station", 0.27, 0.02),))
    path = tmp_path / "R2.json"
    path.write_text(json.dumps({"verdict": "consistent", "findings": [], "model": made_with.to_text()}))
    assert read_model(str(path)) == made_with


@pytest.mark.parametrize("text", ["R.json#", "R.json#one", "R.json#-1"])
def test_a_number_that_is_none_is_refused(text):
    with pytest.raises(BadInputError, match="the number of a finding"):
        read_model(text)


def test_a_file_whose_name_has_a_hash_sign_is_a_file(report):
    odd = report.with_name("R#0")
    odd.write_text(json.dumps({"verdict": "explained", "findings": [finding("lst_offset", 0.27)]}))
    assert len(read_model(str(odd)).causes) == 1


def test_what_is_no_report_is_refused(tmp_path):
    with pytest.raises(UnreadableFileError, match="no report"):
        read_model(str(tmp_path / "none.json"))
    other = tmp_path / "fit.json"
    other.write_text("{}")
    with pytest.raises(BadInputError, match="another JSON file"):
        read_model(str(other))


@pytest.mark.long
def test_fit_with_a_finding_writes_the_size_and_the_model(late, report):
    done = fit(late, "--with", f"{report}#0")
    assert done.exit_code == 0, done.output
    content = json.loads((late / "fit.json").read_text())
    (cause,) = content["causes"]
    assert cause["cause"] == "lst_offset"
    assert abs(cause["size"]["value"] - 0.3) < 4 * cause["size"]["sigma"]
    assert content["provenance"]["inputs"]["model"] == read_model(f"{report}#0").id
    assert "1 adopted cause; lst_offset in station of CS002" in done.output


def test_fit_with_a_step_gave_one_c_for_the_whole_window(late, tmp_path):
    step = finding("gain_step", 0.15) | {"parameters": {"date_unix": 1.4e9}}
    path = tmp_path / "R.json"
    path.write_text(json.dumps({"verdict": "explained", "findings": [step]}))
    (late / "C.ecsv").unlink(missing_ok=True)
    refused = fit(late, "--with", f"{path}#0").exception
    assert isinstance(refused, BadInputError)
    assert "R.json#0: expected a cause that does not follow the date" in str(refused)
    assert "found gain_step on 2014-05-13 in station of CS002" in str(refused)
    assert not (late / "C.ecsv").exists()


def test_fit_without_a_model_names_none(late):
    assert fit(late).exit_code == 0
    content = json.loads((late / "fit.json").read_text())
    assert "causes" not in content
    assert "model" not in content["provenance"]["inputs"]


@pytest.mark.long
def test_investigate_with_a_finding_tells_what_is_left(late, report, monkeypatch):
    """It takes folders, and a choice from them, as `fit` does."""
    read = []
    monkeypatch.setattr("lbacal.selection.read_spectra", lambda file, now: read.append(file) or read_spectra(file, now))
    done = run(
        "investigate", late, late / "S.h5", "--station", "CS002", "--instrument", "lofar-superterp",
        "--sky-power", late / "P.json", "--report", late / "left.json", "--with", f"{report}#0",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    content = json.loads((late / "left.json").read_text())
    assert content["verdict"] == "consistent"
    assert "adopted: lst_offset in station of CS002, here 0.3" in done.output
    assert [file.name for file in read] == ["S.h5"]
    assert Model.from_report(content) == read_model(f"{report}#0")
    assert content["provenance"]["inputs"]["model"] == read_model(f"{report}#0").id


@pytest.mark.parametrize("command", ["investigate", "budget"])
def test_what_is_not_in_the_files_is_named(late, command):
    outputs = {"investigate": ("--report", late / "left.json"), "budget": ("--plot", late / "b.png")}
    done = run(command, late / "S.h5", "--year", "2010", "--instrument", "lofar-superterp", *outputs[command])
    assert "--since 2010-01-01T00:00:00Z" in str(done.exception)
    assert "of CS002" in str(done.exception)


def test_a_report_is_not_overwritten_by_what_is_made_with_it(late, report):
    done = run(
        "investigate", late / "S.h5", "--instrument", "lofar-superterp", "--report", report, "--with", f"{report}#0"
    )
    assert "the file of --with" in str(done.exception)


def test_a_model_of_spectra_is_no_model_of_a_curve(report):
    done = run("investigate", "--lst-curve", "L.csv", "--report", "R3.json", "--with", f"{report}#0")
    assert done.exit_code == 2


def test_what_a_report_leaves_open_depends_on_what_is_adopted(tmp_path):
    def left(change):
        return [{"weight": weight, "d_ln_c": {"X": [size] * 3}} for weight, size in ((1.0, change), (1.0, 0.0))]

    place = {"station": "CS002", "antennas": [1]}
    findings = [{"cause": cause, "where": place, "left_open": left(size)} for cause, size in (("a", 0.1), ("b", 0.3))]
    unexplained = {"d_ln_c": {"X": [0.7] * 3}}
    content = {"findings": findings, "stations": [{"station": "CS002", "unexplained": unexplained}]}
    path = tmp_path / "R.json"
    path.write_text(json.dumps(content))

    def sizes(text, option):
        return {one.name: np.sqrt(np.sum(one.vectors["X"] ** 2, axis=0))[0] for one in read_open_terms(text, option)}

    half, name = 0.5**0.5, "structure without a name"
    expected = {"a adopted": 0.1 * half, "b adopted": 0.3 * half, name: 0.7}
    assert sizes(str(path), "--with") == pytest.approx(expected)
    expected = {"a not adopted": 0.1 * half, "b not adopted": 0.3 * half, name: 0.7}
    assert sizes(str(path), "--left-open") == pytest.approx(expected)
    assert set(sizes(f"{path}#1", "--left-open")) == {"a not adopted", "b adopted", name}
    assert set(sizes(f"{path}#unexplained", "--with")) == {"a not adopted", "b not adopted"}
    assert read_open_terms(None) == []


@pytest.mark.parametrize("content", [None, "[]", '{"findings": 3}', '{"findings": [{}]}'])
def test_something_else_than_a_report_leaves_nothing_open_and_is_refused(tmp_path, content):
    path = tmp_path / "R.json"
    if content is not None:
        path.write_text(content)
    with pytest.raises(BadInputError, match="a report of lbacal investigate"):
        read_open_terms(f"{path}", "--left-open")
