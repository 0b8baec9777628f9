"""A calibration in ten lines of Python: describe the instrument, read the spectra, fit, look.

>>> import lbacal, numpy as np
>>> from astropy import units as u
>>> site = lbacal.Site(latitude=-30.7 * u.deg, longitude=21.4 * u.deg)
>>> antenna = lbacal.Antenna("inverted-v", arms={"E": 90 * u.deg, "N": 0 * u.deg})
>>> instrument = lbacal.Instrument("mine", site, antenna, lbacal.Chain(), np.arange(50, 100) * u.MHz, antennas=3)
>>> spectra = lbacal.simulate(instrument, events=200)
>>> found = lbacal.fit(spectra, instrument)
>>> figure = found.plot()

Units are astropy's here, at the edge; `lbacal_core` behind it has plain numbers with their unit in the name. A number
without a unit is taken in the unit that the argument names.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from astropy import units as u
from astropy.table import QTable

from lbacal.chain import Chain, convert_number, convert_numbers
from lbacal_core.curves.curves import CalibrationCurve, FitReport
from lbacal_core.errors import MissingExtraError, UnknownNameError
from lbacal_core.instrument.antennas import ABSOLUTE, AntennaRecord, GainProvenance
from lbacal_core.instrument.antennas import Site as CoreSite
from lbacal_core.instrument.instrument import Instrument as CoreInstrument
from lbacal_core.instrument.instrument import load_instrument
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra.spectra import Spectra
from lbacal_core.spectra.spectra import read_spectra as read_core_spectra

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from lbacal_core.simulation.simulation import Simulation

SHOWN_ROWS = 12
STATION, CABLE = "S1", "all"


@dataclass(frozen=True)
class Site:
    """Where an instrument or a station stands: geographic latitude and longitude (east positive, deg), height (m)."""

    latitude: Any
    longitude: Any
    height: Any = 0.0

    def core(self) -> CoreSite:
        """The same in plain numbers."""
        north, east = (convert_number(angle, u.deg) for angle in (self.latitude, self.longitude))
        return CoreSite(north, east, convert_number(self.height, u.m))


@dataclass(frozen=True)
class Antenna:
    """What its dipoles see: a model, by name or file, and the arms.

    Attributes
    ----------
    model
        Name of an antenna model that ships with the package, or file of Jones terms.
    arms
        Azimuth of each dipole's arm by its letter, deg, north through east; or (azimuth, tilt).
    gain
        G_ant, m^2: one number, or one a channel. 1 makes C relative.
    gain_source
        Where a G_ant in m^2 comes from, in words; None for one that is in m^2 up to a factor.
    """

    model: str
    arms: Mapping[str, Any]
    gain: Any = 1.0
    gain_source: str | None = None


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
        frequency_mhz = convert_numbers(frequency, u.MHz)
        arms = {letter: arm if isinstance(arm, tuple) else (arm, 0.0) for letter, arm in antenna.arms.items()}
        tilts = {letter: convert_number(tilt, u.deg) for letter, (_, tilt) in arms.items()}
        by_station = antennas if isinstance(antennas, Mapping) else {STATION: antennas}
        self.core = CoreInstrument(
            name=name,
            latitude_deg=site.core().latitude_deg,
            longitude_deg=site.core().longitude_deg,
            height_m=site.core().height_m,
            frequency_mhz=frequency_mhz,
            dipole_azimuth_deg={letter: convert_number(azimuth, u.deg) for letter, (azimuth, _) in arms.items()},
            antenna_gain=np.broadcast_to(convert_numbers(antenna.gain, u.m**2), frequency_mhz.shape).copy(),
            receiver_gain=chain.receiver_gain(frequency_mhz).copy(),
            cables={CABLE: chain.cable_loss(frequency_mhz).copy()},
            antennas=tuple(
                AntennaRecord(station, int(number), CABLE)
                for station, numbers in by_station.items()
                for number in (range(numbers) if isinstance(numbers, int) else numbers)
            ),
            antenna=antenna.model,
            sky=sky,
            dipole_tilt_deg={letter: tilt for letter, tilt in tilts.items() if tilt},
            gain_provenance=None if antenna.gain_source is None else GainProvenance(ABSOLUTE, antenna.gain_source),
            stages=chain.core_stages(frequency_mhz),
            kelvin_error=chain.kelvin_error,
            sites={station: one.core() for station, one in (sites or {}).items()},
        )

    @classmethod
    def load(cls, name_or_file: str | Path) -> Instrument:
        """An instrument that ships with the package, or the one of a file."""
        made = cls.__new__(cls)
        made.core = load_instrument(str(name_or_file))
        return made

    def save(self, path: str | Path) -> None:
        """Write the instrument file (docs/formats.md)."""
        import json

        Path(path).write_text(json.dumps(self.core.as_dict(), indent=1) + "\n")

    def sky_power(self) -> SkyPower:
        """P_sky(LST, nu) of each dipole from the sky and antenna models that the instrument names."""
        from lbacal_core.skypower.model import compute_sky_power

        return compute_sky_power(self.core)

    def __repr__(self) -> str:
        """One line."""
        one = self.core
        nu, letters = one.frequency_mhz, ", ".join(one.dipoles)
        return (
            f"<Instrument {one.name}: {len(one.antennas)} antennas with {letters}, {nu.size} channels "
            f"{nu[0]:g}-{nu[-1]:g} MHz, {one.latitude_deg:g} deg north>"
        )


def _core(instrument: Instrument | CoreInstrument | str | Path) -> CoreInstrument:
    if isinstance(instrument, Instrument):
        return instrument.core
    return instrument if isinstance(instrument, CoreInstrument) else load_instrument(str(instrument))


def read_spectra(path: str | Path) -> Spectra:
    """Read a spectra file (docs/formats.md); `lbacal import` makes one of other formats."""
    return read_core_spectra(Path(path))


def simulate(
    instrument: Instrument | CoreInstrument | str,
    events: int = 300,
    antennas: int | None = None,
    seed: int = 1,
    stations: Sequence[str] | None = None,
) -> Spectra:
    """A simulated year of an instrument's spectra, to try things on: noise as LOFAR's, events at random times.

    Parameters
    ----------
    antennas
        How many of each station; all unless given.
    stations
        The first one unless given.
    """
    from lbacal_core.skypower.model import compute_sky_power

    try:
        from lbacal_twin.campaign import simulate_campaign
        from lbacal_twin.settings import TwinSettings
    except ModuleNotFoundError as error:
        raise MissingExtraError("lbacal.simulate", "twin") from error
    core = _core(instrument)
    chosen = stations or sorted({record.station for record in core.antennas})[:1]
    settings = TwinSettings(events_per_year=events, antennas=antennas, stations=tuple(chosen))
    return simulate_campaign(settings, core, compute_sky_power(core), np.random.default_rng(seed)).spectra


@dataclass(frozen=True)
class Calibration:
    """What a fit found: a curve C(nu) for each path, station or the array, as `report` has them.

    ``found["S1", 3, "E"]`` is one curve as a table with units, `table` all of them; `plot` draws.
    """

    report: FitReport
    simulation: Simulation = field(repr=False)
    spectra: Spectra = field(repr=False)

    @property
    def instrument(self) -> CoreInstrument:
        """What was calibrated."""
        return self.simulation.instrument

    def __getitem__(self, key: tuple[Any, ...]) -> QTable:
        """C of one curve: (station, antenna, dipole), (station, dipole) or (dipole,) by what was fitted."""
        wanted = key if isinstance(key, tuple) else (key,)
        for curve in self.report.curves:
            own = tuple(part for part in (curve.station, curve.antenna, curve.dipole) if part is not None)
            if own == wanted:
                return _as_table([curve])
        names = [curve.name for curve in self.report.curves]
        raise UnknownNameError("curve", " ".join(str(part) for part in wanted), names[:SHOWN_ROWS])

    @property
    def table(self) -> QTable:
        """All curves that have values, one row a curve and channel."""
        return _as_table([curve for curve in self.report.curves if curve.c is not None])

    def plot(self, path: str | Path | None = None) -> Figure:
        """C with its errors, residuals, noise terms and chi^2 of every dipole; written to a file if one is named."""
        from lbacal.pages.fit import average_residuals, draw_fit

        maps = average_residuals(self.spectra, self.report.curves, self.simulation)
        figure = draw_fit(self.report, maps, self.simulation)
        if path is not None:
            figure.savefig(path)
        return figure

    def _rows(self) -> list[tuple[str, str, str, str]]:
        return [
            (
                curve.name,
                curve.status,
                "-" if curve.chi2_per_dof is None else f"{curve.chi2_per_dof:.2f}",
                "; ".join(
                    [
                        *([curve.merged.reason] if curve.merged else []),
                        *([str(curve.sky_over_model)] if curve.sky_over_model else []),
                    ]
                ),
            )
            for curve in self.report.curves
        ]

    def __repr__(self) -> str:
        """A line a curve, the first ones."""
        rows = [f"{name}: {status}, chi2/dof {chi2}" for name, status, chi2, _ in self._rows()]
        more = [f"... {len(rows) - SHOWN_ROWS} more"] if len(rows) > SHOWN_ROWS else []
        return "\n".join([f"<Calibration {self.instrument.name}>", *rows[:SHOWN_ROWS], *more])

    def _repr_html_(self) -> str:
        """A table for notebooks."""
        from html import escape

        cells = "".join(
            "<tr>" + "".join(f"<td>{escape(text)}</td>" for text in row) + "</tr>" for row in self._rows()[:SHOWN_ROWS]
        )
        more = len(self.report.curves) - SHOWN_ROWS
        rest = f"<p>and {more} more</p>" if more > 0 else ""
        head = "<tr><th>curve</th><th>status</th><th>chi²/dof</th><th>remarks</th></tr>"
        return f"<p>{escape(self.instrument.name)}</p><table>{head}{cells}</table>{rest}"


def _as_table(curves: Sequence[CalibrationCurve]) -> QTable:
    """Curves as a table with units; NaN where C is not determined."""
    table = QTable()
    channels = [curve.frequency_mhz.size for curve in curves]

    def column(of: Callable[[CalibrationCurve], Any]) -> Any:
        return np.repeat(np.array([of(curve) for curve in curves]), channels)

    table["station"] = column(lambda curve: curve.station or "")
    table["antenna"] = column(lambda curve: -1 if curve.antenna is None else curve.antenna)
    table["dipole"] = column(lambda curve: curve.dipole or "")
    table["frequency"] = np.concatenate([curve.frequency_mhz for curve in curves]) * u.MHz
    for name in ("c", "c_sigma_stat", "c_sigma_sys"):
        values = [getattr(curve, name) for curve in curves]
        filled = [np.full(size, np.nan) if one is None else one for one, size in zip(values, channels, strict=True)]
        table[name] = np.concatenate(filled) * u.V
    table["flag"] = np.concatenate([curve.flags for curve in curves])
    table.meta["status"] = {curve.name: curve.status for curve in curves}
    return table


def fit(
    spectra: Spectra | str | Path,
    instrument: Instrument | CoreInstrument | str | Path,
    sky_power: SkyPower | None = None,
    scope: str = "antenna",
) -> Calibration:
    """Calibrate with the Galaxy: C(nu) of every antenna (``scope="antenna"``), ``station`` or ``array``.

    Parameters
    ----------
    spectra
        From `read_spectra` or `simulate`, or the name of a spectra file.
    instrument
        An `Instrument`, or the name or file of one.
    sky_power
        P_sky(LST, nu); the instrument's own sky and antenna models unless given.

    Returns
    -------
    What the quick part of the audit says of the spectra is `report.provenance.notes["audit"]`; it refuses decibels and
    volts.
    """
    from lbacal_core.audit.audit import audit_quickly
    from lbacal_core.pipeline import calibrate
    from lbacal_core.simulation.simulation import Simulation

    simulation = Simulation(_core(instrument), sky_power)
    measured = spectra if isinstance(spectra, Spectra) else read_spectra(spectra)
    audited = audit_quickly(measured, simulation.instrument)
    audited.require_power(measured.origin)
    return Calibration(audited.mark(calibrate(measured, simulation, scope)), simulation, measured)
