"""What every request for jobs has in common: its window, and how much one key may have waiting."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from lbacal.instants import parse_instant
from lbacal_core.curves.validity import Instant
from lbacal_core.errors import BadInputError
from lbacal_core.provenance import MODEL_VERSION, canonical_json, hash_arrays
from lbacal_core.spectra.blocks import Recorded
from service.errors import ConflictError, TooManyError
from service.storage.database import Database, Stores
from service.storage.jobs import Job, Order
from service.storage.keys import Deed

if TYPE_CHECKING:
    from lbacal_core.simulation.simulation import Simulation

RETRY_S = 60.0


def read_window(since: str, until: str) -> tuple[Instant, Instant]:
    """Read the half-open window of a body."""
    first, last = parse_instant("body.since", since), parse_instant("body.until", until)
    if last <= first:
        raise BadInputError("body.until", "an instant after since", until)
    return first, last


def place_order(stores: Stores, order: Order, most: int, clock: Callable[[], Instant]) -> int:
    """Enqueue a job that somebody asked for, of whom at most so many parts may wait, and return its number."""
    waiting = stores.jobs.count_open(order.by)
    if waiting and waiting + len(order.parts) > most:  # a larger order is taken when nothing else waits
        raise TooManyError(
            f"{waiting} parts of jobs of {order.by} wait or run, and {len(order.parts)} more would be above "
            f"{most} (LBACAL_MAX_OPEN_PARTS)", RETRY_S
        )  # fmt: skip
    number = stores.jobs.add(order, clock())
    if number is None:
        raise ConflictError("the job could not be made")
    return number


def stop_job(database: Database, now: Instant, number: int, by: str, reason: str | None = None) -> Job:
    """Stop a job; what it has already stored stays."""
    with database.write() as stores:
        stores.jobs.cancel(number, now, by, reason)
        return stores.jobs.get(number)


# What a fit is made with besides spectra: the scheduler names it in the part, and only a worker that has it may begin.
#
# Otherwise a worker with another sky file than the scheduler's would make calibrations that nobody asked for.

SHOWN = 12
"""Digits of a hash that a sentence shows."""


@dataclass(frozen=True)
class Inputs:
    """Hashes of instrument and sky power, and the model version."""

    instrument: str
    sky_power: str
    model_version: int = MODEL_VERSION

    @property
    def text(self) -> str:
        """As it is stored and compared."""
        return canonical_json(asdict(self))


def name_inputs(simulation: Simulation) -> Inputs:
    """Name the inputs of this process."""
    return Inputs(simulation.instrument.digest(), simulation.sky_power.digest())


def hash_covariates(spectra: Recorded) -> str:
    """The hash of the covariates of spectra, which their own digest leaves out."""
    names = sorted(spectra.environment)
    return hash_arrays(names, *(spectra.environment[name] for name in names))


def explain_difference(needed: str, found: str) -> str:
    """In which inputs two processes differ, in words."""
    wanted, own = json.loads(needed), json.loads(found)
    return ", ".join(
        f"{name.replace('_', ' ')} {str(wanted[name])[:SHOWN]} (here {str(own.get(name))[:SHOWN]})"
        for name in wanted
        if wanted[name] != own.get(name)
    )


# Idempotent requests: one that is repeated because its answer was lost is answered again and not done again.

LONGEST_NAME = 200


def do_once(
    database: Database, now: Instant, by: str, name: str | None, request: bytes, do: Callable[[], bytes]
) -> bytes:
    """Execute a request and return its answer, or the stored answer of the same idempotency key.

    Request and answer are one transaction: if the answer cannot be written, the request has no effect.

    Parameters
    ----------
    name
        The `Idempotency-Key` that the caller chose; None does it in any case.
    request
        What was asked, whole; something else under the same name is a conflict.
    """
    if name is None:
        with database.write():
            return do()
    _require_printable(name)
    with database.write() as stores:
        earlier = stores.deeds.begin(by, name, _digest(request), now)
        if earlier is not None:
            return _answer_of(earlier, name, request)
        answer = do()
        stores.deeds.end(by, name, answer.decode())
        return answer


def recall_answer(database: Database, by: str, name: str | None, request: bytes) -> bytes | None:
    """The stored answer of an idempotency key, for requests that take long to work out; None if there is none."""
    if name is None:
        return None
    _require_printable(name)
    earlier = database.look(lambda stores: stores.deeds.find(by, name))
    return None if earlier is None else _answer_of(earlier, name, request)


def _require_printable(name: str) -> None:
    if not (0 < len(name) <= LONGEST_NAME and name.isprintable()):
        raise BadInputError("Idempotency-Key", f"1 to {LONGEST_NAME} printable characters", repr(name[:60]))


def _digest(request: bytes) -> str:
    return hashlib.sha256(request).hexdigest()


def _answer_of(earlier: Deed, name: str, request: bytes) -> bytes:
    if earlier.request_sha256 != _digest(request):
        raise ConflictError(f"something else was asked under the Idempotency-Key {name!r}")
    return earlier.answer.encode()
