from __future__ import annotations

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from lbacal.cli.main import app
from lbacal_core.lstcurve.curve import measured_curve


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("curve")
    command = ["investigate", "--lst-curve", str(measured_curve()), "--report", str(folder / "r.json")]
    result = CliRunner().invoke(app, [*command, "--html", str(folder / "r.html")])
    assert result.exit_code == 0, result.output
    return json.loads((folder / "r.json").read_text()), (folder / "r.html").read_text(), result.output


@pytest.mark.long
def test_an_lst_curve_has_a_page_with_its_three_figures(written):
    _, page, _ = written
    assert page.count("data:image/png;base64,") == 3


def test_the_page_says_the_sentence_the_alternatives_and_what_would_decide(written):
    report, page, _ = written
    assert report["sentence"].split(":")[0] in page
    assert "not excluded" in page
    assert report["findings"][0]["evidence"]["confirm"] in page


def test_the_command_prints_what_was_found_and_what_it_cannot_be_told_from(written):
    _, _, printed = written
    assert "dipole_swap" in printed
    assert "cannot tell it from dipole_azimuth" in printed


@pytest.mark.long
def test_a_curve_without_findings_has_a_page_too(tmp_path):
    rows = [f"{lst},{np.cos(lst):.3f},{np.sin(lst):.3f},5.0" for lst in np.arange(0, 24, 0.5)]
    (tmp_path / "l.csv").write_text("\n".join(["lst_h,x_db,y_db,error_db", *rows]) + "\n")
    command = ["investigate", "--lst-curve", str(tmp_path / "l.csv"), "--report", str(tmp_path / "r.json")]
    result = CliRunner().invoke(app, [*command, "--html", str(tmp_path / "r.html")])
    assert result.exit_code == 0, result.output
    assert "What the simulation gets wrong" in (tmp_path / "r.html").read_text()
