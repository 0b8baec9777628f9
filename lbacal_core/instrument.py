"""The instrument: where it stands, its dipoles, and the simulated and measured parts of its signal chain."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from difflib import get_close_matches
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from lbacal_core.antenna_gain import ABSOLUTE, RELATIVE, GainProvenance
from lbacal_core.errors import BadInputError, UnknownNameError, UnreadableFileError
from lbacal_core.grids import Floats, require_channels
from lbacal_core.provenance import hash_content

DIPOLES = ("X", "Y")


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


@dataclass(frozen=True)
class Instrument:
    """Everything about the signal chain that comes from simulations, data sheets and measurements.

    Attributes
    ----------
    frequency_mhz
        Shape (freq,), MHz.
    dipole_azimuth_deg
        Azimuth of each dipole's arm, degrees from north through east.
    antenna_gain, receiver_gain
        G_ant and G_RCU of eq. full_chain, shape (freq,), linear power.
    cables
        L_coax by cable name, shape (freq,), the factor <= 1 that multiplies the power.
    antenna, sky
        Antenna model and sky model, by name or file, that the package's own P_sky is computed with unless others are
        given; None where the instrument names none.
    gain_provenance
        What `antenna_gain` is; None where nobody says.
    """

    name: str
    latitude_deg: float
    longitude_deg: float
    height_m: float
    frequency_mhz: Floats
    dipole_azimuth_deg: Mapping[str, float]
    antenna_gain: Floats
    receiver_gain: Floats
    cables: Mapping[str, Floats]
    antennas: Sequence[AntennaRecord]
    antenna: str | None = None
    sky: str | None = None
    gain_provenance: GainProvenance | None = None

    def __post_init__(self) -> None:
        place = f"instrument {self.name}"
        require_channels(place, self.frequency_mhz)
        for field, low, high in (
            ("latitude_deg", -90.0, 90.0),
            ("longitude_deg", -180.0, 360.0),
            ("height_m", -500.0, 9000.0),
        ):
            value = getattr(self, field)
            if not low <= value <= high:
                raise BadInputError(f"{place}: {field}", f"{low:g} to {high:g}", f"{value}")
        if set(self.dipole_azimuth_deg) != set(DIPOLES):
            raise BadInputError(f"{place}: dipoles", "X and Y", ", ".join(self.dipole_azimuth_deg) or "none")
        for dipole, azimuth in self.dipole_azimuth_deg.items():
            if not np.isfinite(azimuth):
                raise BadInputError(f"{place}: dipoles.{dipole}.azimuth_deg", "finite degrees", f"{azimuth}")
        self._require_gain("antenna_gain", self.antenna_gain, np.inf)
        self._require_gain("receiver_gain", self.receiver_gain, np.inf)
        self._require_shape_error()
        for cable, loss in self.cables.items():
            self._require_gain(f"cables.{cable}", loss, 1.0)
        for row, record in enumerate(self.antennas):
            if record.cable not in self.cables:
                raise BadInputError(
                    f"{place}: antennas, row {row}: cable", f"one of {', '.join(self.cables)}", repr(record.cable)
                )
            if record.since is not None and record.until is not None and record.since >= record.until:
                raise BadInputError(f"{place}: antennas, row {row}: until", "a date after since", "one that is not")
        self._require_one_record_at_a_time()

    def _require_one_record_at_a_time(self) -> None:
        """Hardware changes: the records of one antenna may follow each other, never overlap."""
        order = sorted(
            range(len(self.antennas)),
            key=lambda row: (
                self.antennas[row].station,
                self.antennas[row].antenna,
                -math.inf if self.antennas[row].since is None else self.antennas[row].since,
            ),
        )
        for row, later_row in pairwise(order):
            record, later = self.antennas[row], self.antennas[later_row]
            if (record.station, record.antenna) != (later.station, later.antenna):
                continue
            if record.until is None or later.since is None or later.since < record.until:
                raise BadInputError(
                    f"instrument {self.name}: antennas, rows {row} and {later_row}",
                    f"one record at a time for station {record.station}, antenna {record.antenna}",
                    "two whose since and until overlap",
                )

    def _require_shape_error(self) -> None:
        error = None if self.gain_provenance is None else self.gain_provenance.shape_error
        if error is not None and error.shape != self.frequency_mhz.shape:
            place = f"instrument {self.name}: antenna_gain_provenance.shape_error"
            raise BadInputError(place, "a number a channel, or one", f"{error.size}")

    def _require_gain(self, field: str, values: Floats, largest: float) -> None:
        place = f"instrument {self.name}: {field}"
        if values.shape != self.frequency_mhz.shape:
            raise BadInputError(place, f"{self.frequency_mhz.size} numbers, one a channel", f"shape {values.shape}")
        bad = np.flatnonzero(~(np.isfinite(values) & (values > 0) & (values <= largest)))
        if bad.size:
            expected = "a finite power factor > 0" + (" and <= 1" if largest == 1.0 else "")
            raise BadInputError(f"{place}, channel {bad[0]}", expected, f"{values[bad[0]]}")

    def cable_of(self, station: str, antenna: int, time_unix: float) -> str:
        """Name of the cable of an antenna at an instant."""
        return self.cables_between(station, antenna, time_unix, time_unix)[0]

    def cables_between(self, station: str, antenna: int, first_unix: float, last_unix: float) -> list[str]:
        """Names of the cables that an antenna had from one instant to another, each once."""
        place = f"station {station}, antenna {antenna}"
        records = [r for r in self.antennas if r.station == station and r.antenna == antenna]
        if not records:
            raise BadInputError(place, f"an antenna of instrument {self.name}", "no such antenna")
        for instant in (first_unix, last_unix):
            if not any(record.covers(instant) for record in records):
                raise BadInputError(
                    place,
                    f"a cable on record in instrument {self.name} at {datetime.fromtimestamp(instant, UTC):%Y-%m-%d}",
                    "records of other dates only",
                )
        held = [
            r
            for r in records
            if (r.since is None or r.since <= last_unix) and (r.until is None or first_unix < r.until)
        ]
        return list(dict.fromkeys(record.cable for record in held))

    def group_between(self, station: str, antenna: int, first_unix: float, last_unix: float) -> str | None:
        """Name of the group of an antenna from one instant to another; None where it has none, or changes it."""
        held = {
            record.group
            for record in self.antennas
            if (record.station, record.antenna) == (station, antenna)
            and (record.since is None or record.since <= last_unix)
            and (record.until is None or first_unix < record.until)
        }
        return held.pop() if len(held) == 1 else None

    def as_dict(self) -> dict[str, Any]:
        """The content of an instrument file (docs/formats.md)."""
        return {
            "name": self.name,
            "latitude_deg": self.latitude_deg,
            "longitude_deg": self.longitude_deg,
            "height_m": self.height_m,
            "frequency_mhz": self.frequency_mhz.tolist(),
            "dipoles": {dipole: {"azimuth_deg": value} for dipole, value in self.dipole_azimuth_deg.items()},
            "antenna_gain": self.antenna_gain.tolist(),
            "receiver_gain": self.receiver_gain.tolist(),
            "cables": {name: loss.tolist() for name, loss in self.cables.items()},
            "antennas": [_record_as_dict(record) for record in self.antennas],
            **({} if self.antenna is None else {"antenna": self.antenna}),
            **({} if self.sky is None else {"sky": self.sky}),
            **({} if self.gain_provenance is None else {"antenna_gain_provenance": self.gain_provenance.as_dict()}),
        }

    def digest(self) -> str:
        """Hash of the numbers, which names the instrument in provenance and version ids.

        The names of sky and antenna are not in it, because P_sky brings hashes of its own, nor is what is said about
        the antenna gain.
        """
        words = ("antenna", "sky", "antenna_gain_provenance")
        return hash_content({name: value for name, value in self.as_dict().items() if name not in words})

    def view_digest(self) -> str:
        """Hash of what P_sky takes from an instrument: its place, the arms of its dipoles and its channels."""
        return hash_content([self.latitude_deg, dict(self.dipole_azimuth_deg), self.frequency_mhz.tolist()])

    @property
    def antenna_gain_note(self) -> str:
        """What is known of the antenna gain, in words."""
        return (
            "unchecked: the instrument does not say what its antenna_gain is"
            if self.gain_provenance is None
            else (str(self.gain_provenance))
        )


def load_instrument(name_or_file: str) -> Instrument:
    """Load an instrument that ships with the package by its name, or any other from its JSON file."""
    shipped = {path.name.removesuffix(".json"): path for path in (files("lbacal_core") / "data/instruments").iterdir()}
    if name_or_file in shipped:
        return parse_instrument(json.loads(shipped[name_or_file].read_text(encoding="utf-8")), name_or_file)
    path = Path(name_or_file)
    if not _is_there(path):
        raise UnknownNameError("instrument", name_or_file, sorted(shipped))
    read = parse_instrument(read_json(path), str(path))
    return replace(read, antenna=_beside(path, read.antenna), sky=_beside(path, read.sky))


def _beside(path: Path, name_or_file: str | None) -> str | None:
    """A file that an instrument file names relative to itself; a name stays what it is."""
    if name_or_file is None or not _is_there(path.parent / name_or_file):
        return name_or_file
    return str(path.parent / name_or_file)


def _is_there(path: Path) -> bool:
    """Whether a file has that name; a name that no file can have is none."""
    try:
        return path.exists()
    except OSError:
        return False


def read_json(path: Path) -> Any:
    """Read a JSON file, with one clear sentence when it is not one."""
    try:
        text = path.read_text(encoding="utf-8")
        if not text.strip():
            raise UnreadableFileError(f"{path}: expected JSON, found an empty file")
        return json.loads(text, object_pairs_hook=require_unique_fields)
    except OSError as error:
        raise UnreadableFileError(f"{path}: cannot be read ({error.strerror})") from error
    except (ValueError, RecursionError) as error:
        raise UnreadableFileError(f"{path}: expected JSON, found something else ({error})") from error


def require_unique_fields(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object, refused when it gives a field twice: one of the two would be lost."""
    content = dict(pairs)
    if len(content) < len(pairs):
        twice = Counter(name for name, _ in pairs).most_common(1)[0][0]
        raise ValueError(f"the field {twice!r} twice in one object")
    return content


def parse_instrument(content: Any, place: str) -> Instrument:
    """Make an instrument from the content of its file; fields it does not know are left alone."""
    if not isinstance(content, dict):
        raise BadInputError(place, "a JSON object", type(content).__name__)
    fields = ["name", "latitude_deg", "longitude_deg", "height_m", "frequency_mhz", "dipoles"]
    fields += ["antenna_gain", "receiver_gain", "cables", "antennas"]
    missing = [field for field in fields if field not in content]
    if missing:
        raise BadInputError(place, f"the fields {', '.join(fields)}", f"no {', '.join(missing)}")
    dipoles, cables, antennas = content["dipoles"], content["cables"], content["antennas"]
    if not isinstance(dipoles, dict) or not isinstance(cables, dict) or not isinstance(antennas, list):
        raise BadInputError(place, "dipoles and cables as objects, antennas as a list", "another shape")
    return Instrument(
        name=_name(content["name"], f"{place}: name"),
        latitude_deg=_number(content["latitude_deg"], f"{place}: latitude_deg"),
        longitude_deg=_number(content["longitude_deg"], f"{place}: longitude_deg"),
        height_m=_number(content["height_m"], f"{place}: height_m"),
        frequency_mhz=parse_numbers(content["frequency_mhz"], f"{place}: frequency_mhz"),
        dipole_azimuth_deg={
            name: _number(dipole.get("azimuth_deg") if isinstance(dipole, dict) else None, f"{place}: dipoles.{name}")
            for name, dipole in dipoles.items()
        },
        antenna_gain=parse_numbers(content["antenna_gain"], f"{place}: antenna_gain"),
        receiver_gain=parse_numbers(content["receiver_gain"], f"{place}: receiver_gain"),
        cables={str(name): parse_numbers(loss, f"{place}: cables.{name}") for name, loss in cables.items()},
        antennas=tuple(_parse_record(record, f"{place}: antennas, row {k}") for k, record in enumerate(antennas)),
        antenna=_optional_name(content.get("antenna"), f"{place}: antenna"),
        sky=_optional_name(content.get("sky"), f"{place}: sky"),
        gain_provenance=_parse_gain_provenance(
            content.get("antenna_gain_provenance"), len(content["frequency_mhz"]), f"{place}: antenna_gain_provenance"
        ),
    )


def _parse_gain_provenance(content: Any, channels: int, place: str) -> GainProvenance | None:
    if content is None:
        return None
    if not isinstance(content, dict):
        raise BadInputError(place, "an object with kind and source", type(content).__name__)
    kind = content.get("kind")
    if kind not in (ABSOLUTE, RELATIVE):
        raise BadInputError(f"{place}: kind", f"{ABSOLUTE} or {RELATIVE}", repr(kind))
    shape, scale = content.get("shape_error"), content.get("scale_error")
    errors = np.empty(0) if shape is None else parse_numbers(shape if isinstance(shape, list) else [shape], place)
    scale_error = None if scale is None else _number(scale, f"{place}: scale_error")
    if np.any(errors < 0) or (scale_error is not None and scale_error < 0):
        raise BadInputError(place, "errors >= 0", "a negative one")
    return GainProvenance(
        kind=kind,
        source=_name(content.get("source"), f"{place}: source"),
        shape_error=None if shape is None else (errors if isinstance(shape, list) else np.full(channels, errors[0])),
        scale_error=scale_error,
        antenna_sha256=_optional_name(content.get("antenna_sha256"), f"{place}: antenna_sha256"),
    )


def parse_numbers(values: Any, place: str) -> Floats:
    """Make an array of finite floats from JSON, naming the first entry that is not a number."""
    if not isinstance(values, list):
        raise BadInputError(place, "a list of numbers", type(values).__name__)
    return np.array([_number(value, f"{place}, entry {k}") for k, value in enumerate(values)], dtype=float)


def _number(value: Any, place: str) -> float:
    try:
        if not isinstance(value, bool) and isinstance(value, int | float) and math.isfinite(value):
            return float(value)
    except OverflowError:  # an integer of more than 308 digits
        pass
    raise BadInputError(place, "a finite number", repr(value))


def _name(value: Any, place: str) -> str:
    if not isinstance(value, str) or not value or not value.isprintable():
        raise BadInputError(place, "a name", repr(value))
    return value


def _optional_name(value: Any, place: str) -> str | None:
    return None if value is None else _name(value, place)


def _parse_record(record: Any, place: str) -> AntennaRecord:
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
        station=_name(record["station"], f"{place}: station"),
        antenna=antenna,
        cable=_name(record["cable"], f"{place}: cable"),
        since=_instant(record.get("since"), f"{place}: since"),
        until=_instant(record.get("until"), f"{place}: until"),
        group=None if record.get("group") is None else _name(record["group"], f"{place}: group"),
    )


def _instant(text: Any, place: str) -> float | None:
    if text is None:
        return None
    try:
        instant = datetime.fromisoformat(text)
        return (instant if instant.tzinfo else instant.replace(tzinfo=UTC)).astimezone(UTC).timestamp()
    except (TypeError, ValueError, OverflowError) as error:
        raise BadInputError(place, "an ISO 8601 date", repr(text)) from error


def _record_as_dict(record: AntennaRecord) -> dict[str, Any]:
    content: dict[str, Any] = {"station": record.station, "antenna": record.antenna, "cable": record.cable}
    for field, instant in (("since", record.since), ("until", record.until)):
        if instant is not None:
            content[field] = datetime.fromtimestamp(instant, UTC).isoformat()
    if record.group is not None:
        content["group"] = record.group
    return content
