"""Where work is done that outgrows one process: here, or by the workers of a dask scheduler.

Work is a function of an owner and of an item. The owner (settings, a simulation) is sent once to each process and stays
in its memory, with all that it remembers; what an item is made into comes back as soon as it is done.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from importlib.util import find_spec
from itertools import islice
from types import TracebackType
from typing import Any, Self, TypeVar

from lbacal_core.errors import LbacalError, MissingExtraError

LOCAL = "local"
"""In the place of an address: dask's workers are processes of this machine, one a core."""
NO_PORT = "127.0.0.1:0"
"""Where a local cluster shows itself: on a port of its own, since without an address dask takes 8787 for all."""
AHEAD = 2
"""Items for each thread of the workers that are sent and not yet done."""

Owner = TypeVar("Owner")
Result = TypeVar("Result")


class EngineAwayError(LbacalError, code="engine_away"):
    """The dask scheduler that work was sent to is gone; what was not done there is to be done again."""


class Engine:
    """Does work here where no address is given, else on dask; the work of a process that dies goes to another.

    Parameters
    ----------
    address
        That of a dask scheduler, or `LOCAL`.
    """

    def __init__(self, address: str | None = None) -> None:
        self.address = address
        self._client: Any = None if address is None else _connect(address)
        self._owners: dict[int, tuple[Any, Any]] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self._client is not None:
            self._client.close()

    def __reduce__(self) -> tuple[Any, ...]:
        return Engine, ()  # what is sent elsewhere does its own work there

    @property
    def slots(self) -> int:
        """How much can be done at once: 1 here, and the threads that the workers have now."""
        if self._client is None:
            return 1
        with self._asking():
            return max(1, sum(map(int, self._client.nthreads().values())))

    def call(self, function: Callable[..., Result], owner: Any, *of: Any) -> Result:
        """`function(owner, *of)`, wherever it is done."""
        ((_, result),) = self.spread(function, owner, [of])
        return result

    def spread(
        self,
        function: Callable[..., Result],
        owner: Any,
        items: Iterable[tuple[Any, ...]],
        failed: Callable[[BaseException], Result] | None = None,
    ) -> Iterator[tuple[int, Result]]:
        """`function(owner, *item)` of each item, with its number, as soon as it is done.

        Parameters
        ----------
        failed
            Makes a result of what went wrong on dask; without it that is raised, as it is here.
        """
        if self._client is None:
            yield from ((k, function(owner, *item)) for k, item in enumerate(items))
            return
        from distributed import as_completed

        kept, rest, numbers, done = self._keep(owner), enumerate(items), dict[Any, int](), as_completed()

        def send() -> None:
            for k, item in islice(rest, max(0, AHEAD * self.slots - len(numbers))):
                with self._asking():
                    future = self._client.submit(function, kept, *item, pure=False)
                numbers[future] = k
                done.add(future)

        send()
        for future in done:
            number = numbers.pop(future)
            if future.status != "error":
                with self._asking():
                    result = future.result()
            elif failed is None:
                raise future.exception()
            else:
                result = failed(future.exception())
            yield number, result
            send()

    def _keep(self, owner: Owner) -> Any:
        """Keep an owner in the memory of the workers: as the result of work, which is done again where it was lost."""
        if id(owner) not in self._owners:
            with self._asking():
                self._owners[id(owner)] = owner, self._client.submit(_return, owner, pure=False)
        return self._owners[id(owner)][1]

    @contextmanager
    def _asking(self) -> Iterator[None]:
        """Say in one sentence that the scheduler does not answer, or forgot what it was sent."""
        try:
            yield
        except (CancelledError, OSError, RuntimeError) as error:
            raise EngineAwayError(f"the dask scheduler {self.address} is gone") from error


HERE = Engine()


def read_address(given: str | None = None) -> str | None:
    """The address that a command was given, or that of LBACAL_DASK; None without either."""
    return given or os.environ.get("LBACAL_DASK") or None


def _connect(address: str) -> Any:
    if find_spec("distributed") is None:
        raise MissingExtraError(f"work on dask ({address})", "dask")
    import dask
    from distributed import Client

    # by itself dask warns of more than 10 MB, and a station's year is more
    dask.config.set({"distributed.admin.large-graph-warning-threshold": "1GB"})
    try:
        return Client(threads_per_worker=1, dashboard_address=NO_PORT) if address == LOCAL else Client(address)
    except OSError as error:
        raise EngineAwayError(f"no dask scheduler answers at {address}") from error


def _return(value: Owner) -> Owner:
    return value
