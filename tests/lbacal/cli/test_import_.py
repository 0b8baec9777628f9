from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lbacal.cli.main import run
from lbacal_core.spectra.spectra import read_spectra


def call(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr("sys.argv", ["lbacal", "import", *arguments])
    with pytest.raises(SystemExit) as left:
        run()
    return int(left.value.code or 0)


def test_a_folder_of_tables_becomes_a_spectra_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "tables"
    folder.mkdir()
    for hour in range(3):
        lines = [f"# time: 2014-05-01T0{hour}:00:00Z", "frequency_mhz,0X,0Y", "40,1,2", "41,3,4"]
        (folder / f"{hour}.csv").write_text("\n".join(lines))
    output = tmp_path / "S.h5"
    assert call(monkeypatch, str(folder), "--output", str(output), "--station", "CS002") == 0
    spectra = read_spectra(output)
    assert len(spectra) == 6
    assert set(spectra.station.tolist()) == {"CS002"}
    assert "6 spectra, 3 intervals of 900 s" in capsys.readouterr().out


def test_events_of_a_trigger_stay_single_and_keep_their_names_and_flags(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    source, output = tmp_path / "events.csv", tmp_path / "S.h5"
    rows = [
        f"2014-05-01T03:0{k // 2}:{30 * (k % 2):02d}Z,{antenna},X,2,shower {k},{'storm' if k == 1 else ''},{20 + k},1,2"
        for k in range(3)
        for antenna in (4, 5)
    ]
    source.write_text("\n".join(["time,antenna,dipole,duration_s,event_id,flag,env/temperature_c,40,41", *rows]))
    assert call(monkeypatch, str(source), "--output", str(output), "--events", "--station", "CS002") == 0
    said = capsys.readouterr().out
    assert "6 spectra, 3 events from 3 integrations" in said
    assert "2 spectra are flagged 'storm'" in said
    spectra = read_spectra(output)
    assert spectra.event_id.tolist() == ["shower 0"] * 2 + ["shower 2"] * 2
    assert spectra.left_out == {"storm": 2}
    assert spectra.environment["temperature_c"].tolist() == [20.0, 20.0, 22.0, 22.0]
    assert np.diff(spectra.time_unix).tolist() == [0.0, 60.0, 0.0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--events", "--average", "60"], "--average or --events"),
        (["--average", "0"], "--average: expected a number > 0"),
        (["--channel-mhz", "1", "--instrument", "lofar-superterp"], "--instrument or --channel-mhz"),
        (["--band", "60", "80"], "some between 40 and 41 MHz"),
    ],
)
def test_options_that_make_no_sense_are_refused_with_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], options: list[str],
    message: str,
) -> None:  # fmt: skip
    source = tmp_path / "a.csv"
    source.write_text("# time: 2014-05-01T00:00:00Z\nfrequency_mhz,0X\n40,1\n41,3\n")
    assert call(monkeypatch, str(source), "--output", str(tmp_path / "S.h5"), *options) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "S.h5").exists()
