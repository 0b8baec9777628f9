from __future__ import annotations

import os
import pickle

import pytest

from lbacal.engine import HERE, LOCAL, NO_PORT, Engine, EngineAwayError
from lbacal_core.errors import BadInputError, LbacalError, MissingExtraError
from lbacal_core.provenance import Remembered


def divide(owner: Remembered[str, int], number: int, by: int) -> tuple[float, int, int]:
    """The quotient, who made it, and what the owner has in memory there."""
    return number / by, os.getpid(), owner.get("process", os.getpid)


def test_work_is_done_here_unless_dask_is_named() -> None:
    with Engine() as engine:
        found = dict(engine.spread(divide, Remembered(1), ((k, 2) for k in range(3))))
    assert found == {k: (k / 2, os.getpid(), os.getpid()) for k in range(3)}
    with pytest.raises(ZeroDivisionError):
        HERE.call(divide, Remembered(1), 1, 0)


@pytest.mark.parametrize("error", [BadInputError("x.h5", "a number", "none"), MissingExtraError("this", "that")])
def test_an_error_arrives_from_another_process_as_it_was_raised(error: LbacalError) -> None:
    again = pickle.loads(pickle.dumps(error))  # noqa: S301 - our own
    assert (type(again), str(again), vars(again)) == (type(error), str(error), vars(error))


@pytest.mark.long
def test_other_processes_keep_the_owner_and_what_it_remembers_and_tell_their_errors() -> None:
    pytest.importorskip("distributed")
    owner = Remembered[str, int](1)
    owner.get("process", os.getpid)
    with Engine(LOCAL), Engine(LOCAL) as engine:
        assert engine.slots == os.cpu_count()
        found = dict(engine.spread(divide, owner, ((k, 2) for k in range(20))))
        assert [found[k][0] for k in range(20)] == [k / 2 for k in range(20)]
        assert all(maker == kept != os.getpid() for _, maker, kept in found.values())
        again = engine.call(divide, owner, 1, 2)
        assert again[1] == again[2]
        with pytest.raises(ZeroDivisionError):
            engine.call(divide, owner, 1, 0)
        assert dict(engine.spread(divide, owner, [(1, 0)], failed=repr)) == {0: "ZeroDivisionError('division by zero')"}


@pytest.mark.long
def test_a_scheduler_that_is_gone_is_one_sentence() -> None:
    distributed = pytest.importorskip("distributed")
    import dask

    with dask.config.set({"distributed.comm.timeouts.connect": 2.0}):
        with pytest.raises(EngineAwayError, match="no dask scheduler answers"):
            Engine("tcp://127.0.0.1:1")
        cluster = distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=NO_PORT)
        with Engine(cluster.scheduler_address) as engine:
            assert engine.call(divide, Remembered(1), 1, 2)[0] == 0.5
            cluster.close()
            with pytest.raises(EngineAwayError, match="gone"):
                engine.call(divide, Remembered(1), 1, 2)
