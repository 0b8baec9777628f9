from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from lbacal.cli.trace_batch import TraceBatch, Work
from lbacal.client import Client
from lbacal.engine import LOCAL, Engine
from lbacal_core.spectra.spectra import Spectra, read_spectra, write_spectra
from lbacal_core.traces.background import CleaningSettings
from lbacal_core.traces.trace import TraceReference, find_files, group_traces, list_traces
from lbacal_twin.voltages import Transmitter, digitise, draw_noise, write_frames
from service.config import Settings
from service.factory import Factory
from service.storage.migration import upgrade
from tests.killed_worker import killing_one_of_two
from tests.lbacal.cli.conftest import Lbacal
from tests.service.conftest import listening

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


def test_a_folder_of_dumps_becomes_a_spectra_file_and_a_report(dumps: Path, tmp_path: Path, lbacal: Lbacal) -> None:
    output = tmp_path / "S.h5"
    code, said, _ = lbacal("spectra", dumps, "--output", output)
    assert (code, "20110719T110541 CS011: 3 of 3 paths, 60-60 blocks" in said) == (0, True)
    found = read_spectra(output)
    assert found.event_id.tolist() == ["20110719T110541"] * 3
    assert list(zip(found.antenna.tolist(), found.dipole.tolist(), strict=True)) == [(5, "X"), (5, "Y"), (6, "X")]
    assert found.time_unix[1] == pytest.approx(1_311_073_541 + 11 * 1024 / 200e6, abs=1e-6)
    assert np.all(found.blocks == BLOCKS)
    assert np.allclose(found.power.mean(axis=1), (4 + 1 / 1200) / 50, rtol=0.05)
    report = json.loads((tmp_path / "S.h5.report.json").read_text())
    assert report["failures"] == []
    assert any(abs(line - 45.0) < 0.1 for line in report["paths"][0]["line_mhz"])


def test_a_second_run_finds_what_was_done_unless_it_changed(dumps: Path, tmp_path: Path, lbacal: Lbacal) -> None:
    output = tmp_path / "S.h5"
    command = ("spectra", dumps, "--output", output)
    lbacal(*command)
    first = read_spectra(output).digest()
    assert "(done before)" in lbacal(*command)[1]
    assert read_spectra(output).digest() == first
    assert "(done before)" not in lbacal(*command, "--blocks", 30)[1]
    changed = write_dump(dumps, 12, seed=1)
    os.utime(changed, ns=(1, 1))
    assert "(done before)" not in lbacal(*command)[1]
    assert read_spectra(output).digest() != first


def test_names_weather_and_pulse_times_come_from_the_user(dumps: Path, tmp_path: Path, lbacal: Lbacal) -> None:
    output, events = tmp_path / "S.h5", tmp_path / "events.csv"
    pulse = 1_311_073_541 + (10 * 1024 + 30.5 * 1024) / 200e6
    events.write_text(f"# weather station\nevent_id,pulse_unix,temperature_c\nE1,{pulse:.9f},17.5\n")
    assert lbacal("spectra", dumps, "--output", output, "--event-id", "E1", "--events", events)[0] == 0
    found = read_spectra(output)
    assert set(found.event_id) == {"E1"}
    assert np.all(found.environment["temperature_c"] == 17.5)
    assert found.blocks.tolist() == [BLOCKS - 11] * 3
    assert lbacal("spectra", dumps, "--output", output, "--antenna-set", "LBA_OUTER")[0] == 0
    assert read_spectra(output).dipole.tolist() == ["Y", "X", "Y"]
    # Antenna 5 is of the outer field and antenna 6 of the inner one.
    assert lbacal("spectra", dumps, "--output", output, "--antenna-set", "LBA_SPARSE_EVEN")[0] == 0
    assert read_spectra(output).dipole.tolist() == ["Y", "X", "X"]


def test_a_broken_file_in_a_folder_stops_nothing_and_is_told(dumps: Path, tmp_path: Path, lbacal: Lbacal) -> None:
    (dumps / "broken.dat").write_bytes(b"x" * 5000)
    code, said, _ = lbacal("spectra", dumps, "--output", tmp_path / "S.h5")
    assert (code, "left out:" in said) == (1, True)
    assert len(read_spectra(tmp_path / "S.h5")) == 3
    assert len(json.loads((tmp_path / "S.h5.report.json").read_text())["failures"]) == 1


def test_bad_usage_is_one_sentence_and_exit_2(dumps: Path, tmp_path: Path, lbacal: Lbacal) -> None:
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
        code, _, error = lbacal("spectra", *arguments)
        assert (code, error[:8], error.count("\n")) == (2, "lbacal: ", 1)


def test_too_few_blocks_everywhere_fails_with_the_reason(dumps: Path, tmp_path: Path, lbacal: Lbacal) -> None:
    code, out, err = lbacal("spectra", dumps, "--output", tmp_path / "S.h5", "--blocks", 100)
    assert (code, "60, 100 are needed" in out, "no usable spectrum" in err) == (1, True, True)


def test_inspect_draws_a_trace(dumps: Path, tmp_path: Path, lbacal: Lbacal) -> None:
    picture = tmp_path / "trace.png"
    code, said, _ = lbacal("spectra", dumps, "--inspect", picture)
    assert (code, said.startswith(f"wrote {picture}: ")) == (0, True)
    assert picture.stat().st_size > 20_000


@pytest.mark.shared
def test_all_real_dumps_in_one_go(shared: Path, tmp_path: Path, lbacal: Lbacal) -> None:
    assert lbacal("spectra", shared / "data/tbb", "--output", tmp_path / "S.h5")[0] == 0
    found = read_spectra(tmp_path / "S.h5")
    assert sorted(set(found.event_id)) == ["20080701T162002", "20110719T110541"]
    assert found.blocks.tolist() == [1978, 1000, 1000, 1000, 1000]


@pytest.fixture
def service(tmp_path: Path) -> Iterator[tuple[str, Factory]]:
    """The service itself, with an empty database, on loopback."""
    factory = Factory(Settings(database_url=str(tmp_path / "lbacal.sqlite"), instrument="lofar-superterp"))
    upgrade(factory.database)
    with listening(factory) as url:
        yield url, factory
    factory.database.close()


def test_spectra_go_straight_into_a_service_and_can_be_asked_for(
    service: tuple[str, Factory], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lbacal: Lbacal
) -> None:
    url, factory = service
    dumps = tmp_path / "dumps"
    dumps.mkdir()
    for rcu, start_s in ((10, 1_311_073_541), (11, 1_311_073_541), (10, 1_311_080_000)):
        write_dump(dumps, rcu, start_s, station=2)
    output = tmp_path / "S.h5"
    monkeypatch.delenv("LBACAL_API_KEY", raising=False)
    command = ("spectra", dumps, "--output", output, "--url", url)
    code, _, err = lbacal(*command)
    assert (code != 0, err.count("\n")) == (True, 1)
    monkeypatch.setenv("LBACAL_API_KEY", factory.keys.create(("spectra:write", "read"))[1])
    for told in ("3 received, 3 stored, 0 duplicates", "3 received, 0 stored, 3 duplicates"):
        code, said, _ = lbacal(*command)
        assert (code, told in said) == (0, True)
    with Client(url) as client:
        events = client.get("/v1/events")["events"]
    assert sorted(event["event_id"] for event in events) == ["20110719T110541", "20110719T125320"]


def test_a_file_without_spectra_is_not_ingested(tmp_path: Path, lbacal: Lbacal) -> None:
    """0 spectra were said to be sent, without a question to the server."""
    frequency_mhz, none = np.arange(30.0, 81.0), np.zeros(0)
    of_rows = dict.fromkeys(("event_id", "station", "dipole"), none.astype(str))
    counts = dict.fromkeys(("antenna", "blocks"), none.astype(int))
    empty = Spectra(frequency_mhz=frequency_mhz, power=np.zeros((0, 51)), time_unix=none, **of_rows, **counts)
    write_spectra(empty, tmp_path / "S.h5")
    code, _, err = lbacal("ingest", tmp_path / "S.h5")
    assert (code, err) == (2, "lbacal: S.h5: expected spectra, found none\n")


def test_a_folder_of_tables_becomes_a_spectra_file(tmp_path: Path, lbacal: Lbacal) -> None:
    folder = tmp_path / "tables"
    folder.mkdir()
    for hour in range(3):
        lines = [f"# time: 2014-05-01T0{hour}:00:00Z", "frequency_mhz,0X,0Y", "40,1,2", "41,3,4"]
        (folder / f"{hour}.csv").write_text("\n".join(lines))
    output = tmp_path / "S.h5"
    code, said, _ = lbacal("import", folder, "--output", output, "--station", "CS002")
    assert (code, "6 spectra, 3 intervals of 900 s" in said, "no station" in said) == (0, True, False)
    spectra = read_spectra(output)
    assert len(spectra) == 6
    assert set(spectra.station.tolist()) == {"CS002"}


def test_events_of_a_trigger_stay_single_and_keep_their_names_and_flags(tmp_path: Path, lbacal: Lbacal) -> None:
    source, output = tmp_path / "events.csv", tmp_path / "S.h5"
    rows = [
        f"2014-05-01T03:0{k // 2}:{30 * (k % 2):02d}Z,{antenna},X,2,shower {k},{'storm' if k == 1 else ''},{20 + k},1,2"
        for k in range(3)
        for antenna in (4, 5)
    ]
    source.write_text("\n".join(["time,antenna,dipole,duration_s,event_id,flag,env/temperature_c,40,41", *rows]))
    code, said, _ = lbacal("import", source, "--output", output, "--events", "--station", "CS002")
    assert code == 0
    assert "6 spectra, 3 events from 3 integrations" in said
    assert "2 spectra are flagged 'storm'" in said
    spectra = read_spectra(output)
    assert spectra.event_id.tolist() == ["shower 0"] * 2 + ["shower 2"] * 2
    assert spectra.left_out == {"storm": 2}
    assert spectra.environment["temperature_c"].tolist() == [20.0, 20.0, 22.0, 22.0]
    assert np.diff(spectra.time_unix).tolist() == [0.0, 60.0, 0.0]


@pytest.mark.parametrize(
    ("options", "events", "words"),
    [
        ([], ["20140501T030000", "first", "second"], "3 events or intervals of 900 s (2 with an event_id)"),
        (["--events"], ["20140501T030001", "20140501T030101", "first", "second"], "4 events"),
        (["--average", "900"], ["20140501T030000"], "1 intervals of 900 s"),
    ],
)
def test_integrations_that_have_names_are_averaged_only_on_request(
    tmp_path: Path, lbacal: Lbacal, options: list[str], events: list[str], words: str
) -> None:
    source, output = tmp_path / "events.csv", tmp_path / "S.h5"
    named = ["", "first", "second", "second", ""]
    rows = [f"2014-05-01T03:00:{20 * k + 1:02d}Z,4,X,2,{name},{k + 1},2" for k, name in enumerate(named[:3])]
    rows += [f"2014-05-01T03:01:{k:02d}Z,4,X,2,{name},{k + 4},2" for k, name in enumerate(named[3:])]
    source.write_text("\n".join(["time,antenna,dipole,duration_s,event_id,40,41", *rows]))
    code, said, _ = lbacal("import", source, "--output", output, *options)
    assert code == 0
    assert words in said
    assert "the data name no station: it is called ST001 (--station gives its name)" in said
    spectra = read_spectra(output)
    assert sorted(spectra.event_id.tolist()) == events
    if not options:
        powers = dict(zip(spectra.event_id.tolist(), spectra.power[:, 0].tolist(), strict=True))
        assert powers == {"20140501T030000": 3.0, "first": 2.0, "second": 3.5}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--events", "--average", "60"], "average or events"),
        (["--average", "0"], "average: expected a number > 0"),
        (["--channel-mhz", "1", "--instrument", "lofar-superterp"], "instrument or channel"),
        (["--band", "60", "80"], "some between 40 and 41 MHz"),
        (["--output", "S.txt"], "--output S.txt: expected a name that ends in .h5, .hdf5, found .txt"),
    ],
)
def test_options_that_make_no_sense_are_refused_with_2(
    tmp_path: Path, lbacal: Lbacal, options: list[str], message: str
) -> None:
    source = tmp_path / "a.csv"
    source.write_text("# time: 2014-05-01T00:00:00Z\nfrequency_mhz,0X\n40,1\n41,3\n")
    code, _, err = lbacal("import", source, "--output", "S.h5", *options)
    assert (code, message in err) == (2, True)
    assert not (tmp_path / "S.h5").exists()


EVENTS = 12


@pytest.fixture
def work(tmp_path: Path) -> list[Work]:
    folder = tmp_path / "dumps"
    folder.mkdir()
    for event in range(EVENTS):
        rng = np.random.default_rng(event)
        path = folder / f"{event:02d}.dat"
        samples = digitise(draw_noise(np.full(51, 4.0), np.arange(30.0, 81.0), 400 * 1024, rng))
        write_frames(path, samples, TraceReference(path, "10", "CS011", 10, 1_311_073_541 + 60 * event, 0, 200e6), 11)
    references = [reference for file in find_files([folder]) for reference in list_traces(file)]
    return [(event, None) for event in group_traces(references)]


def test_a_failing_event_is_reported_and_the_rest_done(work: list[Work], tmp_path: Path) -> None:
    work[3][0].references[0].path.unlink()
    batch = TraceBatch([item for k, item in enumerate(work) if k != 3][:3], CleaningSettings(), tmp_path / "parts")
    assert sum(not isinstance(result, str) for _, result, _ in batch.run()) == 3
    vanished = work[4][0].references[0].path
    vanished.write_bytes(vanished.read_bytes()[:2000])
    results = [result for _, result, _ in TraceBatch(work[4:6], CleaningSettings(), tmp_path / "parts").run()]
    assert isinstance(results[0], str)
    assert "2000 bytes" in results[0]
    assert not isinstance(results[1], str)


def test_a_run_that_stops_midway_keeps_what_it_did(work: list[Work], tmp_path: Path) -> None:
    batch = TraceBatch(work[:4], CleaningSettings(), tmp_path / "parts")
    run = batch.run()
    first = [next(run), next(run)]
    run.close()  # as when the process is stopped
    assert [is_old for _, _, is_old in first] == [False, False]
    again = list(batch.run())
    assert [is_old for _, _, is_old in again] == [True, True, False, False]
    assert [result for _, result, _ in again[:2]] == [result for _, result, _ in first]
    assert not list((tmp_path / "parts").glob("*.unfinished"))


@pytest.mark.long
def test_a_dask_worker_killed_midway_loses_nothing(work: list[Work], tmp_path: Path) -> None:
    batch = TraceBatch(work, CleaningSettings(), tmp_path / "here")
    here = {event.event_id: result for event, result, _ in batch.run()}
    with killing_one_of_two(tmp_path, "lbacal.cli.trace_batch.measure_background") as engine:
        run = TraceBatch(work, CleaningSettings(), tmp_path / "there").run(engine)
        results = {event.event_id: result for event, result, _ in run}
    assert len(results) == EVENTS
    assert results == here


@pytest.mark.long
def test_dask_on_this_machine_measures_the_same(work: list[Work], tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    here, there = (TraceBatch(work, CleaningSettings(), tmp_path / name) for name in ("here", "there"))
    with Engine(LOCAL) as engine:
        of_dask = {event.event_id: result for event, result, _ in there.run(engine)}
    assert of_dask == {event.event_id: result for event, result, _ in here.run()}
