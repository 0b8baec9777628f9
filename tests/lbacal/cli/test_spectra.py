from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import uvicorn

from lbacal.cli.main import main
from lbacal.client import Client
from lbacal_core.spectra.spectra import read_spectra
from lbacal_core.traces.trace import TraceReference
from lbacal_twin.voltages import Transmitter, digitise, draw_noise, write_frames
from service.app import make_app
from service.config import Settings
from service.factory import Factory
from service.storage.migration import upgrade

FREQUENCY = np.arange(30.0, 81.0)
BLOCKS = 60


def write_dump(folder: Path, rcu: int, start_s: int = 1_311_073_541, seed: int = 0, station: int = 11) -> Path:
    rng = np.random.default_rng([seed, rcu, start_s])
    voltage = draw_noise(np.full(51, 4.0), FREQUENCY, BLOCKS * 1024, rng)
    path = folder / f"dump_{start_s}_{rcu}.dat"
    samples = digitise(voltage, [Transmitter(45.0, 40.0, phase=float(rng.uniform(0, 6)))])
    reference = TraceReference(path, str(rcu), f"CS{station:03d}", rcu, start_s, 1024 * rcu, 200e6)
    write_frames(path, samples, reference, station)
    return path


@pytest.fixture
def dumps(tmp_path: Path) -> Path:
    folder = tmp_path / "dumps"
    folder.mkdir()
    for rcu in (10, 11, 12):
        write_dump(folder, rcu)
    return folder


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr("sys.argv", ["lbacal", "spectra", *map(str, arguments)])
    try:
        main()
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def test_a_folder_of_dumps_becomes_a_spectra_file_and_a_report(
    dumps: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "S.h5"
    assert run(monkeypatch, dumps, "--output", output) == 0
    assert "20110719T110541 CS011: 3 of 3 paths, 60-60 blocks" in capsys.readouterr().out
    found = read_spectra(output)
    assert found.event_id.tolist() == ["20110719T110541"] * 3
    assert list(zip(found.antenna.tolist(), found.dipole.tolist(), strict=True)) == [(5, "X"), (5, "Y"), (6, "X")]
    assert found.time_unix[1] == pytest.approx(1_311_073_541 + 11 * 1024 / 200e6, abs=1e-6)
    assert np.all(found.blocks == BLOCKS)
    assert np.allclose(found.power.mean(axis=1), (4 + 1 / 1200) / 50, rtol=0.05)
    report = json.loads((tmp_path / "S.h5.report.json").read_text())
    assert report["failures"] == []
    assert any(abs(line - 45.0) < 0.1 for line in report["paths"][0]["line_mhz"])


def test_a_second_run_finds_what_was_done_unless_it_changed(
    dumps: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "S.h5"
    run(monkeypatch, dumps, "--output", output)
    first = read_spectra(output).digest()
    capsys.readouterr()
    run(monkeypatch, dumps, "--output", output)
    assert "(done before)" in capsys.readouterr().out
    assert read_spectra(output).digest() == first
    run(monkeypatch, dumps, "--output", output, "--blocks", 30)
    assert "(done before)" not in capsys.readouterr().out
    changed = write_dump(dumps, 12, seed=1)
    os.utime(changed, ns=(1, 1))
    run(monkeypatch, dumps, "--output", output)
    assert "(done before)" not in capsys.readouterr().out
    assert read_spectra(output).digest() != first


def test_names_weather_and_pulse_times_come_from_the_user(
    dumps: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    output, events = tmp_path / "S.h5", tmp_path / "events.csv"
    pulse = 1_311_073_541 + (10 * 1024 + 30.5 * 1024) / 200e6
    events.write_text(f"# weather station\nevent_id,pulse_unix,temperature_c\nE1,{pulse:.9f},17.5\n")
    assert run(monkeypatch, dumps, "--output", output, "--event-id", "E1", "--events", events) == 0
    found = read_spectra(output)
    assert set(found.event_id) == {"E1"}
    assert np.all(found.environment["temperature_c"] == 17.5)
    assert found.blocks.tolist() == [BLOCKS - 11] * 3
    assert run(monkeypatch, dumps, "--output", output, "--antenna-set", "LBA_OUTER") == 0
    assert read_spectra(output).dipole.tolist() == ["Y", "X", "Y"]
    # Antenna 5 is of the outer field and antenna 6 of the inner one.
    assert run(monkeypatch, dumps, "--output", output, "--antenna-set", "LBA_SPARSE_EVEN") == 0
    assert read_spectra(output).dipole.tolist() == ["Y", "X", "X"]


def test_a_broken_file_in_a_folder_stops_nothing_and_is_told(
    dumps: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (dumps / "broken.dat").write_bytes(b"x" * 5000)
    assert run(monkeypatch, dumps, "--output", tmp_path / "S.h5") == 1
    assert "left out:" in capsys.readouterr().out
    assert len(read_spectra(tmp_path / "S.h5")) == 3
    assert len(json.loads((tmp_path / "S.h5.report.json").read_text())["failures"]) == 1


def test_bad_usage_is_one_sentence_and_exit_2(
    dumps: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    broken = dumps / "broken.dat"
    broken.write_bytes(b"x" * 5000)
    for arguments in (
        (dumps,),
        (empty, "--output", tmp_path / "S.h5"),
        (broken, "--output", tmp_path / "S.h5"),
        (dumps / "absent.dat", "--output", tmp_path / "S.h5"),
        (dumps, "--output", tmp_path / "S.h5", "--blocks", 3),
        (dumps, "--output", tmp_path / "S.h5", "--antenna-set", "LBA_OUTTER"),
    ):
        assert run(monkeypatch, *arguments) == 2
        error = capsys.readouterr().err
        assert error.startswith("lbacal: ")
        assert error.count("\n") == 1


def test_too_few_blocks_everywhere_fails_with_the_reason(
    dumps: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, dumps, "--output", tmp_path / "S.h5", "--blocks", 100) == 1
    captured = capsys.readouterr()
    assert "60, 100 are needed" in captured.out
    assert "no usable spectrum" in captured.err


def test_inspect_draws_a_trace(dumps: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    picture = tmp_path / "trace.png"
    assert run(monkeypatch, dumps, "--inspect", picture) == 0
    assert picture.stat().st_size > 20_000


@pytest.mark.shared
def test_all_real_dumps_in_one_go(shared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run(monkeypatch, shared / "data/tbb", "--output", tmp_path / "S.h5") == 0
    found = read_spectra(tmp_path / "S.h5")
    assert sorted(set(found.event_id)) == ["20080701T162002", "20110719T110541"]
    assert found.blocks.tolist() == [1978, 1000, 1000, 1000, 1000]


@pytest.fixture
def service(tmp_path: Path) -> Iterator[tuple[str, Factory]]:
    """The service itself, with an empty database, on loopback."""
    factory = Factory(Settings(database_url=str(tmp_path / "lbacal.sqlite"), instrument="lofar-superterp"))
    upgrade(factory.database)
    server = uvicorn.Server(uvicorn.Config(make_app(factory), port=0, log_level="warning", access_log=False))
    thread = threading.Thread(target=server.run)
    thread.start()
    while not server.started and thread.is_alive():
        time.sleep(0.01)
    yield f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}", factory
    server.should_exit = True
    thread.join()
    factory.database.close()


def test_spectra_go_straight_into_a_service_and_can_be_asked_for(
    service: tuple[str, Factory], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    url, factory = service
    dumps = tmp_path / "dumps"
    dumps.mkdir()
    for rcu, start_s in ((10, 1_311_073_541), (11, 1_311_073_541), (10, 1_311_080_000)):
        write_dump(dumps, rcu, start_s, station=2)
    output = tmp_path / "S.h5"
    monkeypatch.delenv("LBACAL_API_KEY", raising=False)
    assert run(monkeypatch, dumps, "--output", output, "--url", url) != 0
    assert capsys.readouterr().err.count("\n") == 1
    monkeypatch.setenv("LBACAL_API_KEY", factory.keys.create(("spectra:write", "read"))[1])
    assert run(monkeypatch, dumps, "--output", output, "--url", url) == 0
    assert "3 received, 3 stored, 0 duplicates" in capsys.readouterr().out
    assert run(monkeypatch, dumps, "--output", output, "--url", url) == 0
    assert "3 received, 0 stored, 3 duplicates" in capsys.readouterr().out
    with Client(url) as client:
        events = client.get("/v1/events")["events"]
    assert sorted(event["event_id"] for event in events) == ["20110719T110541", "20110719T125320"]
