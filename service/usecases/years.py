"""Calendar years: the windows of the scheduled fits."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime

from lbacal_core.curves.validity import Instant
from service.storage.database import Stores
from service.wire.instants import parse_instant


def find_years(stores: Stores) -> Iterator[tuple[Instant, Instant]]:
    """The calendar years (UTC) from the first event to the last, as half-open windows."""
    span = stores.spectra.span()
    if span is None:
        return
    first, last = (datetime.fromtimestamp(instant / 1e6, UTC).year for instant in span)
    for year in range(first, last + 1):
        yield start_of_year(year), start_of_year(year + 1)


def split_years(stores: Stores, since: Instant, until: Instant) -> Iterator[tuple[Instant, Instant]]:
    """The part of a window in each calendar year from the first event to the last."""
    for first, last in find_years(stores):
        if max(first, since) < min(last, until):
            yield max(first, since), min(last, until)


def start_of_year(year: int) -> Instant:
    """The first instant of a year, UTC."""
    return parse_instant("year", f"{year}-01-01")


def end_of_year(since: Instant) -> Instant:
    """The first instant of the year after one that begins at an instant."""
    return start_of_year(datetime.fromtimestamp(since / 1e6, UTC).year + 1)
