from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from lbacal.cli.main import run
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.spectra.spectra import write_spectra
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.settings import TwinSettings


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A day of a simulated station of which antenna 3 is dead."""
    instrument = load_instrument("lofar-superterp")
    settings = TwinSettings(
        years=1 / 365.25, events_per_year=60 * 365, stations=("CS002",), antennas=10,
        event_gain_common=0.01, event_gain_path=0.01, radiometer=0.005,
    )  # fmt: skip
    campaign = simulate_campaign(settings, instrument, compute_sky_power(instrument), np.random.default_rng(8))
    spectra = campaign.spectra
    spectra.power[spectra.antenna == 3] *= 0.01
    path = tmp_path_factory.mktemp("audit") / "s.h5"
    write_spectra(spectra, path)
    return path


def call(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr("sys.argv", ["lbacal", "audit", *arguments])
    with pytest.raises(SystemExit) as left:
        run()
    return int(left.value.code or 0)


def test_the_audit_prints_a_line_a_question_writes_report_and_page_and_exits_with_3(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    report, page = tmp_path / "audit.json", tmp_path / "audit.html"
    code = call(monkeypatch, str(data), "--instrument", "lofar-superterp", "--report", str(report), "--html", str(page))
    said = capsys.readouterr().out
    assert code == 3
    assert "antenna 3 X is dead" in said
    content = json.loads(report.read_text())
    assert content["healthy"] is False
    assert {line["check"] for line in content["lines"] if line["verdict"] == "wrong"} == {"dead"}
    assert page.read_text().count("data:image/png;base64,") == 1


def test_a_file_that_is_no_data_is_refused_with_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "s.txt").write_text("power")
    assert call(monkeypatch, str(tmp_path / "s.txt"), "--instrument", "lofar-superterp") == 2
    assert "uvh5" in capsys.readouterr().err
