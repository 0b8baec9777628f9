"""Instants on the wire: ISO 8601 or MJD, parsed by hand so that `2014` is an error and not a second of 1970."""

from __future__ import annotations

import math
import re
import time
from datetime import UTC, date, datetime, timedelta
from typing import Any

import numpy as np

from lbacal_core.curves.validity import Instant
from lbacal_core.errors import BadInputError

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
MICROSECOND = timedelta(microseconds=1)
MJD_OF_EPOCH = 40_587
LAST_MJD = 100_000
SECOND_US, DAY_US = 1_000_000, 86_400_000_000
EXPECTED = "an ISO 8601 date or instant such as 2014-05-01 or 2014-05-01T12:30:00Z (naive = UTC)"
LOST_PLUS = " (in an address the + of a time zone is written %2B)"
FIRST = (datetime(1, 1, 1, tzinfo=UTC) - EPOCH) // MICROSECOND
LAST = (datetime(9999, 12, 31, 23, 59, 59, 999_999, tzinfo=UTC) - EPOCH) // MICROSECOND
"""What ISO 8601 can write in UTC: years 1 to 9999. No instant beyond enters."""

_INSTANT = re.compile(
    r"(?P<date>[0-9]{4}-[0-9]{2}-[0-9]{2})"
    r"(?:[T ](?P<time>[0-9]{2}:[0-9]{2}(?::[0-9]{2})?)(?:\.(?P<fraction>[0-9]{1,9}))?"
    r"(?P<zone>Z|[+-][0-9]{2}:?[0-9]{2})?)?",
    re.ASCII,
)
_MJD = re.compile(r"[0-9]{1,6}(?:\.[0-9]{0,18})?", re.ASCII)


def read_clock() -> Instant:
    """Now, in whole microseconds since 1970."""
    return time.time_ns() // 1000


def parse_instant(place: str, text: str) -> Instant:
    """Read an instant, ISO 8601, UTC unless it says otherwise; digits beyond the microsecond are cut."""
    match = _INSTANT.fullmatch(text)
    if match is None or (match["fraction"] and len(match["time"]) == 5):
        is_plus_lost = _INSTANT.fullmatch("+".join(text.rsplit(" ", 1))) is not None and match is None
        raise BadInputError(place, EXPECTED, repr(text[:60]) + (LOST_PLUS if is_plus_lost else ""))
    zone = (match["zone"] or "Z").replace("Z", "+00:00")
    try:
        moment = datetime.fromisoformat(f"{match['date']}T{match['time'] or '00:00'}{zone}")
    except ValueError as error:
        raise BadInputError(place, EXPECTED, f"{text!r} ({error})") from error
    instant = (moment - EPOCH) // MICROSECOND + int((match["fraction"] or "0").ljust(6, "0")[:6])
    if not FIRST <= instant <= LAST:
        raise BadInputError(place, "an instant of the years 1 to 9999, in UTC", repr(text))
    return instant


def parse_mjd(place: str, text: str) -> Instant:
    """Read a modified Julian date (UTC)."""
    days = float(text) if _MJD.fullmatch(text) else math.inf
    if days >= LAST_MJD:
        raise BadInputError(
            place, f"a modified Julian date between 0 and {LAST_MJD}, such as 56778.25", repr(text[:60])
        )
    return round((days - MJD_OF_EPOCH) * DAY_US)


def parse_at(at: str | None, mjd: str | None) -> Instant:
    """Read the one instant that a query asks about, given as ISO 8601 or as a modified Julian date."""
    if (at is None) == (mjd is None):
        raise BadInputError("at", "either at (ISO 8601) or mjd", "neither" if at is None else "both")
    return parse_instant("at", at) if at is not None else parse_mjd("mjd", str(mjd))


def format_time(instant: Any) -> str:
    """ISO 8601 of an astropy Time, a datetime or datetime64 (naive = UTC), a date or text, which is sent as it is."""
    if isinstance(instant, str):
        return instant
    if hasattr(instant, "utc") and hasattr(instant, "to_datetime"):
        instant = instant.utc.to_datetime(timezone=UTC)
    elif isinstance(instant, np.datetime64):
        instant = instant.astype("datetime64[us]").item()
    elif isinstance(instant, date) and not isinstance(instant, datetime):
        return instant.isoformat()
    if not isinstance(instant, datetime):
        raise BadInputError("at", "an astropy Time, a date, a datetime or ISO 8601 text", repr(instant)[:80])
    moment = instant if instant.tzinfo else instant.replace(tzinfo=UTC)
    return moment.astimezone(UTC).isoformat().replace("+00:00", "Z")


def format_instant(instant: Instant) -> str:
    """Write an instant as ISO 8601 in UTC, with microseconds only where there are any.

    An instant that the first release stored beyond the years 1 to 9999 is written as the nearest one within.
    """
    return (EPOCH + min(max(instant, FIRST), LAST) * MICROSECOND).isoformat().replace("+00:00", "Z")


def format_optional(instant: Instant | None) -> str | None:
    """Write an instant, or None for an open end."""
    return None if instant is None else format_instant(instant)
