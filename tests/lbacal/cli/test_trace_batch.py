from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lbacal.cli.trace_batch import TraceBatch, Work
from lbacal_core.traces.background import CleaningSettings
from lbacal_core.traces.trace import TraceReference, find_files, group_traces, list_traces
from lbacal_twin.voltages import digitise, draw_noise, write_frames

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
    distributed = pytest.importorskip("distributed")
    here = dict(_by_event(TraceBatch(work, CleaningSettings(), tmp_path / "here")))
    signs = tmp_path / "signs"
    signs.mkdir()

    def wait_in_every_task() -> None:
        """In a worker: say that a task has begun, and go on with it when told to."""
        from lbacal.cli import trace_batch

        measure = trace_batch.measure_background

        def measure_when_told(*arguments: Any) -> Any:
            (signs / str(os.getpid())).touch()
            while not (signs / "go").exists():
                time.sleep(0.01)
            return measure(*arguments)

        trace_batch.measure_background = measure_when_told

    def kill_one_at_work(victim: int) -> None:
        while not (signs / str(victim)).exists():
            time.sleep(0.01)
        os.kill(victim, signal.SIGKILL)
        (signs / "go").touch()

    cluster = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, memory_limit=0
    )
    with cluster, distributed.Client(cluster.scheduler_address) as client:
        client.run(wait_in_every_task)
        victim = next(iter(cluster.workers.values())).pid
        killer = threading.Thread(target=kill_one_at_work, args=(victim,), daemon=True)
        killer.start()
        run = TraceBatch(work, CleaningSettings(), tmp_path / "there").run(cluster.scheduler_address)
        results = {event.event_id: result for event, result, _ in run}
        killer.join()
    assert len(results) == EVENTS
    for name, records in here.items():
        assert results[name] == records


def _by_event(batch: TraceBatch) -> list[tuple[str, object]]:
    return [(event.event_id, result) for event, result, _ in batch.run()]
