"""The antennas of an instrument: which cable each has, and when."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from difflib import get_close_matches
from itertools import pairwise
from typing import Any

from lbacal_core.errors import BadInputError
from lbacal_core.json_values import parse_name


@dataclass(frozen=True)
class AntennaRecord:
    """One antenna and its cable, from `since` (inclusive) until `until` (exclusive), unix seconds or open.

    Attributes
    ----------
    group
        Name of the hardware that it shares with others, such as a board or a cabinet; None where nobody said.
    """

    station: str
    antenna: int
    cable: str
    since: float | None = None
    until: float | None = None
    group: str | None = None

    def covers(self, time_unix: float) -> bool:
        """Whether the record holds at an instant."""
        return (self.since is None or self.since <= time_unix) and (self.until is None or time_unix < self.until)


def require_one_at_a_time(records: Sequence[AntennaRecord], place: str) -> None:
    """Hardware changes: the records of one antenna may follow each other, never overlap."""
    order = sorted(
        range(len(records)),
        key=lambda row: (
            records[row].station,
            records[row].antenna,
            -math.inf if (since := records[row].since) is None else since,
        ),
    )
    for row, later_row in pairwise(order):
        record, later = records[row], records[later_row]
        if (record.station, record.antenna) != (later.station, later.antenna):
            continue
        if record.until is None or later.since is None or later.since < record.until:
            raise BadInputError(
                f"{place}: antennas, rows {row} and {later_row}",
                f"one record at a time for station {record.station}, antenna {record.antenna}",
                "two whose since and until overlap",
            )


def parse_record(record: Any, place: str) -> AntennaRecord:
    """Make a record from a row of an instrument file."""
    if not isinstance(record, dict) or not {"station", "antenna", "cable"} <= set(record):
        raise BadInputError(place, "station, antenna and cable", repr(record))
    for field in set(record) - {"station", "antenna", "cable", "since", "until", "group"}:
        # Other fields are somebody else's, but a misspelt `since` would give the antenna a cable at the wrong time.
        for meant in get_close_matches(field.lower(), ("since", "until", "group")):
            raise BadInputError(f"{place}: {meant}", f"the field {meant!r} or none", f"{field!r}")
    antenna = record["antenna"]
    if isinstance(antenna, bool) or not isinstance(antenna, int) or antenna < 0:
        raise BadInputError(f"{place}: antenna", "a whole number >= 0", repr(antenna))
    return AntennaRecord(
        station=parse_name(record["station"], f"{place}: station"),
        antenna=antenna,
        cable=parse_name(record["cable"], f"{place}: cable"),
        since=_instant(record.get("since"), f"{place}: since"),
        until=_instant(record.get("until"), f"{place}: until"),
        group=None if record.get("group") is None else parse_name(record["group"], f"{place}: group"),
    )


def _instant(text: Any, place: str) -> float | None:
    if text is None:
        return None
    try:
        instant = datetime.fromisoformat(text)
        return (instant if instant.tzinfo else instant.replace(tzinfo=UTC)).astimezone(UTC).timestamp()
    except (TypeError, ValueError, OverflowError) as error:
        raise BadInputError(place, "an ISO 8601 date", repr(text)) from error


def record_as_dict(record: AntennaRecord) -> dict[str, Any]:
    """The record as a row of an instrument file."""
    content: dict[str, Any] = {"station": record.station, "antenna": record.antenna, "cable": record.cable}
    for field, instant in (("since", record.since), ("until", record.until)):
        if instant is not None:
            content[field] = datetime.fromtimestamp(instant, UTC).isoformat()
    if record.group is not None:
        content["group"] = record.group
    return content
