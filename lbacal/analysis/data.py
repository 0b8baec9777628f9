"""Spectra in Python: read from files, imported from other formats, or simulated with their truth."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from astropy import units as u
from astropy.table import QTable

from lbacal.analysis.instrument import Described, core_of, simulation_of
from lbacal.analysis.result import Result
from lbacal.calibration_files import holds_curves, read_calibrations
from lbacal.client import make_table
from lbacal.curve_table import CurveTable
from lbacal.files import path_of
from lbacal.pages.chart import BAND, COLOURS, LINE, Chart, Series
from lbacal.pages.curves import FREQUENCY
from lbacal.selection import SUFFIXES, Selection, find_spectra_files, parse_selection, read_selected
from lbacal.units import convert_band, convert_number, make_rng
from lbacal_core.errors import BadInputError, needing, require_kind, write_count
from lbacal_core.grids import WITHIN_1_SIGMA, Floats, name_channels
from lbacal_core.readers.open import choose_channels, open_source
from lbacal_core.readers.source import Averaged
from lbacal_core.readers.source import average as average_source
from lbacal_core.spectra.spectra import Spectra, write_spectra

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from lbacal_core.simulation.simulation import Simulation

DEFAULT_INTERVAL_S = 900.0
"""What one spectrum of `import_data` averages."""

PATH_COLUMNS = ("station", "antenna", "dipole", "frequency_mhz", "c")


@dataclass(frozen=True, repr=False)
class BackgroundSpectra(Spectra):
    """Background spectra, as `lbacal_core` has them, that print, are drawn and are saved.

    Attributes
    ----------
    notes
        What there is to know of their making, a sentence each.
    truth
        C of every path, of spectra that were simulated; None of others.
    """

    notes: Sequence[str] = ()
    truth: QTable | None = None

    @classmethod
    def of(cls, spectra: Spectra, **more: Any) -> Self:
        """Make background spectra of spectra."""
        made = cls.__new__(cls)
        vars(made).update({"notes": (), "truth": None, **vars(spectra), **more})
        return made

    @property
    def shown(self) -> Result:
        """How many there are of which station and dipole, and their power along frequency."""
        names = sorted(set(zip(self.station.tolist(), self.dipole.tolist(), strict=True)))
        own = {name: (self.station == name[0]) & (self.dipole == name[1]) for name in names}
        counted = {
            name: (np.unique(self.antenna[at]).size, np.unique(self.event_id[at]).size, at.sum())
            for name, at in own.items()
        }
        powers = {" ".join(name): self.power[at] for name, at in own.items()}
        return Result(
            title=Spectra.__repr__(self).removeprefix("<Spectra: ").removesuffix(">"),
            rows=[
                ("station", "dipole", "antennas", "events", "spectra"),
                *((*name, *map(str, counts)) for name, counts in counted.items()),
            ],
            words=2,
            notes=self.notes,
            origin=[("file", self.origin)],
            charts=lambda: [_draw_powers(self.frequency_mhz, powers)],
            more=dict.fromkeys(SUFFIXES, partial(write_spectra, self)),
        )

    def plot(self, ax: Any = None) -> Figure:
        """Median power of each station and dipole along frequency, with the range of 68 % of the spectra."""
        return self.shown.plot(ax)

    def save(self, path: str | Path, form: str | None = None) -> None:
        """Write a spectra file (.h5), a figure or a page, as the end of the name says, or `form`."""
        self.shown.save(path, form)

    def __repr__(self) -> str:
        """The title, and a row a station and dipole."""
        return "\n".join([Spectra.__repr__(self), *self.shown.lines])

    def _repr_html_(self) -> str:
        return self.shown._repr_html_()


def _draw_powers(frequency_mhz: Floats, powers: Mapping[str, Floats]) -> Chart:
    series = []
    for k, (name, power) in enumerate(powers.items(), start=1):
        (low, high), colour = np.percentile(power, WITHIN_1_SIGMA, axis=0), k % len(COLOURS)
        series += [
            Series(BAND, frequency_mhz, low=low, high=high, colour=colour),
            Series(LINE, frequency_mhz, np.median(power, axis=0), name=f"{name}, median and 68 %", colour=colour),
        ]
    return Chart("power of the spectra", FREQUENCY, "power (ADC²/Ω/MHz)", series, ("linear", "log"))


def spectra_of(data: Spectra | str | Path) -> Spectra:
    """The spectra, read where they are a file."""
    if isinstance(data, Spectra):
        return data.without_empty_channels()
    require_kind("spectra", data, str | Path, "those of lbacal.read, or the name of a file")
    return read_selected([Path(data)], Selection(), time.time())


def in_common(spectra: Spectra, simulation: Simulation) -> tuple[Simulation, str]:
    """The simulation on the channels of the spectra, and a sentence where they lack some of its own."""
    ours = simulation.on_channels(spectra.frequency_mhz)
    every, kept = simulation.instrument.frequency_mhz, ours.instrument.frequency_mhz
    missing = every[~np.isin(every, kept)]
    lacking = f"{missing.size} of {every.size} hold no power or are not in the spectra: {name_channels(missing)}"
    return ours, lacking if missing.size else ""


def read(
    source: str | Path | Sequence[str | Path],
    since: Any = None,
    until: Any = None,
    stations: Sequence[str] = (),
    *,
    tell: Callable[[str], None] = lambda _: None,
) -> BackgroundSpectra | CurveTable:
    """Read spectra from files or folders of them; or calibration curves from a file of `lbacal fit`.

    Parameters
    ----------
    since, until
        Half-open interval of the events to use: an astropy Time, a date, a datetime (naive = UTC) or ISO 8601 text.
    stations
        Stations whose spectra to use; all unless given.
    tell
        Called with a sentence before each step.

    Raises
    ------
    BadInputError
        Where a file does not follow its format, no spectra are left, or curves are to be chosen like spectra.

    Examples
    --------
    >>> import lbacal
    >>> lbacal.read("2014/", since="2014-03-01", stations=["CS002"]).save("spring.h5")  # doctest: +SKIP
    """
    named = [source] if isinstance(source, str | Path) else source
    if not isinstance(named, Sequence) or not named:
        raise BadInputError("read", "a file or a folder, or a list of them", "none")
    paths = [path_of("read", one) for one in named]
    if len(paths) == 1 and paths[0].suffix.lower() == ".csv":
        known = "curves as .ecsv, .fits, .h5 or .json, spectra as HDF5; lbacal.import_data reads other spectra"
        found = "a CSV file; of curves it holds the rows alone, which astropy.table.QTable.read reads"
        raise BadInputError(str(paths[0]), known, found)
    if len(paths) == 1 and holds_curves(paths[0]):
        if since is not None or until is not None or stations:
            raise BadInputError("since, until, stations", "spectra beside them", f"the curves of {paths[0]}")
        return make_table(read_calibrations(paths[0]))
    selection = parse_selection(since, until, None, [stations] if isinstance(stations, str) else stations, prefix="")
    return BackgroundSpectra.of(read_selected(find_spectra_files(paths), selection, time.time(), tell))


def import_data(
    source: str | Path,
    average: Any = None,
    instrument: Described | None = None,
    channel: Any = None,
    band: tuple[Any, Any] | None = None,
    station: str | None = None,
    *,
    events: bool = False,
    tell: Callable[[str], None] = lambda _: None,
) -> BackgroundSpectra:
    """Average autocorrelations or station statistics to background spectra, whatever the length of the data.

    Parameters
    ----------
    source
        File or folder, in any format of docs/how-to/import-other-data.md.
    average
        Time that one spectrum averages, s or a Quantity. Unless given, integrations that have an `event_id` stay events
        of their own and 900 s of others are averaged.
    instrument
        Whose channels to average to; or `channel`, their width, MHz or a Quantity.
    band
        Lowest and highest channel, MHz or Quantities.
    station
        Its name, where the data have none.
    events
        Every integration is an event of its own, and nothing is averaged.
    tell
        Called with a sentence after each part that was read.

    Examples
    --------
    >>> import lbacal
    >>> spectra = lbacal.import_data("zen.uvh5", average=60, channel=1, band=(50, 200))  # doctest: +SKIP
    >>> spectra.save("S.h5")  # doctest: +SKIP
    """
    if instrument is not None and channel is not None:
        raise BadInputError("import", "instrument or channel", "both")
    if events and average is not None:
        raise BadInputError("import", "average or events", "both")
    interval, width = (
        None if value is None else convert_number(value, unit) for value, unit in ((average, u.s), (channel, u.MHz))
    )
    for name, value in (("average", interval), ("channel", width)):
        if value is not None and not 0 < value < np.inf:
            raise BadInputError(name, "a number > 0", f"{value}")
    is_merging, interval = interval is not None, None if events else interval or DEFAULT_INTERVAL_S
    limits = None if band is None else convert_band(band)
    opened = open_source(path_of("import_data", source), station)
    chosen = choose_channels(opened, None if instrument is None else core_of(instrument), limits, width)
    result = average_source(
        opened, interval, chosen, lambda count: tell(f"{count} integrations"), is_merging_events=is_merging
    )
    if instrument is not None:
        core_of(instrument).require_dipoles(result.spectra.dipole, opened.name, opened.arms_deg)
    return BackgroundSpectra.of(
        result.spectra, notes=[*opened.notes, _describe_arms(opened.arms_deg), *_describe(result, interval)]
    )


def _describe_arms(arms_deg: Mapping[str, float]) -> str:
    if not arms_deg:
        return "the data do not say where the arms point: the instrument's azimuths are taken for them"
    arms = ", ".join(f"{letter} to {azimuth:g} deg" for letter, azimuth in arms_deg.items())
    return f"the arms point where the data say: {arms}; an instrument with others is refused"


def _describe(result: Averaged, interval_s: float | None) -> Iterator[str]:
    if result.negatives:
        yield f"{result.negatives} values of the power are below 0 (decibels? it must be on a linear scale), left out"
    if result.paths_left_out:
        first, *others = result.paths_left_out
        more = f" and {write_count(len(others), 'path')} more" if others else ""
        yield f"no spectrum of {first}{more}: in none has every channel a power > 0 that is not flagged"
    if result.channels_left_out.size:
        low, high = result.channels_left_out[[0, -1]]
        yield f"{result.channels_left_out.size} channels between {low:g} and {high:g} MHz are flagged, left out"
    if result.spectra_filled:
        yield f"{result.spectra_filled} spectra lack a few channels, filled as in the path's other spectra"
    if result.spectra_left_out:
        yield f"{result.spectra_left_out} spectra lack one of the other channels, left out"
    for flag, count in result.flags.items():
        yield f"{count} spectra are flagged {flag!r}: the file keeps them, fits leave them out"
    spectra, channels = result.spectra, result.spectra.frequency_mhz
    count = np.unique(spectra.event_id).size
    of_what = f"{count} events" if interval_s is None else f"{count} intervals of {interval_s:g} s"
    if result.events and interval_s is not None:
        of_what = f"{count} events or intervals of {interval_s:g} s ({result.events} with an event_id)"
    yield (
        f"{len(spectra)} spectra, {of_what} from {result.integrations} "
        f"integrations, {channels.size} channels from {channels[0]:g} to {channels[-1]:g} MHz"
    )


def simulate(
    instrument: Described,
    events: int = 300,
    antennas: int | None = None,
    seed: int = 1,
    stations: Sequence[str] | None = None,
) -> BackgroundSpectra:
    """A simulated year of an instrument's spectra, to try things on: noise and A(nu) are LOFAR's, times are random.

    Parameters
    ----------
    antennas
        How many of each station; all unless given.
    stations
        The first one unless given.

    Returns
    -------
    The spectra; their `truth` is C of every path, in rows as those of the table of a fit.

    Examples
    --------
    >>> import lbacal
    >>> spectra = lbacal.simulate("lofar-superterp", events=60, antennas=2)
    >>> spectra.truth["dipole", "frequency_mhz", "c"][:1].colnames
    ['dipole', 'frequency_mhz', 'c']
    >>> len(spectra)
    240
    """
    require_kind("events", events, int | np.integer, "a whole number")
    require_kind("antennas", antennas, int | np.integer | None, "a whole number, or None for all")
    with needing("lbacal.simulate", "twin"):
        from lbacal_twin.campaign import simulate_campaign
        from lbacal_twin.settings import TwinSettings
    simulation = simulation_of(instrument)
    core = simulation.instrument
    rng = make_rng(seed)
    chosen = ([stations] if isinstance(stations, str) else stations) or sorted(
        {record.station for record in core.antennas}
    )[:1]
    settings = TwinSettings(events_per_year=events, antennas=antennas, stations=tuple(chosen))
    campaign = simulate_campaign(settings, core, simulation.sky_power, rng)
    paths = [
        (one.station, int(antenna), dipole, one.c[row, k])
        for one in campaign.truth.stations
        for row, antenna in enumerate(one.antennas)
        for k, dipole in enumerate(campaign.truth.dipoles)
    ]
    nu = core.frequency_mhz
    station, antenna, dipole, c = zip(*paths, strict=True)
    columns = [np.repeat(column, nu.size) for column in (station, antenna, dipole)]
    truth = QTable([*columns, np.tile(nu, len(paths)) * u.MHz, np.concatenate(c) * u.V], names=PATH_COLUMNS)
    return BackgroundSpectra.of(campaign.spectra, truth=truth)
