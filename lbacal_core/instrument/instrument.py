"""The instrument: where it stands, its dipoles, and the simulated and measured parts of its signal chain."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.errors import (
    BadInputError,
    UnknownNameError,
    offer_name,
    refuse_misspelt,
    require_kind,
    require_name,
    require_parts,
)
from lbacal_core.foreign import parse_name, parse_number, parse_numbers, parse_optional_name, read_json, write_instant
from lbacal_core.grids import HIGHEST_GALAXY_MHZ, Floats, find_channels, require_channels
from lbacal_core.instrument.antennas import (
    ABSOLUTE,
    EXPECTED,
    RANGES,
    AntennaRecord,
    GainProvenance,
    Site,
    is_dipole_name,
    look_like_radians,
    parse_gain_provenance,
    parse_record,
    parse_sites,
    record_as_dict,
    require_one_at_a_time,
)
from lbacal_core.instrument.stages import IN_LINE, Stage, fill_fields, gain_behind, parse_stages
from lbacal_core.provenance import hash_content

FEWEST_CHANNELS = 0.5
"""Share of an instrument's channels without which spectra are rather another instrument's."""
LARGEST_TURN_DEG = 1.0
"""Azimuths of an arm that differ by less are the same: records round."""
LARGEST_AZIMUTH_DEG = 360.0
"""Azimuths are counted from north either way round, once at most."""
STEEPEST_DEG = 90.0
"""Tilt of an arm that stands upright."""
ALTERNATIVE = ("antenna_gain", "receiver_gain", "stages")
"""Fields in which an alternative may differ."""


@dataclass(frozen=True)
class Instrument:
    """Everything about the signal chain that comes from simulations, data sheets and measurements.

    Attributes
    ----------
    frequency_mhz
        Shape (freq,), MHz.
    dipole_azimuth_deg
        Azimuth of each dipole's arm by its letter, degrees from north through east; one arm or more.
    antenna_gain, receiver_gain
        G_ant and G_RCU of eq. full_chain, shape (freq,), linear power.
    cables
        L_coax by cable name, shape (freq,), the factor <= 1 that multiplies the power.
    antenna, sky
        Antenna model and sky model, by name or file, that the package's own P_sky is computed with unless others are
        given; None where the instrument names none.
    antenna_doubt
        Probability that the antenna is another than is named; None where nobody says (`prior.toml`, other_antenna).
    gain_provenance
        What `antenna_gain` is; None where nobody says.
    dipole_tilt_deg
        How far the end of an arm that points to its azimuth is raised above the horizon, degrees, by letter; arms that
        are absent lie level. `antenna_gain` is that of a level arm: P_sky holds what a tilt changes.
    stages
        The chain in the order of the signal, `receiver_gain` being the product of the gains behind A(nu); empty for
        that of eq. full_chain (`chain.noise`).
    kelvin_error
        Error of a receiver that is calibrated in kelvin, a fraction of the power: spectra are then temperatures behind
        the antenna. None for spectra in ADC units.
    sites
        Where stations stand that do not stand where the instrument does, by name.
    alternatives
        What gains and stages may be instead, each one standard deviation off, by what it is that is not known better.
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
    antenna_doubt: float | None = None
    gain_provenance: GainProvenance | None = None
    dipole_tilt_deg: Mapping[str, float] = dataclasses.field(default_factory=dict)
    stages: Sequence[Stage] = ()
    kelvin_error: float | None = None
    sites: Mapping[str, Site] = dataclasses.field(default_factory=dict)
    alternatives: Mapping[str, Sequence[Instrument]] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        place = f"instrument {self.name}"
        require_channels(place, self.frequency_mhz, HIGHEST_GALAXY_MHZ)
        self._require_sites()
        self._require_dipoles()
        self._require_gain("antenna_gain", self.antenna_gain, np.inf)
        self._require_gain("receiver_gain", self.receiver_gain, np.inf)
        self._require_shape_error()
        self._require_stages()
        self._require_kelvin()
        if self.antenna_doubt is not None and not 0 <= self.antenna_doubt < 1:
            place = f"instrument {self.name}: antenna_doubt"
            raise BadInputError(place, "a probability, 0 to below 1", f"{self.antenna_doubt}")
        for cable, loss in self.cables.items():
            self._require_gain(f"cables.{cable}", loss, 1.0)
        for row, record in enumerate(self.antennas):
            require_name(f"{place}: antennas, row {row}: cable", record.cable, self.cables)
            if record.since is not None and record.until is not None and record.since >= record.until:
                raise BadInputError(f"{place}: antennas, row {row}: until", "a date after since", "one that is not")
        require_one_at_a_time(self.antennas, place)
        for name, others in self.alternatives.items():
            if not others or any(not np.array_equal(one.frequency_mhz, self.frequency_mhz) for one in others):
                raise BadInputError(f"{place}: alternatives.{name}", "one or more, on the same channels", "another")

    def _require_sites(self) -> None:
        place = f"instrument {self.name}"
        Site(self.latitude_deg, self.longitude_deg, self.height_m).require_on_earth(place)
        known = {record.station for record in self.antennas}
        for station, site in self.sites.items():
            if station not in known:
                raise BadInputError(f"{place}: sites", f"a station ({', '.join(sorted(known))})", repr(station))
            site.require_on_earth(f"{place}: sites.{station}")

    def _require_dipoles(self) -> None:
        place = f"instrument {self.name}: dipoles"
        if not self.dipole_azimuth_deg:
            raise BadInputError(place, "one dipole or more", "none")
        for dipole, azimuth in self.dipole_azimuth_deg.items():
            if not is_dipole_name(dipole):
                raise BadInputError(place, EXPECTED, repr(dipole))
            if not abs(azimuth) <= LARGEST_AZIMUTH_DEG:
                raise BadInputError(f"{place}.{dipole}.azimuth_deg", "-360 to 360", f"{azimuth:g}")
        if look_like_radians(self.dipole_azimuth_deg.values()):
            found = ", ".join(f"{dipole} {azimuth:.3g}" for dipole, azimuth in self.dipole_azimuth_deg.items())
            meant = "degrees (360 less for one of arms that are so near each other)"
            raise BadInputError(f"{place}: azimuth_deg", meant, f"{found}, which look like radians")
        for dipole, tilt in self.dipole_tilt_deg.items():
            if not abs(tilt) <= STEEPEST_DEG:
                raise BadInputError(f"{place}.{dipole}.tilt_deg", "-90 to 90", f"{tilt}")

    def require_arms_that_differ(self, place: str) -> None:
        """Refuse a record of parallel arms; arms that data put right may be."""
        known: dict[tuple[float, float], str] = {}
        for dipole, azimuth in self.dipole_azimuth_deg.items():
            # a level arm has two ends
            tilt = self.tilt_deg(dipole)
            other = known.setdefault((azimuth % (360.0 if tilt else 180.0), tilt), dipole)
            if other != dipole:
                found = f"{other} and {dipole}, which are parallel"
                raise BadInputError(f"{place}: dipoles", "arms that differ", found)

    @property
    def dipoles(self) -> tuple[str, ...]:
        """Letters of the dipoles, in alphabetical order: the order of every dipole axis."""
        return tuple(sorted(self.dipole_azimuth_deg))

    def tilt_deg(self, dipole: str) -> float:
        """Tilt of an arm, deg, 0 where none is given."""
        return self.dipole_tilt_deg.get(dipole, 0.0)

    def at_station(self, station: str | None) -> Instrument:
        """The instrument standing where a station of it stands; itself where the station has no site of its own."""
        site = None if station is None else self.sites.get(station)
        return self if site is None else replace(self, sites={}, **vars(site))

    def on_channels(self, frequency_mhz: Floats) -> Instrument:
        """The instrument with those of its channels that an input has, at least half; itself for any other input."""
        kept = find_channels(frequency_mhz, self.frequency_mhz)
        if kept is None or kept.all() or kept.mean() < FEWEST_CHANNELS:
            return self
        given = self.gain_provenance
        error = None if given is None else given.shape_error
        return replace(
            self,
            frequency_mhz=self.frequency_mhz[kept],
            antenna_gain=self.antenna_gain[kept],
            receiver_gain=self.receiver_gain[kept],
            cables={name: loss[kept] for name, loss in self.cables.items()},
            gain_provenance=given if given is None or error is None else replace(given, shape_error=error[kept]),
            stages=[stage.on_channels(kept) for stage in self.stages],
            alternatives={
                name: [one.on_channels(frequency_mhz) for one in others] for name, others in self.alternatives.items()
            },
        )

    def require_dipoles(
        self, letters: NDArray[np.str_], origin: str, arms_deg: Mapping[str, float] = MappingProxyType({})
    ) -> None:
        """Refuse letters of spectra that are none of this instrument's, and arms that point elsewhere."""
        unknown = [str(letter) for letter in np.unique(letters) if str(letter) not in self.dipole_azimuth_deg]
        if unknown:
            row = int(np.flatnonzero(letters == unknown[0])[0])
            expected = f"a dipole of instrument {self.name} ({', '.join(self.dipoles)})"
            raise BadInputError(f"{origin}: dipole, row {row}", expected, offer_name(unknown[0], self.dipoles))
        for letter, azimuth in arms_deg.items():
            here = self.dipole_azimuth_deg.get(letter, azimuth)
            # an arm has two ends
            if abs((azimuth - here + 90.0) % 180.0 - 90.0) > LARGEST_TURN_DEG:
                expected = f"{here:g} deg, the azimuth of the arm {letter} of instrument {self.name}"
                raise BadInputError(f"{origin}: arm of {letter}", expected, f"{azimuth:g} deg")

    def _require_stages(self) -> None:
        if not self.stages:
            return
        place = f"instrument {self.name}: stages"
        if not np.allclose(self.receiver_gain, gain_behind(self.stages, self.frequency_mhz.size), rtol=1e-9, atol=0.0):
            raise BadInputError(place, "receiver_gain as the product of the gains behind the cable", "another")
        gains = {stage.name: stage.gain for stage in self.stages if stage.kind == "cable" and stage.gain is not None}
        for (stage, gain), (name, loss) in product(gains.items(), self.cables.items()):
            if not np.allclose(loss, gain, rtol=1e-9, atol=0.0):
                expected = f"the cable {name!r} as the gain of the stage {stage!r}, or that stage without one"
                raise BadInputError(place, expected, "another")
        known = [stage.name for stage in self.stages if stage.noise_k is not None and stage.kind in IN_LINE]
        if known:
            self._require_square_metres(f"{place}: noise_temperature_k", f"a temperature of {known[0]}")

    def _require_kelvin(self) -> None:
        if self.kelvin_error is not None:
            place = f"instrument {self.name}: calibrated_in_kelvin"
            self._require_square_metres(place, "kelvin")
            if not 0 < self.kelvin_error < 1:
                raise BadInputError(f"{place}.error", "a fraction of the power, 0 to 1", f"{self.kelvin_error}")

    def _require_square_metres(self, place: str, found: str) -> None:
        if self.gain_provenance is None or self.gain_provenance.kind != ABSOLUTE:
            raise BadInputError(
                place,
                f"an antenna_gain in m^2 (antenna_gain_provenance: kind {ABSOLUTE}), to refer kelvin to the sky",
                f"{found} beside one that is not said to be",
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
            stations = sorted({r.station for r in self.antennas})
            own = sorted({r.antenna for r in self.antennas if r.station == station})
            there = f"antennas {own[0]} to {own[-1]} of it" if own else f"stations {', '.join(stations)}"
            found = place if own else f"station {offer_name(station, stations)}, antenna {antenna}"
            raise BadInputError(place, f"an antenna of instrument {self.name} ({there})", found)
        for instant in (first_unix, last_unix):
            if not any(record.covers(instant) for record in records):
                raise BadInputError(
                    place,
                    f"a cable on record in instrument {self.name} at {write_instant(instant)[:10]}",
                    "records of other dates only",
                )
        return list(dict.fromkeys(record.cable for record in records if record.covers(first_unix, last_unix)))

    def group_between(self, station: str, antenna: int, first_unix: float, last_unix: float) -> str | None:
        """Name of the group of an antenna from one instant to another; None where it has none, or changes it."""
        held = {
            record.group
            for record in self.antennas
            if (record.station, record.antenna) == (station, antenna) and record.covers(first_unix, last_unix)
        }
        return held.pop() if len(held) == 1 else None

    def as_dict(self) -> dict[str, Any]:
        """The content of an instrument file (docs/formats/instrument.md)."""
        return {
            "name": self.name,
            "latitude_deg": self.latitude_deg,
            "longitude_deg": self.longitude_deg,
            "height_m": self.height_m,
            "frequency_mhz": self.frequency_mhz.tolist(),
            "dipoles": {
                dipole: {"azimuth_deg": value, **({"tilt_deg": tilt} if (tilt := self.tilt_deg(dipole)) else {})}
                for dipole, value in self.dipole_azimuth_deg.items()
            },
            "antenna_gain": self.antenna_gain.tolist(),
            "receiver_gain": self.receiver_gain.tolist(),
            "cables": {name: loss.tolist() for name, loss in self.cables.items()},
            "antennas": [record_as_dict(record) for record in self.antennas],
            **({} if self.antenna is None else {"antenna": self.antenna}),
            **({} if self.sky is None else {"sky": self.sky}),
            **({} if self.antenna_doubt is None else {"antenna_doubt": self.antenna_doubt}),
            **({} if self.gain_provenance is None else {"antenna_gain_provenance": self.gain_provenance.as_dict()}),
            **({"stages": [stage.as_dict() for stage in self.stages]} if self.stages else {}),
            **({} if self.kelvin_error is None else {"calibrated_in_kelvin": {"error": self.kelvin_error}}),
            **({"sites": {name: dict(vars(site)) for name, site in sorted(self.sites.items())}} if self.sites else {}),
            **({"alternatives": self._list_alternatives()} if self.alternatives else {}),
        }

    def _list_alternatives(self) -> dict[str, Any]:
        return {
            name: [{field: value for field, value in one.as_dict().items() if field in ALTERNATIVE} for one in others]
            for name, others in self.alternatives.items()
        }

    def digest(self) -> str:
        """Hash of the numbers, which names the instrument in provenance and version ids.

        The names of sky and antenna are not in it, because P_sky brings hashes of its own, nor is what is said about
        the antenna gain.
        """
        words = ("antenna", "sky", "antenna_gain_provenance")
        return hash_content({name: value for name, value in self.as_dict().items() if name not in words})

    def digest_of(
        self, since_unix: float, until_unix: float, station: str | None = None, antenna: int | None = None
    ) -> str:
        """Hash of what a fit of some antennas uses in an interval: of one antenna, of a station's, or of all.

        Records of other antennas and of other times are not in it, nor cables that nobody had.
        """
        used = [
            record
            for record in self.antennas
            if station in (None, record.station)
            and antenna in (None, record.antenna)
            and (record.since is None or record.since < until_unix)
            and (record.until is None or record.until > since_unix)
        ]
        inside = [
            replace(
                record,
                since=None if record.since is None or record.since <= since_unix else record.since,
                until=None if record.until is None or record.until >= until_unix else record.until,
            )
            for record in used
        ]
        known = {record.cable: self.cables[record.cable] for record in used}
        stations = {record.station for record in used}
        sites = {name: replace(site, height_m=0.0) for name, site in self.sites.items() if name in stations}
        own = replace(self, name="", height_m=0.0, cables=known, antennas=inside, sites=sites)
        return own.digest()

    def view_digest(self) -> str:
        """Hash of what P_sky takes from an instrument: its places, the arms of its dipoles and its channels."""
        tilts = {dipole: tilt for dipole, tilt in self.dipole_tilt_deg.items() if tilt}
        view = [self.latitude_deg, dict(self.dipole_azimuth_deg), self.frequency_mhz.tolist()]
        elsewhere = {name: site.latitude_deg for name, site in self.sites.items()}
        return hash_content([*view, *(more for more in (tilts, elsewhere) if more)])

    @property
    def antenna_gain_note(self) -> str:
        """The origin of the antenna gain, in words."""
        if self.gain_provenance is not None:
            return str(self.gain_provenance)
        if np.all(self.antenna_gain == 1.0):
            return "relative: antenna_gain is 1 in every channel, so that C is not that of the antenna but of 1 m^2"
        return "unchecked: the instrument does not say what its antenna_gain is"


def find_instrument(name_or_file: str) -> Path:
    """Find the file of an instrument: of one that ships with the package by its name, or any other."""
    folder = Path(str(files("lbacal_core") / "data/instruments"))
    shipped = {path.stem: path for path in folder.iterdir()}
    path = shipped.get(name_or_file, Path(name_or_file))
    if not name_or_file or not _is_there(path):
        raise UnknownNameError("instrument", name_or_file, sorted(shipped))
    return path


def load_instrument(name_or_file: str) -> Instrument:
    """Load an instrument that ships with the package by its name, or any other from its JSON file."""
    path = find_instrument(name_or_file)
    read = parse_instrument(read_json(path), name_or_file, path.parent)
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


NEEDED = (
    "name", "latitude_deg", "longitude_deg", "height_m", "frequency_mhz", "dipoles", "antenna_gain", "receiver_gain",
    "cables", "antennas",
)  # fmt: skip
FIELDS = (
    *NEEDED, "antenna", "sky", "antenna_doubt", "antenna_gain_provenance", "stages", "calibrated_in_kelvin", "sites",
    "alternatives",
)  # fmt: skip


def parse_instrument(content: Any, place: str, folder: Path | None = None) -> Instrument:
    """Make an instrument from the content of its file; fields unlike its own are left alone.

    Parameters
    ----------
    folder
        Where files are that its stages name; None where there are none to be read.
    """
    if not isinstance(content, dict):
        raise BadInputError(place, "a JSON object", type(content).__name__)
    refuse_misspelt(place, content, FIELDS)
    alternatives = _parse_alternatives(content, place, folder)
    stages: tuple[Stage, ...] = ()
    if "stages" in content:
        frequency_mhz = parse_numbers(content.get("frequency_mhz"), f"{place}: frequency_mhz")
        require_channels(place, frequency_mhz, HIGHEST_GALAXY_MHZ)  # before tables of stages are read at them
        stages = parse_stages(content["stages"], frequency_mhz, f"{place}: stages", folder)
        content = fill_fields(content, stages, frequency_mhz.size)
    if stages and "antenna_gain" not in content:
        raise BadInputError(f"{place}: antenna_gain", "the field, or a stage of kind antenna with a gain", "neither")
    require_parts(place, "fields", NEEDED, content)
    dipoles, cables, antennas = content["dipoles"], content["cables"], content["antennas"]
    require_kind(f"{place}: dipoles", dipoles, dict, "an object of azimuth_deg by letter")
    require_kind(f"{place}: cables", cables, dict, "an object of losses by name")
    require_kind(f"{place}: antennas", antennas, list, "a list")
    if not antennas:
        raise BadInputError(f"{place}: antennas", "one or more", "none")
    for name, arm in dipoles.items():
        refuse_misspelt(f"{place}: dipoles.{name}", arm if isinstance(arm, dict) else (), ("azimuth_deg", "tilt_deg"))
    arrays = ("frequency_mhz", "antenna_gain", "receiver_gain")
    given: dict[str, Any] = {name: parse_number(content[name], f"{place}: {name}") for name in RANGES}
    given |= {name: parse_numbers(content[name], f"{place}: {name}") for name in arrays}
    given |= {name: parse_optional_name(content.get(name), f"{place}: {name}") for name in ("antenna", "sky")}
    made = Instrument(
        **given,
        name=parse_name(content["name"], f"{place}: name"),
        dipole_azimuth_deg={
            name: parse_number(
                arm.get("azimuth_deg") if isinstance(arm, dict) else None, f"{place}: dipoles.{name}.azimuth_deg"
            )
            for name, arm in dipoles.items()
        },
        dipole_tilt_deg={
            name: parse_number(arm["tilt_deg"], f"{place}: dipoles.{name}.tilt_deg")
            for name, arm in dipoles.items()
            if isinstance(arm, dict) and arm.get("tilt_deg")
        },
        cables={str(name): parse_numbers(loss, f"{place}: cables.{name}") for name, loss in cables.items()},
        antennas=tuple(parse_record(record, f"{place}: antennas, row {k}") for k, record in enumerate(antennas)),
        antenna_doubt=None
        if (doubt := content.get("antenna_doubt")) is None
        else parse_number(doubt, f"{place}: antenna_doubt"),
        gain_provenance=parse_gain_provenance(
            content.get("antenna_gain_provenance"), len(content["frequency_mhz"]), f"{place}: antenna_gain_provenance"
        ),
        stages=stages,
        kelvin_error=_parse_kelvin_error(content.get("calibrated_in_kelvin"), f"{place}: calibrated_in_kelvin"),
        sites=parse_sites(content.get("sites"), f"{place}: sites", given["height_m"]),
        alternatives=alternatives,
    )
    made.require_arms_that_differ(place)
    return made


def _parse_alternatives(
    content: Mapping[str, Any], place: str, folder: Path | None
) -> dict[str, tuple[Instrument, ...]]:
    """Each is the content of the file with other gains and stages."""
    given = content.get("alternatives", {})
    is_list = isinstance(given, dict) and all(isinstance(one, list) for one in given.values())
    rows = [row for one in given.values() for row in one] if is_list else [None]
    if not all(isinstance(row, dict) and row and set(row) <= set(ALTERNATIVE) for row in rows):
        expected = f"lists of objects with some of {', '.join(ALTERNATIVE)}, by name"
        raise BadInputError(f"{place}: alternatives", expected, "another shape")
    own = {name: value for name, value in content.items() if name != "alternatives"}
    return {
        str(name): tuple(
            parse_instrument({**own, **row}, f"{place}: alternatives.{name}, row {k}", folder)
            for k, row in enumerate(one)
        )
        for name, one in given.items()
    }


def _parse_kelvin_error(content: Any, place: str) -> float | None:
    if content is None:
        return None
    if not isinstance(content, dict):
        raise BadInputError(place, "an object with error", type(content).__name__)
    return parse_number(content.get("error"), f"{place}.error")
