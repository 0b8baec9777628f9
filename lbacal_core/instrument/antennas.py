"""What an instrument states of its antennas: where stations stand, letters of dipoles, cables by date, and G_ant."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.errors import BadInputError, refuse_misspelt
from lbacal_core.foreign import parse_instant, parse_name, parse_number, parse_numbers, parse_optional_name
from lbacal_core.grids import Floats
from lbacal_core.provenance import as_json

# The letters of dipoles: any short name, such as X, Y or EW; an instrument says which arms they are.

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_+-]{0,7}", re.ASCII)
EXPECTED = "a letter or name of up to 8 letters and digits"
RESERVED = frozenset({"sky", "antenna", "dipoles", "hashes", "versions"})
"""Fields of a sky power file that would be names of dipoles."""


def is_dipole_name(name: str) -> bool:
    """Whether a dipole may bear this name."""
    return bool(_NAME.fullmatch(name)) and name not in RESERVED


def are_dipole_names(names: NDArray[np.str_]) -> NDArray[np.bool_]:
    """Whether dipoles may bear these names, shape as given."""
    found, at = np.unique(names, return_inverse=True)
    return np.asarray(np.array([is_dipole_name(str(name)) for name in found], dtype=bool)[at])


def look_like_radians(azimuth_deg: Collection[float]) -> bool:
    """Whether arms of different azimuths all lie within 2 pi: nobody builds dipoles a few degrees apart."""
    return len(set(azimuth_deg)) > 1 and max(abs(azimuth) for azimuth in azimuth_deg) <= 2.0 * np.pi


# Where a station stands, if that is not where its instrument stands.

RANGES = {"latitude_deg": (-90.0, 90.0), "longitude_deg": (-180.0, 360.0), "height_m": (-500.0, 9000.0)}


@dataclass(frozen=True)
class Site:
    """Geodetic latitude and longitude, degrees, east positive, and height above the ellipsoid, m."""

    latitude_deg: float
    longitude_deg: float
    height_m: float

    def require_on_earth(self, place: str) -> None:
        """Refuse a site that is nowhere."""
        for field, (low, high) in RANGES.items():
            value = getattr(self, field)
            if not low <= value <= high:
                is_other = field == "latitude_deg" and low <= self.longitude_deg <= high
                hint = f"; longitude is {self.longitude_deg:g}: are the two exchanged?" if is_other else ""
                raise BadInputError(f"{place}: {field}", f"{low:g} to {high:g}", f"{value:g}{hint}")


def parse_sites(content: Any, place: str, height_m: float) -> dict[str, Site]:
    """Read the sites of stations, by name; a station without a height stands at that of the instrument."""
    if content is None:
        return {}
    if not isinstance(content, Mapping) or not all(isinstance(one, Mapping) for one in content.values()):
        raise BadInputError(place, "an object of latitude_deg and longitude_deg by station", "another shape")
    return {
        str(station): Site(
            parse_number(one.get("latitude_deg"), f"{place}.{station}.latitude_deg"),
            parse_number(one.get("longitude_deg"), f"{place}.{station}.longitude_deg"),
            parse_number(one.get("height_m", height_m), f"{place}.{station}.height_m"),
        )
        for station, one in content.items()
    }


# The antennas of an instrument: which cable each has, and when.


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

    def covers(self, first_unix: float, last_unix: float | None = None) -> bool:
        """Whether the record holds at an instant, or at one of those from it to another."""
        last = first_unix if last_unix is None else last_unix
        return (self.since is None or self.since <= last) and (self.until is None or first_unix < self.until)


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
    refuse_misspelt(place, record, [field.name for field in fields(AntennaRecord)])
    antenna = record["antenna"]
    if isinstance(antenna, bool) or not isinstance(antenna, int) or antenna < 0:
        raise BadInputError(f"{place}: antenna", "a whole number >= 0", repr(antenna))
    since, until = (
        None if record.get(end) is None else parse_instant(record[end], f"{place}: {end}") for end in ("since", "until")
    )
    return AntennaRecord(
        station=parse_name(record["station"], f"{place}: station"),
        antenna=antenna,
        cable=parse_name(record["cable"], f"{place}: cable"),
        since=since,
        until=until,
        group=parse_optional_name(record.get("group"), f"{place}: group"),
    )


def record_as_dict(record: AntennaRecord) -> dict[str, Any]:
    """The record as a row of an instrument file."""
    content: dict[str, Any] = {"station": record.station, "antenna": record.antenna, "cable": record.cable}
    for field, instant in (("since", record.since), ("until", record.until)):
        if instant is not None:
            content[field] = datetime.fromtimestamp(instant, UTC).isoformat()
    if record.group is not None:
        content["group"] = record.group
    return content


# What is known of an antenna gain: where its numbers come from, and how far they may be off.

ABSOLUTE, RELATIVE = "absolute", "relative"
"""What an antenna gain is: in m^2 by itself, or tied to something else by a factor or a shape."""


@dataclass(frozen=True)
class GainProvenance:
    """Where the numbers of an antenna gain come from, and how far they may be off.

    Attributes
    ----------
    kind
        ``absolute``: G_ant is in m^2 by itself, from a table of voltage per field. ``relative``: its level or its shape
        was chosen so that something else agrees.
    source
        What it was made from, in words.
    shape_error, scale_error
        One standard deviation of ln G_ant, shape (freq,), and that of its common factor; None where nobody knows.
    antenna_sha256
        Digest of the antenna model that it was taken from; None where it is that of no model.
    """

    kind: str
    source: str
    shape_error: Floats | None = None
    scale_error: float | None = None
    antenna_sha256: str | None = None

    def __str__(self) -> str:
        """Describe it for a user."""
        known = [
            "unknown" if error is None else f"{100 * error:.0f} % ({name})"
            for name, error in (
                ("shape, at most", None if self.shape_error is None else float(self.shape_error.max())),
                ("common factor", self.scale_error),
            )
        ]
        return f"{self.kind}: {self.source}; error of ln G_ant {', '.join(dict.fromkeys(known))}"

    def as_dict(self) -> dict[str, Any]:
        """The provenance as JSON values; what is not known is absent."""
        return {name: as_json(value) for name, value in vars(self).items() if value is not None}


def parse_gain_provenance(content: Any, channels: int, place: str) -> GainProvenance | None:
    """Make the provenance from the content of an instrument file; None where it says nothing."""
    if content is None:
        return None
    if not isinstance(content, dict):
        raise BadInputError(place, "an object with kind and source", type(content).__name__)
    refuse_misspelt(place, content, [field.name for field in fields(GainProvenance)])
    kind = content.get("kind")
    if kind not in (ABSOLUTE, RELATIVE):
        raise BadInputError(f"{place}: kind", f"{ABSOLUTE} or {RELATIVE}", repr(kind))
    shape, scale = content.get("shape_error"), content.get("scale_error")
    errors = np.empty(0) if shape is None else parse_numbers(shape if isinstance(shape, list) else [shape], place)
    scale_error = None if scale is None else parse_number(scale, f"{place}: scale_error")
    for field, values in (("shape_error", errors), ("scale_error", np.array([scale_error or 0.0]))):
        wrong = values[~((values >= 0) & (values <= 1))]
        if wrong.size:
            raise BadInputError(f"{place}: {field}", "a fraction, 0 to 1 (0.1 for 10 %)", f"{wrong[0]:g}")
    return GainProvenance(
        kind=kind,
        source=parse_name(content.get("source"), f"{place}: source"),
        shape_error=None if shape is None else (errors if isinstance(shape, list) else np.full(channels, errors[0])),
        scale_error=scale_error,
        antenna_sha256=parse_optional_name(content.get("antenna_sha256"), f"{place}: antenna_sha256"),
    )
