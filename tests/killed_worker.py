"""A dask cluster one of whose workers is killed in the middle of its work."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import pytest

from lbacal.engine import NO_PORT, Engine


@contextmanager
def killing_one_of_two(folder: Path, place: str) -> Iterator[Engine]:
    """An engine with two workers of one thread, one of which is killed as it first calls the function at a place."""
    distributed = pytest.importorskip("distributed")
    signs = folder / "signs"
    signs.mkdir()
    module, _, name = place.rpartition(".")

    def wait_in_every_task() -> None:
        """In a worker: say that a task has begun, and go on with it when told to."""
        work = resolve_name(place)

        def work_when_told(*arguments: Any, **more: Any) -> Any:
            (signs / str(os.getpid())).touch()
            while not (signs / "go").exists():
                time.sleep(0.01)
            return work(*arguments, **more)

        setattr(resolve_name(module), name, work_when_told)

    def kill_one_at_work(victim: int) -> None:
        while not (signs / str(victim)).exists():
            time.sleep(0.01)
        os.kill(victim, signal.SIGKILL)
        (signs / "go").touch()

    cluster = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=NO_PORT, memory_limit=0
    )
    with cluster, distributed.Client(cluster.scheduler_address) as client, Engine(cluster.scheduler_address) as engine:
        client.run(wait_in_every_task)
        victim = next(iter(cluster.workers.values())).pid
        killer = threading.Thread(target=kill_one_at_work, args=(victim,), daemon=True)
        killer.start()
        yield engine
        killer.join(60.0)
        assert not killer.is_alive(), "the worker did none of the work"
