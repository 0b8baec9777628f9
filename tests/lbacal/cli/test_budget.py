from __future__ import annotations

import json

import numpy as np
import pytest

from lbacal.cli.budget import draw_budget, tabulate
from lbacal.cli.main import run
from lbacal_core.curves.covariance import Budget, BudgetTerm, parse_budget
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.spectra.spectra import write_spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings

FREQUENCY = np.array([30.0, 55.0, 80.0])
TERMS = [
    BudgetTerm("sky", "a paper", {p: np.full((1, 3), 0.11) for p in "XY"}),
    BudgetTerm("antenna gain", "another", {p: np.array([[0.03, 0.0, 0.04]]) for p in "XY"}, is_of_gain=True),
]


def test_the_table_has_a_line_a_term_and_their_sum_in_quadrature():
    lines = tabulate(FREQUENCY, TERMS)
    assert "30 MHz" in lines[0]
    assert lines[1].split() == ["sky", "11.0/11.0", "11.0/11.0", "11.0/11.0"]
    assert lines[3].split() == ["total", "11.4/11.4", "11.0/11.0", "11.7/11.7"]
    assert lines[4] == (
        "C is known best at 55 MHz, to 11.0/11.0 % (the paper: 13%); the largest term there is sky, "
        "without which 0.0/0.0 % would be left."
    )
    assert lines[5] == "C/|H| has no error of the antenna gain."


def test_the_figure_stacks_every_term_below_the_total():
    figure = draw_budget(Budget(FREQUENCY, TERMS), TERMS)
    assert [axes.get_title() for axes in figure.axes] == ["polarisation X", "polarisation Y"]
    (total,) = figure.axes[0].lines
    np.testing.assert_allclose(total.get_ydata()[0], 100 * np.hypot(0.11, 0.03))
    assert len(figure.axes[0].collections) == len(TERMS)


def test_the_command_prints_the_papers_table_and_writes_the_terms(tmp_path, capsys, monkeypatch):
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
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["lbacal", *arguments, "--plot", "B.png"])
    with pytest.raises(SystemExit) as ended:
        run()
    assert ended.value.code == 0
    out = capsys.readouterr().out
    assert "scale of the sky maps" in out
    assert "electronics between antennas" in out
    (of_finding,) = [line for line in out.splitlines() if line.startswith("lst_offset not adopted")]
    assert of_finding.split()[-6:] == ["7.1/7.1"] * 6
    ((digest, content),) = json.loads((tmp_path / "B.json").read_text()).items()
    assert parse_budget(content).digest == digest
    assert f"budget {digest}" in out
    assert (tmp_path / "B.png").read_bytes().startswith(b"\x89PNG")
