from __future__ import annotations

import csv
import io
import json
import re
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from lbacal.analysis.budget import ErrorBudget, draw_budget
from lbacal.analysis.result import align
from lbacal.cli.main import app
from lbacal.pages.chart import Chart, Series, plot_charts
from lbacal.pages.curves import draw_residuals
from lbacal.pages.finding import draw_finding, draw_scores, draw_sentence, draw_station, tell_finding
from lbacal.pages.fit import (
    average_residuals,
    describe_error,
    draw_c,
    draw_fit,
    draw_page,
    explain_chi2,
    tabulate_curves,
)
from lbacal.pages.report import draw_investigation, list_origin
from lbacal_core.calibration.one_event import ErrorOfC
from lbacal_core.curves.covariance import Budget, BudgetTerm, parse_budget
from lbacal_core.curves.curves import CalibrationCurve, FitReport
from lbacal_core.discovery.report import investigate
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.lstcurve.curve import measured_curve
from lbacal_core.pipeline import calibrate
from lbacal_core.provenance import Provenance
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.power import compute_sky_power
from lbacal_core.sky.table import SkyPower
from lbacal_core.spectra.spectra import Spectra, write_spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.faults.fault import Where
from lbacal_twin.faults.hardware import CableReflection, GainStep
from lbacal_twin.faults.uncatalogued import FieldGradient, FrostAndHeat
from lbacal_twin.settings import TwinSettings
from tests.lbacal.cli.conftest import Lbacal

FREQUENCY = np.arange(30.0, 81.0)
C = np.full(51, 2e-5)
ORIGIN = list_origin("S.h5", provenance={"notes": {"sky_power": "sky gsm"}})
CHARTS = [Chart("C, polarisation X", "frequency (MHz)", "C (µV per ADC unit)", [])]


def report(curves: int) -> FitReport:
    budget = Budget(FREQUENCY, (BudgetTerm("sky <level>", "a test", {"X": np.full((1, 51), 0.06)}),))
    made = [
        CalibrationCurve("CS002", k, "X", "converged", 900, FREQUENCY, C, 0.01 * C, 0.1 * C, 1.1, 1.0, {})
        for k in range(curves)
    ]
    provenance = Provenance({"spectra": "abc"}, {}, notes={"sky_power": "sky gsm"})
    return FitReport(tuple(made), provenance, budgets={budget.digest: budget})


def test_the_page_is_one_file_with_table_budget_figure_and_the_number() -> None:
    page = draw_page(report(2), CHARTS, ORIGIN, ["error of C for one event on one antenna: 11 %"])
    assert re.findall(r"""(?:src|href)=["'](?!data:|#)""", page) == []
    assert "<figcaption>C, polarisation X</figcaption>" in page
    for text in ("of S.h5</h1>", "for one event on one antenna: 11 %", "CS002 antenna 1 X", "sky gsm", "6.0"):
        assert text in page
    assert "sky &lt;level&gt;" in page
    assert "<details>" not in page


def test_many_curves_are_folded_away_below_their_summary() -> None:
    page = draw_page(report(40), CHARTS, ORIGIN, ["number"])
    assert "All 40 curves" in page
    assert page.index("CS002 X") < page.index("<details>") < page.index("CS002 antenna 39 X")


def curve(antenna: int = 3, dipole: str = "X", **changes: Any) -> CalibrationCurve:
    one = CalibrationCurve(
        "CS002", antenna, dipole, "converged", 900, FREQUENCY, C, 0.01 * C, 0.1 * C, 1.13, 0.97, {},
        chi2_per_dof_profiled=0.87,
    )  # fmt: skip
    return replace(one, **changes)


def failed() -> CalibrationCurve:
    return curve(
        antenna=4, status="too_few_events", c=None, c_sigma_stat=None, c_sigma_sys=None, chi2_per_dof=None,
        chi2_per_dof_profiled=None, events=20,
    )  # fmt: skip


def test_a_few_curves_have_a_row_each_with_chi2_and_both_errors() -> None:
    header, row, other = tabulate_curves([curve(), failed()])
    assert header[:7] == ["", "curves", "events", "LST", "chi2/dof", "sky free", "flagged"]
    assert header[7:] == [f"C({nu} MHz), µV ±stat.% ±syst.%" for nu in (30, 55, 80)]
    assert row[:7] == ["CS002 antenna 3 X", "converged", "900", "0.97", "1.13", "0.87", "0 of 51"]
    assert row[7] == "20 ±1.0 ±10"
    assert other[:3] == ["CS002 antenna 4 X", "too_few_events", "20"]
    assert len({len(one) for one in (header, row, other)}) == 1
    lines = align([header, row, other])
    assert lines[1].index("converged") > lines[1].index("antenna")


def test_many_curves_are_told_by_station_and_polarisation() -> None:
    curves = [curve(k, dipole, chi2_per_dof=1.0 + 0.01 * k) for k in range(20) for dipole in "XY"]
    curves[4] = replace(failed(), antenna=2)
    _, x, y = tabulate_curves(curves)
    assert (x[0], y[0]) == ("CS002 X", "CS002 Y")
    assert x[1] == "19 converged, 1 too_few_events"
    assert x[4] == "1.00-1.19"


def test_a_flagged_channel_is_counted_and_one_without_a_value_is_outside() -> None:
    flag = ("outside", "uncertain", *["ok"] * 49)
    c = C.copy()
    c[0] = np.nan
    _, row = tabulate_curves([curve(flag=flag, c=c, c_sigma_stat=0.01 * c, c_sigma_sys=0.1 * c)])
    assert row[6:8] == ["2 of 51", "outside"]


def test_what_chi2_means_is_said_with_the_numbers_of_these_channels() -> None:
    sentence = explain_chi2([curve(), curve(chi2_per_dof=2.0)])
    assert "1.0 ± 0.2 (48 degrees of freedom)" in sentence
    assert "above 1.6 the systematic error of a curve is widened (1 here)" in sentence
    assert "(0 here)" in sentence


def test_one_number_for_one_event_on_one_antenna() -> None:
    sentence = describe_error(ErrorOfC(0.01, 0.1, 0.0, 0.025))
    assert sentence == (
        "error of C for one event on one antenna: 10.4 % (statistical 1.0 %, systematic 10.0 %, gain of an event "
        "2.5 %); for the mean of the events: 10.0 %"
    )
    assert "single antennas 1.6 %" in describe_error(ErrorOfC(0.002, 0.1, 0.016, 0.025))


@pytest.mark.parametrize("error", [ErrorOfC(0.01, 0.1, 0.0, np.nan), ErrorOfC(0.01, 0.1, np.nan, 0.02)])
def test_an_unknown_part_makes_the_number_unknown(error: ErrorOfC) -> None:
    assert describe_error(error).startswith("error of C for one event on one antenna: unknown (")


INSTRUMENT = load_instrument("lofar-superterp")


@pytest.fixture(scope="module")
def sky() -> SkyPower:
    return compute_sky_power(INSTRUMENT)


@pytest.fixture(scope="module")
def spectra(sky: SkyPower) -> Spectra:
    settings = TwinSettings(stations=("CS002", "CS003"), antennas=3, events_per_year=250)
    return simulate_campaign(settings, INSTRUMENT, sky, np.random.default_rng(1)).spectra


@pytest.mark.parametrize("scope", ["antenna", "station", "array"])
@pytest.mark.long
def test_residuals_of_every_scope_are_small_where_the_chain_is_right(
    spectra: Spectra, sky: SkyPower, scope: str
) -> None:
    report = calibrate(spectra, Simulation(INSTRUMENT), scope)
    maps = average_residuals(spectra, report.curves, Simulation(INSTRUMENT, sky))
    assert sorted(maps) == ["X", "Y"]
    for one in maps.values():
        assert one.shape == (48, 51)
        # gains of events of 5 % in bins of a few events
        assert np.nanmedian(np.abs(one)) < 0.04
    charts = draw_fit(report, maps, Simulation(INSTRUMENT, sky))
    c, residuals, noise, chi2 = charts[::2]
    (line,) = [one for one in c.series if one.kind == "line" and one.name in OF_X]
    own = [curve.c for curve in report.curves if curve.dipole == "X"]
    np.testing.assert_allclose(line.y, 1e6 * np.nanmedian(own, axis=0))
    assert sum(one.kind == "band" for one in c.series) == 2
    np.testing.assert_array_equal(residuals.series[0].image, 100 * maps["X"])
    assert [one.name for one in noise.series] == ["sky, mean over LST", "N_LNA", "N_RCU", "N_ADC"]
    assert {"noise alone", "sky and pattern free", "expected of noise, 95 %"} <= {one.name for one in chi2.series}
    plot_charts(charts).canvas.draw()


OF_X = ("X: median of 6 curves", "X: median of 2 curves", "array X")


def test_lines_and_images_over_time_are_drawn_within_their_dates() -> None:
    days = 1.4e9, 1.41e9
    series = [Series("line", days, (1.0, 2.0)), Series("image", days, (0.0, 2.0), image=np.eye(2))]
    figure = plot_charts([Chart(one.kind, "date", "y", [one], ("time", "linear"), days) for one in series])
    figure.canvas.draw()
    for axes in figure.axes[:2]:
        np.testing.assert_allclose(axes.get_xlim(), np.array(days) / 86400.0)


def test_a_fit_without_any_curve_is_drawn_empty(spectra: Spectra, sky: SkyPower) -> None:
    few = spectra.select(np.isin(spectra.event_id, np.unique(spectra.event_id)[:10]))
    report = calibrate(few, Simulation(INSTRUMENT), "antenna")
    assert all(curve.c is None for curve in report.curves)
    maps = average_residuals(few, report.curves, Simulation(INSTRUMENT, sky))
    plot_charts(draw_fit(report, maps, Simulation(INSTRUMENT, sky))).canvas.draw()


def test_flagged_channels_are_marked_and_bands_hold_both_errors() -> None:
    chart = draw_c([curve(flag=("uncertain", *["ok"] * 50))])
    total, stat = (one for one in chart.series if one.kind == "band")
    np.testing.assert_allclose(total.high / 20.0 - 1.0, np.hypot(0.01, 0.1))
    np.testing.assert_allclose(stat.high / 20.0 - 1.0, 0.01)
    (flagged,) = [one for one in chart.series if one.name == "flagged"]
    assert flagged.titles == ["CS002 antenna 3 X 30 MHz: uncertain"]


def test_a_map_of_residuals_has_a_row_an_hour_of_the_day_and_a_column_a_channel() -> None:
    values = 0.001 * np.add.outer(100 * np.arange(24), np.arange(51))
    chart = draw_residuals("of a path", FREQUENCY, values, 3.0)
    _, *rows = csv.reader(io.StringIO(chart.csv()))
    told = {(float(nu), float(hour)): float(name.removeprefix("% ")) for name, nu, hour, *_ in rows}
    expected = {(30.0 + c, h + 0.5): 0.1 * (100 * h + c) for h in range(24) for c in range(51)}
    assert told == pytest.approx(expected)
    assert (chart.title, chart.x_label, chart.y_label) == ("of a path", "frequency (MHz)", "local sidereal time (h)")
    assert (chart.y_limits, chart.series[0].limit) == ((0.0, 24.0), 3.0)


FREQUENCY_OF_BUDGET = np.array([30.0, 55.0, 80.0])
TERMS = [
    BudgetTerm("sky", "a paper", {p: np.full((1, 3), 0.11) for p in "XY"}),
    BudgetTerm("antenna gain", "another", {p: np.array([[0.03, 0.0, 0.04]]) for p in "XY"}, is_of_gain=True),
]


def test_the_table_has_a_row_a_term_and_their_sum_in_quadrature():
    budget = ErrorBudget.of(Budget(FREQUENCY_OF_BUDGET, TERMS))
    head, *rows = budget.rows
    assert "30 MHz" in head
    assert rows[0] == ["sky", "11.0/11.0", "11.0/11.0", "11.0/11.0"]
    assert rows[2] == ["total", "11.4/11.4", "11.0/11.0", "11.7/11.7"]
    assert budget.notes == [
        (
            "C is known best at 55 MHz, to 11.0/11.0 % (the paper: 13%); the largest term there is sky, "
            "without which 0.0/0.0 % would be left."
        ),
        "C/|H| has no error of the antenna gain.",
    ]
    assert len(budget.table) == 2 * 2 * 3


def test_the_figure_stacks_every_term_below_the_total():
    charts = draw_budget(Budget(FREQUENCY_OF_BUDGET, TERMS))
    assert [chart.title for chart in charts] == [
        *(f"polarisation {p}, added in quadrature" for p in "XY"),
        "terms of the error of C",
    ]
    *terms, total = charts[0].series
    np.testing.assert_allclose(total.y[0], 100 * np.hypot(0.11, 0.03))
    assert [one.name for one in terms] == [term.name for term in TERMS]
    np.testing.assert_array_equal([terms[0].low, terms[1].low, terms[1].high], [np.zeros(3), terms[0].high, total.y])


def test_small_terms_of_a_budget_are_one_band_and_nothing_is_lost():
    many = [BudgetTerm(f"term {k}", "a paper", {"X": np.full((1, 3), 0.01 * k)}) for k in range(1, 8)]
    of_x, every = draw_budget(Budget(FREQUENCY_OF_BUDGET, many))
    assert [one.name for one in of_x.series] == ["term 7", "term 6", "term 5", "term 4", "term 3", "2 more", "total"]
    assert len({one.colour for one in of_x.series}) == len(of_x.series), "each is found in the legend by its colour"
    np.testing.assert_allclose(of_x.series[-1].y, 100 * np.sqrt(sum((0.01 * k) ** 2 for k in range(1, 8))))
    assert len(every.rows) == 1 + len(many)


@pytest.mark.long
def test_the_command_prints_the_papers_table_and_writes_the_terms(tmp_path, lbacal):
    instrument = load_instrument("lofar-superterp")
    settings = TwinSettings(stations=("CS002",), antennas=4, events_per_year=300)
    campaign = simulate_campaign(settings, instrument, compute_sky_power(instrument), np.random.default_rng(1))
    write_spectra(campaign.spectra, tmp_path / "S.h5")
    finding = {
        "cause": "lst_offset",
        "where": {"station": "CS002", "antennas": [0, 1, 2, 3]},
        "left_open": [{"weight": 1.0, "d_ln_c": {p: [0.071] * 51 for p in "XY"}}],
    }
    (tmp_path / "R.json").write_text(json.dumps({"findings": [finding], "stations": []}))
    arguments = ["budget", "S.h5", "--instrument", "lofar-superterp", "--sky", "paper", "--report", "B.json"]
    arguments += ["--left-open", "R.json"]
    code, out, _ = lbacal(*arguments, "--plot", "B.png")
    assert code == 0
    assert "scale of the sky maps" in out
    assert "electronics between antennas" in out
    (of_finding,) = [line for line in out.splitlines() if line.startswith("lst_offset not adopted")]
    assert of_finding.split()[-6:] == ["7.1/7.1"] * 6
    ((digest, content),) = json.loads((tmp_path / "B.json").read_text()).items()
    saved = parse_budget(content)
    assert saved.digest == digest
    total = [100 * float(saved.variance(p)[-1]) ** 0.5 for p in "XY"]
    (printed,) = [line.split()[-1] for line in out.splitlines() if line.startswith("total")]
    assert printed == "/".join(f"{one:.1f}" for one in total)
    assert f"budget {digest}" in out
    assert (tmp_path / "B.png").read_bytes().startswith(b"\x89PNG")


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
    content, _ = investigate(spectra, Simulation(chain, sky))
    path = tmp_path_factory.mktemp("page") / "r.html"
    path.write_text(draw_investigation(content))
    return content, path.read_text()


@pytest.mark.long
def test_a_finding_has_its_sentence_its_facts_and_its_figures_on_one_page(written):
    content, page = written
    (finding,) = content["findings"]
    assert finding["cause"] == "gain_step"
    figures = draw_finding(finding)
    assert [*figures][:4] == ["course", "law", "before 0", "after 0"]
    of_station = draw_station(content["stations"][0], content["scores"]["CS002"])
    withdrawn = [chart for one in content["unexplained"]["similar_to"] for chart in draw_finding(one)]
    first, *_ = content["unexplained"]["sentences"]
    said = draw_sentence(first)
    assert [*said] == ["course", "law"]
    assert page.count("<svg ") == len([*figures, *of_station, *withdrawn, *said])
    for text in (
        finding["sentence"],
        *(escape(chart.title) for chart in figures.values()),
        *dict(tell_finding(finding)),
    ):
        assert text in page
    assert "http" not in page
    before, after = (figures[f"{name} 0"].series[0] for name in ("before", "after"))
    assert before.limit == after.limit
    assert np.nanstd(after.image) < 0.7 * np.nanstd(before.image)


@pytest.mark.long
def test_structure_without_a_cause_is_drawn_below_its_sentence(written):
    content, page = written
    assert content["verdict"] == "unexplained"
    assert content["unexplained"]["description"] in page
    assert {"structure", "spectrum"} <= set(draw_station(content["stations"][0]))


@pytest.mark.long
def test_labels_of_scores_stood_at_bars_of_other_causes(written):
    scores = written[0]["scores"]["CS002"]
    assert len({one["cause"] for one in scores}) < len(scores), "a cause has a score for each cable name"
    chart = draw_scores(scores)
    drawn = dict(zip(chart.rows, chart.series[0].x, strict=True))
    for one in scores:
        named = f"{one['cause']}, {one['target']}"
        assert drawn.get(named, abs(one["score_sigma"])) == pytest.approx(abs(one["score_sigma"]))
    assert chart.series[0].x == sorted(chart.series[0].x, reverse=True)


@pytest.mark.long
def test_points_of_a_step_stood_above_the_curve_of_the_step():
    """Points relative to the mean chain of the window, and a curve relative to that of before, differ by the step."""
    chain = load_instrument("lofar-superterp")
    sky = compute_sky_power(chain)
    step = GainStep(size=-0.3, where=Where(antennas=(1,), dipoles=("X",)), date="2014-08-07")
    settings = replace(SETTINGS, antennas=3, events_per_year=120)
    spectra = simulate_campaign(settings, chain, sky, np.random.default_rng(8), [step]).spectra
    content, _ = investigate(spectra, Simulation(chain, sky))
    (finding,) = content["findings"]
    law = finding["evidence"]["picture"]["law"]
    observed, sigma, expected = (np.array(law[name]) for name in ("observed", "sigma", "expected"))
    # against a step of 30 % seen in half a year, the points would stand 15 % above
    scale = np.sum(observed * expected / sigma**2) / np.sum(expected**2 / sigma**2)
    assert scale == pytest.approx(1.0, abs=0.06)


@pytest.mark.long
def test_a_static_cause_is_drawn_as_an_antenna_against_the_others(tmp_path):
    chain = load_instrument("lofar-superterp")
    sky = compute_sky_power(chain)
    settings = TwinSettings(stations=("CS002",), antennas=10, events_per_year=150)
    reflection = CableReflection(size=0.1, delay_us=0.62, phase_rad=2.2, where=Where(antennas=(7,)))
    spectra = simulate_campaign(settings, chain, sky, np.random.default_rng(8), [reflection]).spectra
    content, _ = investigate(spectra, Simulation(chain, sky))
    (finding,) = content["findings"]
    assert (finding["cause"], finding["where"]["antennas"]) == ("cable_reflection", [7])
    # The delay is known modulo 1 us, and channels of 1 MHz damp it.
    assert finding["parameters"]["delay_us"] == pytest.approx(0.38, abs=0.01)
    assert finding["parameters"]["or_delay_us"] == pytest.approx(0.62, abs=0.01)
    seen = 0.1 * np.sinc(0.62) / np.sinc(0.38)
    assert abs(finding["size"]["value"] - seen) < 4 * finding["size"]["sigma"]
    assert {"cable_length", "cable_reflection"} <= {score["cause"] for score in content["scores"]["CS002"]}
    (tmp_path / "r.html").write_text(draw_investigation(content))
    page = (tmp_path / "r.html").read_text()
    assert "antenna 7 less the others of its cable" in page
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
    content, _ = investigate(spectra, Simulation(chain, sky))
    told = content["unexplained"]
    assert (told["where"]["axis"], content["findings"]) == ("lst", [])
    assert " in 18 paths of CS002 together, each by its own amount and most in antenna" in told["description"]
    antennas = [int(path.split()[1]) for path in told["paths"]]
    assert (len(antennas), 4 in antennas) == (18, False)
    values = [amount["value"] for amount in told["paths"].values()]
    assert abs(np.corrcoef(antennas, values)[0, 1]) > 0.8
    assert told["paths"][told["where"]["target"]]["value"] == pytest.approx(1.0)
    figures = draw_station(content["stations"][0])
    labels = [figures[name].x_label for name in ("structure", "spectrum", "amounts")]
    assert labels == ["local sidereal time (h)", "frequency (MHz)", "antenna"]
    assert sum(len(one.y) for one in figures["amounts"].series) == 18
    (tmp_path / "r.html").write_text(draw_investigation(content))
    assert told["description"] in (tmp_path / "r.html").read_text()


def investigate_curve(curve, folder):
    """The report of an LST curve, its page, and what the command printed."""
    command = ["investigate", "--lst-curve", str(curve), "--report", str(folder / "r.json")]
    result = CliRunner().invoke(app, [*command, "--html", str(folder / "r.html")])
    assert result.exit_code == 0, result.output
    return json.loads((folder / "r.json").read_text()), (folder / "r.html").read_text(), result.output


@pytest.mark.long
def test_an_lst_curve_has_a_page_with_its_figures_its_sentence_and_what_would_decide(tmp_path):
    report, page, printed = investigate_curve(measured_curve(), tmp_path)
    assert page.count("<svg ") == 2 * 3 + 1 + 2
    assert "data:image" not in page
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
    code, out, err = lbacal(*CURVE, "--report", "report", "--plot", "f.png")
    assert (code, "chi2 per point" in out) == (0, True), err
    assert json.loads((folder / "report").read_text())["points"] == 91, "JSON, whatever its name"
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
