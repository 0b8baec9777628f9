"""Directional sky power P_sky(LST, nu) of each dipole, and its file (docs/formats/sky-power.md)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.data.constants import BOLTZMANN, SPEED_OF_LIGHT
from lbacal_core.errors import BadInputError, refuse_misspelt
from lbacal_core.foreign import parse_numbers, read_json
from lbacal_core.grids import Floats, require_channels
from lbacal_core.instrument.antennas import is_dipole_name
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.linear import pseudo_invert
from lbacal_core.provenance import hash_arrays, hash_content

# P_sky on any LST grid as a Fourier series, by least squares.
#
# P(t) = sum over |m| <= M of c_m exp(2 pi i m t / 24 h) is linear in its 2 M + 1 coefficients. A grid determines them
# if the error of the series nowhere exceeds a few times that of a value: its variance at t, in units of that of a
# value, is b(t)^T (B^T B)^-1 b(t), with b the harmonics and B their values on the grid. On an even grid of T instants
# it is (2 M + 1) / T everywhere; where instants are missing it grows without bound.

HARMONICS = 8
"""The LBA sees no more to 0.005 %."""
EVEN_INSTANTS = 96
LARGEST_VARIANCE = 4.0
"""Largest error of the series between instants, in units of the error of a value: it may double."""
SMALLEST_PIVOT = 1e-9
"""Below this share of the largest a direction is not determined at all."""
DAY_HOURS = 24.0


@dataclass(frozen=True)
class HarmonicFit:
    """How a series of harmonics fits a table.

    Attributes
    ----------
    instants, harmonics
        Rows of the table, and M.
    rms, largest
        Relative residual over both dipoles, all instants and channels.
    """

    instants: int
    harmonics: int
    rms: float
    largest: float

    def __str__(self) -> str:
        return (
            f"{self.harmonics} harmonics fitted to {self.instants} uneven instants, "
            f"residual {self.rms:.2%} r.m.s. and {self.largest:.2%} at most"
        )


def make_even(
    place: str, lst_hours: Floats, power: Mapping[str, Floats]
) -> tuple[Floats, dict[str, Floats], HarmonicFit]:
    """Fit a table on uneven instants and evaluate it on even ones.

    Parameters
    ----------
    place
        What the table was read from, for messages.
    lst_hours
        Shape (lst,), hours, rising over at most a sidereal day.
    power
        Shape (lst, freq) for each polarisation.

    Returns
    -------
    Even instants, the power at them, and how well the series fits.
    """
    most, fewest = most_harmonics(lst_hours.size), fewest_harmonics(lst_hours.size)
    size = max(EVEN_INSTANTS, 4 * most)
    even = DAY_HOURS * np.arange(size) / size
    for harmonics in range(most, fewest - 1, -1):
        orthogonal, triangular = np.linalg.qr(harmonics_at(lst_hours, harmonics))
        if np.min(np.abs(np.diag(triangular))) < SMALLEST_PIVOT * np.max(np.abs(np.diag(triangular))):
            continue
        series = harmonics_at(even, harmonics) @ pseudo_invert(triangular)
        if np.max(np.sum(series**2, axis=1)) <= LARGEST_VARIANCE:
            break
    else:
        raise _undetermined(place, lst_hours, fewest)
    fitted, residuals = {}, []
    for dipole, values in power.items():
        projected = orthogonal.T @ values
        residuals.append((orthogonal @ projected / values - 1.0).ravel())
        fitted[dipole] = series @ projected
    residual = np.concatenate(residuals)
    rms, largest = float(np.sqrt(np.mean(residual**2))), float(np.max(np.abs(residual)))
    return even, fitted, HarmonicFit(lst_hours.size, harmonics, rms, largest)


def fewest_harmonics(instants: int) -> int:
    """The number of harmonics that the LBA needs, or the most that so few instants can give."""
    return min(HARMONICS, (instants - 1) // 2)


def most_harmonics(instants: int) -> int:
    """One harmonic for four instants, so that half of the values test the series, or what the LBA needs."""
    return max(fewest_harmonics(instants), instants // 4)


def harmonics_at(lst_hours: Floats, most: int) -> Floats:
    """1, then cosines, then sines, of the sidereal day, shape (instant, 1 + 2 most)."""
    angle = 2.0 * np.pi / DAY_HOURS * np.outer(lst_hours, np.arange(1, most + 1))
    return np.concatenate([np.ones((angle.shape[0], 1)), np.cos(angle), np.sin(angle)], axis=1)


def _undetermined(place: str, lst_hours: Floats, harmonics: int) -> BadInputError:
    """The error that names the widest hole of a grid."""
    steps = np.diff(np.append(lst_hours, lst_hours[0] + DAY_HOURS))
    row = int(np.argmax(steps))
    after = "the last row" if row == lst_hours.size - 1 else f"row {row}"
    return BadInputError(
        f"{place}: lst_hours",
        f"instants that determine {harmonics} harmonics of the sidereal day, one in every "
        f"{DAY_HOURS / (2 * harmonics + 1):.1f} h or so",
        f"{steps[row]:.3g} h without one after {after}",
    )


# What a sky power was computed for: instrument, sky, antenna and arms, with their hashes (docs/formats/sky-power.md).

ARM_TOLERANCE_DEG = 1e-6
SHORTEST_SMEARED_H = 10.0 / 3600
"""A shorter integration takes 2e-6 of the eighth harmonic, and less of the others: the sky stands still."""
SHOWN = 12
"""Digits of a hash that a sentence shows."""


@dataclass(frozen=True)
class MadeFor:
    """The instrument, sky model and antenna model behind a sky power; what is None or absent is not known.

    Attributes
    ----------
    dipole_azimuth_deg
        Azimuths of the arms.
    hashes
        `instrument`: hash of what P_sky takes from it; `sky`, `antenna`: of the numbers of the models.
    versions
        `lbacal`: that of the package; `model_version`.
    """

    instrument: str | None = None
    sky: str | None = None
    antenna: str | None = None
    dipole_azimuth_deg: Mapping[str, float] = field(default_factory=dict)
    hashes: Mapping[str, str] = field(default_factory=dict)
    versions: Mapping[str, Any] = field(default_factory=dict)

    def require(self, instrument: Instrument, place: str) -> None:
        """Refuse an instrument with another name, place, arms, channels or antenna, and models that changed since."""
        if self.instrument is not None and self.instrument != instrument.name:
            raise BadInputError(f"{place}: instrument", f"that of the fit, {instrument.name!r}", repr(self.instrument))
        for dipole, azimuth in self.dipole_azimuth_deg.items():
            arm = instrument.dipole_azimuth_deg.get(dipole)
            if arm is None or not np.isclose(azimuth, arm, rtol=0.0, atol=ARM_TOLERANCE_DEG):
                expected = "no such dipole" if arm is None else f"{arm:g}, that of instrument {instrument.name}"
                raise BadInputError(f"{place}: dipoles.{dipole}.azimuth_deg", expected, f"{azimuth:g}")
        view = self.hashes.get("instrument", instrument.view_digest())
        if view != instrument.view_digest():
            raise BadInputError(
                f"{place}: hashes.instrument",
                f"that of the place, arms and channels of instrument {instrument.name}, "
                f"{instrument.view_digest()[:SHOWN]}: compute the sky power again (lbacal sky-power)",
                view[:SHOWN],
            )
        for kind, digest in (("sky", shipped_sky_digest(self.sky)), ("antenna", shipped_antenna_digest(self.antenna))):
            if digest is not None and self.hashes.get(kind, digest) != digest:
                ours = f"this package's {kind} {getattr(self, kind)}, {digest[:SHOWN]}: compute the sky power again"
                raise BadInputError(f"{place}: hashes.{kind}", ours, self.hashes[kind][:SHOWN])
        gain = instrument.gain_provenance
        own = None if gain is None else gain.antenna_sha256
        if own is not None and self.hashes.get("antenna", own) != own:
            raise BadInputError(
                f"{place}: antenna",
                f"the antenna of which instrument {instrument.name} has its antenna_gain, {own[:SHOWN]}",
                f"{self.antenna} ({self.hashes['antenna'][:SHOWN]})",
            )

    def with_sky(self, added: str) -> MadeFor:
        """The same with something added to the sky, which then has no hash of its own."""
        hashes = {name: value for name, value in self.hashes.items() if name != "sky"}
        return replace(self, sky=f"{self.sky}{added}", hashes=hashes)

    def note(self, instrument: Instrument) -> str:
        """The origin of a sky power, in words."""
        words = [f"{name} {value}" for name, value in (("sky", self.sky), ("antenna", self.antenna)) if value]
        if not words:
            return "unchecked: it does not say which sky and antenna it was made with"
        if None not in (self.antenna, instrument.antenna) and self.antenna != instrument.antenna:
            words.append(f"instrument {instrument.name} names the antenna {instrument.antenna}")
        return ", ".join(words)

    def as_dict(self) -> dict[str, Any]:
        """The fields of a sky power file (docs/formats/sky-power.md) that are known."""
        named = {"instrument": self.instrument, "sky": self.sky, "antenna": self.antenna}
        dipoles = {dipole: {"azimuth_deg": azimuth} for dipole, azimuth in self.dipole_azimuth_deg.items()}
        more = {"dipoles": dipoles, "hashes": dict(self.hashes), "versions": dict(self.versions)}
        return {name: value for name, value in (named | more).items() if value}


def shipped_sky_digest(name: str | None) -> str | None:
    """Digest of a sky model that ships with the package; None for any other."""
    # the models need scipy, the tables that this describes do not
    from lbacal_core.sky.names import MEASURED_SKY, list_skies, load_sky

    return load_sky(name).digest() if name in [*list_skies(), MEASURED_SKY] else None


def shipped_antenna_digest(name: str | None) -> str | None:
    """Digest of an antenna model that ships with the package; None for any other."""
    from lbacal_core.antenna.names import ANTENNAS, load_antenna

    return load_antenna(name).digest() if name in ANTENNAS else None


MADE_FOR: dict[str, type] = {
    "instrument": str, "sky": str, "antenna": str, "dipoles": dict, "hashes": dict, "versions": dict,
}  # fmt: skip
"""Fields that say what a sky power was made for, and their kinds."""


def parse_made_for(content: Mapping[str, Any], place: str) -> MadeFor | None:
    """Read what a sky power file says that it was made for; None where it says nothing."""
    given = {name: content[name] for name in MADE_FOR if content.get(name) is not None}
    for name, value in given.items():
        if not isinstance(value, kind := MADE_FOR[name]):
            raise BadInputError(f"{place}: {name}", "a name" if kind is str else "an object", repr(value)[:60])
    if not given:
        return None
    arms = {}
    for dipole, value in given.get("dipoles", {}).items():
        azimuth = value.get("azimuth_deg") if isinstance(value, dict) else None
        if isinstance(azimuth, bool) or not isinstance(azimuth, int | float):
            raise BadInputError(f"{place}: dipoles.{dipole}", "an object with azimuth_deg", repr(value)[:60])
        arms[str(dipole)] = float(azimuth)
    for name, value in given.get("hashes", {}).items():
        if not isinstance(value, str):
            raise BadInputError(f"{place}: hashes.{name}", "a hash", repr(value)[:60])
    given.pop("dipoles", None)
    return MadeFor(**given, dipole_azimuth_deg=arms)


GALAXY_K, GALAXY_MHZ, GALAXY_INDEX = 180.0, 180.0, 2.55
"""The Galaxy away from its plane (Mozdzen et al. 2019, rounded)."""
FAR_FROM_GALAXY = 100.0
"""Factor from it of P_sky in another unit: no antenna or model of the sky makes so much."""
FEWEST_INSTANTS = 3
LST_TOLERANCE_HOURS = 1e-6
"""4 ms: what rounding in a file may leave of a regular grid."""


@dataclass(frozen=True)
class SkyPower:
    """P_sky on a regular LST grid, periodic in LST.

    Attributes
    ----------
    frequency_mhz
        Shape (freq,), MHz.
    lst_hours
        Shape (lst,), hours, regular over the sidereal day.
    power
        Shape (lst, freq) for each polarisation, for D = 1 at zenith: W m^-2 MHz^-1 so that P_sky G_ant is
        W/MHz with G_ant in m^2; any other common unit makes C relative.
    origin
        Sky model and antenna model, or the file it was read from.
    inputs_digest
        Hash of what it was computed from, set by `of_inputs` alone: a table made from another by `replace` has none.
    fit
        How the series fits a file whose instants are uneven; None where the table is as it was given.
    made_for
        The instrument that it was computed for, with which sky and antenna; None where nobody says.
    stations
        P_sky of stations at another latitude than the instrument's, by name, on the same channels. A station that only
        stands at another longitude sees the same at another time.
    """

    frequency_mhz: Floats
    lst_hours: Floats
    power: Mapping[str, Floats]
    origin: str = "sky power"
    inputs_digest: str | None = field(default=None, init=False)
    fit: HarmonicFit | None = None
    made_for: MadeFor | None = None
    stations: Mapping[str, SkyPower] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require_channels(self.origin, self.frequency_mhz)
        lst = self.lst_hours
        if lst.ndim != 1 or lst.size < FEWEST_INSTANTS:
            raise BadInputError(f"{self.origin}: lst_hours", "a list of at least 3 instants", f"shape {lst.shape}")
        bad = np.flatnonzero(~_is_even(lst))
        if bad.size:
            raise BadInputError(
                f"{self.origin}: lst_hours, row {bad[0] + 1}",
                f"24 h / {lst.size} = {24.0 / lst.size:g} h after the row before",
                f"{lst[bad[0] + 1] - lst[bad[0]]:g} h after it",
            )
        if not self.power:
            raise BadInputError(self.origin, "P_sky of one dipole or more, under its letter", "none")
        for dipole, values in self.power.items():
            shape = (lst.size, self.frequency_mhz.size)
            if values.shape != shape:
                raise BadInputError(f"{self.origin}: {dipole}", f"shape {shape} (lst, freq)", f"{values.shape}")
            if not (np.all(np.isfinite(values)) and np.all(values > 0)):
                row, channel = np.argwhere(~(np.isfinite(values) & (values > 0)))[0]
                raise BadInputError(
                    f"{self.origin}: {dipole}, row {row}, channel {channel}",
                    "finite power > 0",
                    f"{values[row, channel]}",
                )

        for station, one in self.stations.items():
            if set(one.power) != set(self.power) or not np.array_equal(one.frequency_mhz, self.frequency_mhz):
                raise BadInputError(f"{self.origin}: stations.{station}", "the same dipoles and channels", "others")

    def of_station(self, station: str | None) -> SkyPower:
        """P_sky where a station stands; where the instrument stands unless it has one of its own."""
        return self if station is None else self.stations.get(station, self)

    def at(self, dipole: str, lst_hours: Floats) -> Floats:
        """P_sky of one dipole at any LST, by its Fourier series: exact for what the grid resolves.

        Parameters
        ----------
        lst_hours
            Shape (event,), hours.

        Returns
        -------
        Shape (event, freq), unit of `power`.
        """
        return read_at(self.power[dipole], np.asarray(lst_hours) - self.lst_hours[0])

    def on_channels(self, kept: NDArray[np.bool_]) -> SkyPower:
        """The same with some of its channels, by a mask of shape (freq,)."""
        made = self.made_for
        hashes = {} if made is None else {name: one for name, one in made.hashes.items() if name != "instrument"}
        return replace(
            self,
            frequency_mhz=self.frequency_mhz[kept],
            power={dipole: values[:, kept] for dipole, values in self.power.items()},
            made_for=None if made is None else replace(made, hashes=hashes),
            stations={name: one.on_channels(kept) for name, one in self.stations.items()},
        ).of_inputs(hash_content([self.digest(), kept.tolist()]))

    def smeared(self, hours: float) -> SkyPower:
        """The mean over so many sidereal hours about each instant; the same object where that is a moment.

        The mean of harmonic k over a window of h hours is sinc(k h / 24) times that at its middle, with
        sinc(x) = sin(pi x) / (pi x).
        """
        if hours < SHORTEST_SMEARED_H:
            return self
        share = np.sinc(np.arange(self.lst_hours.size // 2 + 1) * hours / DAY_HOURS)[:, None]
        power = {
            dipole: np.fft.irfft(np.fft.rfft(values, axis=0) * share, n=self.lst_hours.size, axis=0)
            for dipole, values in self.power.items()
        }
        stations = {name: one.smeared(hours) for name, one in self.stations.items()}
        return replace(self, power=power, stations=stations).of_inputs(hash_content([self.digest(), hours]))

    def as_dict(self) -> dict[str, Any]:
        """The content of a sky power file (docs/formats/sky-power.md)."""
        return {
            "frequency_mhz": self.frequency_mhz.tolist(),
            "lst_hours": self.lst_hours.tolist(),
            **{dipole: values.tolist() for dipole, values in sorted(self.power.items())},
            **({} if self.made_for is None else self.made_for.as_dict()),
            **({"stations": {name: one.as_dict() for name, one in self.stations.items()}} if self.stations else {}),
        }

    def require_made_for(self, instrument: Instrument) -> None:
        """Refuse an instrument that this sky power says it was not made for, or of which it lacks a dipole."""
        missing = [dipole for dipole in instrument.dipoles if dipole not in self.power]
        if missing:
            expected = f"P_sky of each dipole of instrument {instrument.name} ({', '.join(instrument.dipoles)})"
            raise BadInputError(self.origin, expected, f"no {', '.join(missing)}")
        if self.made_for is not None:
            self.made_for.require(instrument, self.origin)
        for station, one in self.stations.items():
            one.require_made_for(instrument.at_station(station))

    def note_for(self, instrument: Instrument) -> str:
        """The agreement of this sky power with an instrument, in words."""
        made = (
            "unchecked: it does not say what it was made for"
            if self.made_for is None
            else self.made_for.note(instrument)
        )
        north = instrument.latitude_deg
        elsewhere = [name for name, site in instrument.sites.items() if site.latitude_deg != north]
        without = ", ".join(name for name in elsewhere if name not in self.stations)
        made += f"; P_sky of the instrument's place stands for that of {without}" if without else ""
        level = self._over_galaxy()
        if not 1 / FAR_FROM_GALAXY < level < FAR_FROM_GALAXY:
            made += f"; it is {level:.1g} times the Galaxy in W m^-2 MHz^-1: C is relative, not in volts"
        return made if self.fit is None else f"{self.fit}; {made}"

    def _over_galaxy(self) -> float:
        """Median over the channels of the mean P_sky over that of the Galaxy's mean brightness from all directions."""
        per_metre = self.frequency_mhz * 1e6 / SPEED_OF_LIGHT
        brightness = GALAXY_K * (self.frequency_mhz / GALAXY_MHZ) ** -GALAXY_INDEX
        galaxy = BOLTZMANN * brightness * 4.0 * np.pi * per_metre**2 * 1e6
        return float(np.median([one.mean(axis=0) / galaxy for one in self.power.values()]))

    def of_inputs(self, digest: str) -> SkyPower:
        """The same table, named by the hash of its inputs.

        Computed numbers differ in their last bits between machines and thread counts; inputs do not, and version
        ids must not either.
        """
        named = replace(self)
        object.__setattr__(named, "inputs_digest", digest)
        return named

    def digest(self) -> str:
        """Hash that names this sky power in provenance and version ids: of its inputs, else of its numbers."""
        own = self.inputs_digest or hash_arrays(
            self.frequency_mhz, self.lst_hours, *(self.power[dipole] for dipole in sorted(self.power))
        )
        return hash_content([own, {k: one.digest() for k, one in self.stations.items()}]) if self.stations else own


def read_at(values: Floats, lst_hours: Floats) -> Floats:
    """Read values on a regular grid of the sidereal day between its instants, by their Fourier series.

    Parameters
    ----------
    values
        Shape (..., lst, freq).
    lst_hours
        Hours since the first instant of the grid, shape (event,).

    Returns
    -------
    Shape (..., event, freq).
    """
    size = values.shape[-2]
    terms = np.fft.rfft(values, axis=-2) / size
    order = np.arange(terms.shape[-2])
    weight = np.where((order == 0) | (2 * order == size), 1.0, 2.0)
    basis = np.exp(2j * np.pi / 24.0 * np.outer(lst_hours, order)) * weight
    real = np.concatenate([terms.real, terms.imag], axis=-2)
    return np.asarray(np.concatenate([basis.real, -basis.imag], axis=1) @ real)


def read_sky_power(path: Path) -> SkyPower:
    """Read a sky power file."""
    return _parse_sky_power(read_json(path), str(path))


def _parse_sky_power(content: Any, path: str) -> SkyPower:
    """The sky power of a file's content, or of one of its stations."""
    fields = ["frequency_mhz", "lst_hours"]
    wanted = f"the fields {', '.join(fields)} and P_sky of each dipole under its letter"
    if not isinstance(content, dict):
        raise BadInputError(path, f"a JSON object with {wanted}", type(content).__name__)
    # what the file says it has, single letters, and lists
    said = content["dipoles"] if isinstance(content.get("dipoles"), dict) else {}
    named = [name for name, value in content.items() if isinstance(value, list) or name in said or len(name) == 1]
    dipoles = sorted(filter(is_dipole_name, named))
    refuse_misspelt(path, {*content} - {*dipoles}, (*fields, *MADE_FOR, "stations"))
    missing = [name for name in fields if name not in content] + ([] if dipoles else ["dipole"])
    if missing:
        raise BadInputError(path, wanted, f"no {', '.join(missing)}")
    frequency_mhz = parse_numbers(content["frequency_mhz"], f"{path}: frequency_mhz")
    power = {}
    for dipole in dipoles:
        rows = content[dipole]
        if not isinstance(rows, list):
            raise BadInputError(f"{path}: {dipole}", "a list of rows, one an LST", type(rows).__name__)
        parsed = [parse_numbers(row, f"{path}: {dipole}, row {k}") for k, row in enumerate(rows)]
        short = [k for k, row in enumerate(parsed) if row.size != frequency_mhz.size]
        if short:
            raise BadInputError(
                f"{path}: {dipole}, row {short[0]}", f"{frequency_mhz.size} channels", f"{parsed[short[0]].size}"
            )
        power[dipole] = np.array(parsed)
    lst_hours = parse_numbers(content["lst_hours"], f"{path}: lst_hours")
    stations = _parse_stations(content, path)
    made_for = parse_made_for(content, path)
    if lst_hours.size < FEWEST_INSTANTS or np.all(_is_even(lst_hours)):
        return SkyPower(frequency_mhz, lst_hours, power, path, made_for=made_for, stations=stations)
    return replace(_fit_uneven(path, frequency_mhz, lst_hours, power, made_for), stations=stations)


def _parse_stations(content: Mapping[str, Any], place: str) -> dict[str, SkyPower]:
    """P_sky of stations that stand elsewhere; channels and LST are those of the file unless a station has its own."""
    stations = content.get("stations", {})
    if not isinstance(stations, dict) or not all(isinstance(one, dict) for one in stations.values()):
        raise BadInputError(f"{place}: stations", "an object of sky powers by station", "another shape")
    axes = {name: content[name] for name in ("frequency_mhz", "lst_hours")}
    return {str(name): _parse_sky_power(axes | one, f"{place}: stations.{name}") for name, one in stations.items()}


def _is_even(lst_hours: Floats) -> NDArray[np.bool_]:
    """Whether each instant follows the one before by an even share of the sidereal day, shape (lst - 1,)."""
    return np.asarray(np.abs(np.diff(lst_hours) - 24.0 / lst_hours.size) < LST_TOLERANCE_HOURS)


def _fit_uneven(
    place: str, frequency_mhz: Floats, lst_hours: Floats, power: dict[str, Floats], made_for: MadeFor | None
) -> SkyPower:
    """The table of a Fourier series fitted to uneven instants; its digest is that of the numbers given."""
    for row in range(1, lst_hours.size):
        if not lst_hours[row - 1] < lst_hours[row] <= lst_hours[0] + 24.0:
            raise BadInputError(
                f"{place}: lst_hours, row {row}",
                f"more than {lst_hours[row - 1]:g} h and at most {lst_hours[0] + 24.0:g} h (LST rise over one day)",
                f"{lst_hours[row]:g} h",
            )
    # refuses missing rows and values that are not positive, by their place in the file
    SkyPower(frequency_mhz, 24.0 * np.arange(lst_hours.size) / lst_hours.size, power, place)
    even, fitted, fit = make_even(place, lst_hours, power)
    table = SkyPower(frequency_mhz, even, fitted, f"{place} ({fit})", fit=fit, made_for=made_for)
    return table.of_inputs(hash_arrays(frequency_mhz, lst_hours, *(power[dipole] for dipole in sorted(power))))


def write_sky_power(sky_power: SkyPower, path: Path) -> None:
    """Write a sky power file."""
    path.write_text(json.dumps(sky_power.as_dict(), allow_nan=False) + "\n")
