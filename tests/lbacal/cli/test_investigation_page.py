from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from lbacal.cli.investigation_page import draw_scores, draw_structure, write_investigation_page
from lbacal.cli.main import app
from lbacal_core.discovery.report import investigate
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.lstcurve.curve import measured_curve
from lbacal_core.skypower.model import compute_sky_power
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.antenna import GainStep
from lbacal_twin.faults.cable import CableReflection
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.uncatalogued import FieldGradient, FrostAndHeat
from lbacal_twin.settings import TwinSettings
from tests.lbacal.cli.conftest import Lbacal

SETTINGS = TwinSettings(stations=("CS002",), antennas=6, events_per_year=250)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The page of a station in which one path stepped, and which follows the square of the temperature besides."""
    chain = load_instrument("lofar-superterp")
    sky = compute_sky_power(chain)
    faults = [
        GainStep(size=0.08, where=Where(antennas=(2,), dipoles=("Y",)), date="2014-08-07"),
        FrostAndHeat(size=0.09),
    ]
    spectra = simulate_campaign(SETTINGS, chain, sky, np.random.default_rng(8), faults).spectra
    content, reports = investigate(spectra, chain, sky)
    path = tmp_path_factory.mktemp("page") / "r.html"
    write_investigation_page(content, reports, path)
    return content, path.read_text(), reports


@pytest.mark.long
def test_a_finding_has_its_signature_its_maps_and_its_change_of_c(written):
    content, page, _ = written
    assert [finding["cause"] for finding in content["findings"]] == ["gain_step"]
    for words in ("signature of gain_step", "residual maps before and after", "change of C"):
        assert words in page


def test_structure_without_a_cause_the_sentence_the_gain_and_the_change_of_c_are_on_one_page(written):
    content, page, _ = written
    assert content["verdict"] == "unexplained"
    assert page.count("<img") == page.count("data:image/png;base64,") == 9
    assert "http" not in page
    for words in (
        "Residual structure that no cause explains", content["findings"][0]["sentence"], "gain on held-out events",
        "indistinguishable from", "in the median",
    ):  # fmt: skip
        assert words in page


def test_labels_of_scores_stood_at_bars_of_other_causes(written):
    (report,) = written[2]
    causes = [score.cause.identifier for score in (*report.scores, *report.antenna_scores)]
    assert len(set(causes)) < len(causes), "a cause has a score for each cable name"
    (axes,) = draw_scores(report).axes
    bars = [(bar.get_y() + bar.get_height() / 2, bar.get_width()) for bar in axes.patches]
    labels = [(label.get_position()[1], label.get_position()[0]) for label in axes.texts]
    np.testing.assert_allclose(bars, labels)
    assert [tick.get_text() for tick in axes.get_yticklabels()] == causes[::-1]


@pytest.mark.long
def test_a_static_cause_is_drawn_as_an_antenna_against_the_others(tmp_path):
    chain = load_instrument("lofar-superterp")
    sky = compute_sky_power(chain)
    settings = TwinSettings(stations=("CS002",), antennas=10, events_per_year=150)
    reflection = CableReflection(size=0.1, delay_us=0.62, phase_rad=2.2, where=Where(antennas=(7,)))
    spectra = simulate_campaign(settings, chain, sky, np.random.default_rng(8), [reflection]).spectra
    content, reports = investigate(spectra, chain, sky)
    (finding,) = content["findings"]
    assert (finding["cause"], finding["where"]["antennas"]) == ("cable_reflection", [7])
    # The delay is known modulo 1 us, and channels of 1 MHz damp it.
    assert finding["parameters"]["delay_us"] == pytest.approx(0.38, abs=0.01)
    assert finding["parameters"]["or_delay_us"] == pytest.approx(0.62, abs=0.01)
    seen = 0.1 * np.sinc(0.62) / np.sinc(0.38)
    assert abs(finding["size"]["value"] - seen) < 4 * finding["size"]["sigma"]
    assert {"cable_length", "cable_reflection"} <= {score["cause"] for score in content["scores"]["CS002"]}
    write_investigation_page(content, reports, tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text()
    assert "antenna 7 against the others of its cable" in page
    assert "with an amplitude of" in page


@pytest.mark.long
def test_what_all_paths_show_together_is_told_path_by_path(tmp_path):
    """A gradient over the field read as if one path had it: its amounts show that it grows from antenna to antenna."""
    chain = load_instrument("lofar-superterp")
    sky = compute_sky_power(chain)
    settings = replace(SETTINGS, antennas=10)
    spectra = simulate_campaign(settings, chain, sky, np.random.default_rng(8), [FieldGradient(size=0.06)]).spectra
    # One antenna died after a third of the year: it is compared with the others and has no amount.
    died = (spectra.antenna == 4) & (spectra.time_unix > np.quantile(spectra.time_unix, 1 / 3))
    spectra = spectra.select(~died)
    content, reports = investigate(spectra, chain, sky)
    told = content["unexplained"]
    assert (told["where"]["axis"], content["findings"]) == ("lst", [])
    assert " in 18 paths of CS002 together, each by its own amount and most in antenna" in told["description"]
    antennas = [int(path.split()[1]) for path in told["paths"]]
    assert (len(antennas), 4 in antennas) == (18, False)
    values = [amount["value"] for amount in told["paths"].values()]
    assert abs(np.corrcoef(antennas, values)[0, 1]) > 0.8
    assert told["paths"][told["where"]["target"]]["value"] == pytest.approx(1.0)
    panels = draw_structure(reports[0], reports[0].structure).axes
    assert [panel.get_xlabel() for panel in panels] == ["local sidereal time (h)", "frequency (MHz)", "antenna"]
    drawn = [line.get_ydata() for line in panels[2].lines if line.get_marker() == "o"]
    assert np.isfinite(np.concatenate(drawn)).sum() == 18
    write_investigation_page(content, reports, tmp_path / "r.html")
    assert told["description"] in (tmp_path / "r.html").read_text()


def investigate_curve(curve, folder):
    """The report of an LST curve, its page, and what the command printed."""
    command = ["investigate", "--lst-curve", str(curve), "--report", str(folder / "r.json")]
    result = CliRunner().invoke(app, [*command, "--html", str(folder / "r.html")])
    assert result.exit_code == 0, result.output
    return json.loads((folder / "r.json").read_text()), (folder / "r.html").read_text(), result.output


def test_an_lst_curve_has_a_page_with_its_figures_its_sentence_and_what_would_decide(tmp_path):
    report, page, printed = investigate_curve(measured_curve(), tmp_path)
    assert page.count("data:image/png;base64,") == 3
    assert report["sentence"].split(":")[0] in page
    assert "not excluded" in page
    assert report["findings"][0]["evidence"]["confirm"] in page
    assert "dipole_swap" in printed
    assert "cannot tell it from dipole_azimuth" in printed


@pytest.mark.long
def test_a_curve_without_findings_has_a_page_too(tmp_path):
    rows = [f"{lst},{np.cos(lst):.3f},{np.sin(lst):.3f},5.0" for lst in np.arange(0, 24, 0.5)]
    (tmp_path / "l.csv").write_text("\n".join(["lst_h,x_db,y_db,error_db", *rows]) + "\n")
    assert "What the simulation gets wrong" in investigate_curve(tmp_path / "l.csv", tmp_path)[1]


CURVE = ["lst-curve", str(measured_curve()), "--instrument", "instrument.json", "--sky-power", "sky_power.json"]


@pytest.mark.long
def test_the_measured_curve_ends_in_a_report_and_a_plot(folder: Path, lbacal: Lbacal) -> None:
    code, out, err = lbacal(*CURVE, "--report", "r.json", "--plot", "f.png")
    assert (code, "chi2 per point" in out) == (0, True), err
    assert json.loads((folder / "r.json").read_text())["points"] == 91
    assert (folder / "f.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--band", "90", "95"], "band: expected"),
        (["--plot", "f.xyz"], "--plot f.xyz: expected"),
        (["--instrument", "nowhere"], "unknown instrument"),
        (["--plot", "nowhere/f.png"], "a folder that exists"),
    ],
)
def test_bad_usage_is_one_sentence_and_exit_2(lbacal: Lbacal, arguments: list[str], message: str) -> None:
    code, _, err = lbacal(*CURVE, "--report", "r.json", *arguments)
    assert (code, err.count("\n"), message in err) == (2, 1, True), err


def test_a_broken_curve_is_one_sentence_and_exit_2(folder: Path, lbacal: Lbacal) -> None:
    (folder / "l.csv").write_text("lst_h,x_db\n0,1\n")
    code, _, err = lbacal("lst-curve", "l.csv", *CURVE[2:], "--report", "r.json")
    said = "lbacal: l.csv: expected the columns lst_h, x_db, y_db, error_db, found no y_db, error_db\n"
    assert (code, err) == (2, said)
