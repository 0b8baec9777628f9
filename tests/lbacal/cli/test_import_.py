from __future__ import annotations

from pathlib import Path

import pytest

from lbacal.cli.main import run
from lbacal_core.spectra import read_spectra


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


@pytest.mark.parametrize(
    ("options", "message"),
    [
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
