"""What every request for jobs has in common: its window, and how much one key may have waiting."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from lbacal_core.curves.validity import Instant
from lbacal_core.errors import BadInputError
from service.errors import ConflictError, TooLargeError, TooManyError
from service.storage.database import Stores
from service.storage.jobs import Order
from service.wire.instants import parse_instant

RETRY_S = 60.0


@dataclass(frozen=True)
class Limits:
    """What one key may ask for: open parts at once, and the longest window of a fit."""

    open_parts: int
    window_days: float


def read_window(since: str, until: str) -> tuple[Instant, Instant]:
    """Read the half-open window of a body."""
    first, last = parse_instant("body.since", since), parse_instant("body.until", until)
    if last <= first:
        raise BadInputError("body.until", "an instant after since", until)
    return first, last


def place_order(stores: Stores, order: Order, limits: Limits, clock: Callable[[], Instant]) -> int:
    """Enqueue a job that somebody asked for, and return its number."""
    if len(order.parts) > limits.open_parts:
        raise TooLargeError(
            f"the order has {len(order.parts)} parts (one a station, of an investigation one a station and year), and "
            f"{limits.open_parts} fit (LBACAL_MAX_OPEN_PARTS): ask for single stations or a shorter window, one after "
            "the other"
        )
    waiting = stores.jobs.count_open(order.by)
    if waiting + len(order.parts) > limits.open_parts:
        raise TooManyError(
            f"{waiting} parts of jobs of {order.by} wait or run, and {len(order.parts)} more would be above "
            f"{limits.open_parts} (LBACAL_MAX_OPEN_PARTS)", RETRY_S
        )  # fmt: skip
    number = stores.jobs.add(order, clock())
    if number is None:
        raise ConflictError("the job could not be made")
    return number
