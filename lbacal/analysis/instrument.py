"""An instrument in Python: the place, the antenna with its arms, the chain and the channels, in astropy's units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Union

import numpy as np
from astropy import units as u

from lbacal.chain import Chain, spread_numbers
from lbacal.files import path_of, write_json, written_beside
from lbacal.settings import causes_file
from lbacal.units import convert_number, convert_numbers
from lbacal_core.errors import BadInputError, require_kind
from lbacal_core.foreign import parse_number
from lbacal_core.grids import HIGHEST_GALAXY_MHZ, require_channels
from lbacal_core.instrument.antennas import ABSOLUTE, AntennaRecord, GainProvenance
from lbacal_core.instrument.antennas import Site as CoreSite
from lbacal_core.instrument.instrument import Instrument as CoreInstrument
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.instrument.stages import IN_LINE

if TYPE_CHECKING:
    from lbacal_core.simulation.simulation import Simulation
    from lbacal_core.sky.table import SkyPower

STATION, CABLE = "S1", "all"


@dataclass(frozen=True)
class Site:
    """Where an instrument or a station stands: geographic latitude and longitude (east positive, deg), height (m)."""

    latitude: Any
    longitude: Any
    height: Any = 0.0

    def core(self) -> CoreSite:
        """Convert the site to plain numbers."""
        north, east = (convert_number(angle, u.deg) for angle in (self.latitude, self.longitude))
        return CoreSite(north, east, convert_number(self.height, u.m))


@dataclass(frozen=True)
class Antenna:
    """An antenna of the instrument: the response of its dipoles, by name or file, and the arms.

    Attributes
    ----------
    model
        Name of an antenna model that ships with the package, or file of Jones terms.
    arms
        Azimuth of each dipole's arm by its letter, deg, north through east; or (azimuth, tilt).
    gain
        G_ant, m^2: one number, one a channel, or a function of the frequency in MHz such as `effective_length`. 1 makes
        C relative.
    gain_source
        Where a G_ant in m^2 comes from, in words; None for one that is in m^2 up to a factor.
    doubt
        Probability that the antenna is another than `model`: 0 where it was measured; None where nobody says.
    """

    model: str
    arms: Mapping[str, Any]
    gain: Any = 1.0
    gain_source: str | None = None
    doubt: float | None = None


class Instrument:
    """An instrument from its parts, or one that ships, or a file: `Instrument.load("lofar-superterp")`.

    `core` is the value that the commands, the service and `lbacal_core` work with; `save` writes its file.

    Parameters
    ----------
    antennas
        How many, or their numbers; of several stations a mapping of that by station.
    sites
        Where stations stand that do not stand at `site`.
    """

    def __init__(
        self,
        name: str,
        site: Site,
        antenna: Antenna,
        chain: Chain,
        frequency: Any,
        antennas: int | Sequence[int] | Mapping[str, int | Sequence[int]] = 1,
        sky: str | None = None,
        sites: Mapping[str, Site] | None = None,
    ) -> None:
        for place, value, kind, example in (
            ("site", site, Site, "lbacal.Site(52.9, 6.9)"),
            ("antenna", antenna, Antenna, "lbacal.Antenna('hamaker', {'X': 225.0, 'Y': 135.0})"),
            ("antenna: arms", getattr(antenna, "arms", None), Mapping, "{'X': 225.0, 'Y': 135.0}"),
            ("chain", chain, Chain, "lbacal.Chain([20 * u.dB])"),
        ):
            require_kind(place, value, kind, f"one such as {example}")
        frequency_mhz = convert_numbers(frequency, u.MHz)
        require_channels(f"instrument {name}", frequency_mhz, HIGHEST_GALAXY_MHZ)  # before stages are read at them
        arms = {str(letter): arm if isinstance(arm, tuple) else (arm, 0.0) for letter, arm in antenna.arms.items()}
        if any(len(arm) != 2 for arm in arms.values()):
            raise BadInputError("antenna: arms", "an azimuth, or (azimuth, tilt)", repr(dict(antenna.arms)))
        tilts = {letter: convert_number(tilt, u.deg) for letter, (_, tilt) in arms.items()}
        by_station = antennas if isinstance(antennas, Mapping) else {STATION: antennas}
        stages = chain.core_stages(frequency_mhz)
        if antenna.gain_source is None and (
            chain.kelvin_error is not None or any(one.noise_k is not None and one.kind in IN_LINE for one in stages)
        ):
            expected = "where the G_ant of gain= in m^2 comes from, in words: kelvin are referred to the sky through it"
            raise BadInputError("antenna: gain_source", expected, "None beside a chain that says kelvin")
        self.core = CoreInstrument(
            name=name,
            **vars(site.core()),
            frequency_mhz=frequency_mhz,
            dipole_azimuth_deg={letter: convert_number(azimuth, u.deg) for letter, (azimuth, _) in arms.items()},
            antenna_gain=spread_numbers(antenna.gain, u.m**2, frequency_mhz, "antenna: gain"),
            receiver_gain=chain.receiver_gain(frequency_mhz).copy(),
            cables={CABLE: chain.cable_loss(frequency_mhz).copy()},
            antennas=tuple(
                AntennaRecord(station, number, CABLE) for station, own in by_station.items() for number in _number(own)
            ),
            antenna=antenna.model,
            sky=sky,
            antenna_doubt=None if antenna.doubt is None else parse_number(antenna.doubt, "antenna: doubt"),
            dipole_tilt_deg={letter: tilt for letter, tilt in tilts.items() if tilt},
            gain_provenance=None if antenna.gain_source is None else GainProvenance(ABSOLUTE, antenna.gain_source),
            stages=stages,
            kelvin_error=chain.kelvin_error,
            sites={station: one.core() for station, one in (sites or {}).items()},
        )
        self.core.require_arms_that_differ("antenna")

    @classmethod
    def load(cls, name_or_file: str | Path) -> Instrument:
        """An instrument that ships with the package, or the one of a file."""
        expected = "the name of an instrument that ships, such as lofar-superterp, or of a file"
        require_kind("Instrument.load", name_or_file, str | Path, expected)
        made = cls.__new__(cls)
        made.core = load_instrument(str(name_or_file))
        return made

    def with_alternative(self, name: str, *others: Instrument) -> Instrument:
        """The instrument that may be like others, each one standard deviation off: a term of the error of C.

        `fit` and `budget` refit the same spectra with each. Others may differ in their gains and stages; a name that is
        there is given new ones.

        Examples
        --------
        >>> import lbacal
        >>> site, nu = lbacal.Site(52.9, 6.9), range(30, 81)
        >>> antennas = [lbacal.Antenna("short-dipole", {"X": 45.0}, gain) for gain in (1.0, 1.1)]
        >>> mine, larger = (lbacal.Instrument("mine", site, one, lbacal.Chain(), nu) for one in antennas)
        >>> list(mine.with_alternative("G_ant, 10 %", larger).core.alternatives)
        ['G_ant, 10 %']
        """
        made = type(self).__new__(type(self))
        alternatives = {**self.core.alternatives, name: tuple(core_of(one) for one in others)}
        made.core = replace(self.core, alternatives=alternatives)
        return made

    def save(self, path: str | Path) -> None:
        """Write the instrument file (docs/formats/instrument.md)."""
        with written_beside(path_of("save", path)) as beside:
            write_json(self.core.as_dict(), beside)

    def sky_power(self) -> SkyPower:
        """P_sky(LST, nu) of each dipole from the sky and antenna models that the instrument names."""
        from lbacal_core.sky.power import compute_sky_power

        return compute_sky_power(self.core)

    def __repr__(self) -> str:
        """One line."""
        one = self.core
        nu, letters = one.frequency_mhz, ", ".join(one.dipoles)
        return (
            f"<Instrument {one.name}: {len(one.antennas)} antennas with {letters}, {nu.size} channels "
            f"{nu[0]:g}-{nu[-1]:g} MHz, {one.latitude_deg:g} deg north, {one.longitude_deg:g} deg east>"
        )


def _number(antennas: Any) -> list[int]:
    """The numbers of the antennas of a station, which are given, or how many there are."""
    found = np.asarray(range(antennas) if isinstance(antennas, int) else antennas)
    if found.ndim != 1 or found.size == 0 or found.dtype.kind not in "iu" or found.min() < 0:
        raise BadInputError("antennas", "how many there are, 1 or more, or their numbers", repr(antennas))
    return [int(number) for number in found]


Described = Union[Instrument, CoreInstrument, "Simulation", str, Path]
"""What a verb takes for the instrument: one from its parts, the name or the file of one, or one under a sky."""


def core_of(instrument: Any) -> CoreInstrument:
    """The instrument as a value of `lbacal_core`."""
    if isinstance(instrument, str | Path):
        return load_instrument(str(instrument))
    found: CoreInstrument = getattr(instrument, "core", getattr(instrument, "instrument", instrument))
    require_kind("instrument", found, CoreInstrument, "a lbacal.Instrument, or the name or the file of one")
    return found


def simulation_of(instrument: Any, sky_power: SkyPower | str | Path | None = None) -> Simulation:
    """The instrument under its own sky, or under a P_sky that is given or read; a simulation as it is."""
    from lbacal_core.causes.catalogue import catalogue_with
    from lbacal_core.simulation.simulation import Simulation
    from lbacal_core.sky.table import SkyPower, read_sky_power

    if isinstance(instrument, Simulation):
        if sky_power is not None:
            raise BadInputError("sky_power", "an instrument beside it: a simulation has its sky", "a simulation")
        return instrument
    given = read_sky_power(Path(sky_power)) if isinstance(sky_power, str | Path) else sky_power
    require_kind("sky_power", given, SkyPower | None, "a P_sky, or the name of its file")
    return Simulation(core_of(instrument), given, catalogue=catalogue_with(causes_file()))
