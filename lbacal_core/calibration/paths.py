"""The paths that a fit is made of: every antenna's dipole, or the mean over a station or the array as one path."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lbacal_core.calibration.singles import MIN_EVENTS, SingleFits, fit_singles, relative_variance_of
from lbacal_core.calibration.spreads import SinglePaths, join_paths
from lbacal_core.curves.curves import Anomaly
from lbacal_core.curves.kept_lines import MemberLines, Owner, join_away, join_members
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.blocks import SpectraBlock, iterate_blocks
from lbacal_core.spectra.screening import leave_out
from lbacal_core.spectra.spectra import Spectra

BLOCK_SAMPLES = 1024
LST_BINS = 96
"""The 15-minute bins of section 3.1 of the paper."""
MIN_LST_BINS = 24
"""A quarter of the sidereal day: less sees the Galaxy neither rise nor set."""
LEAST_COVERAGE = MIN_LST_BINS / LST_BINS
SHARE_OF_STEADY_PATHS = 0.5


@dataclass(frozen=True)
class Paths:
    """Paths to be fitted together: who they are, what was recorded and when.

    A mean of paths is one, with the (station, antenna) it is the mean of and what each of these gave by itself.
    `relative_variance` is infinite for spectra that are absent or, as `anomalies` says, left out. `smallest_scatter` is
    the least radiometer noise that a single typical spectrum can have, `scatter` what those of a mean have, shape
    (path,); None where the path is a single one. The relative variance of a mean is in units of `variance_unit`, and
    `member_lines` are those that it was taken with. `fits` are those of single paths.
    """

    owners: list[tuple[str | None, int | None, str]]
    power: Floats
    relative_variance: Floats
    lst_hours: Floats
    time_unix: Floats
    anomalies: Sequence[Anomaly] = ()
    smallest_scatter: float = 0.0
    scatter: Floats | None = None
    members: Sequence[tuple[str, int]] = ()
    singles: SinglePaths | None = None
    typical_blocks: float = 1.0
    variance_unit: float = 1.0
    member_lines: MemberLines | None = None
    fits: SingleFits | None = None

    def count_lst_bins(self) -> NDArray[np.int64]:
        """How many of the bins of sidereal time hold a spectrum, shape (path,)."""
        bins = np.floor(self.lst_hours / 24.0 * LST_BINS).astype(int) % LST_BINS
        is_covered = np.zeros((len(self.owners), LST_BINS), dtype=bool)
        path_at, event_at = np.nonzero(np.isfinite(self.relative_variance))
        is_covered[path_at, bins[event_at]] = True
        return np.asarray(is_covered.sum(axis=1))

    def find_span(self, path: int) -> tuple[float, float] | None:
        """The first and the last event of a path, s UTC; None where it has none."""
        own = self.time_unix[np.isfinite(self.relative_variance[path])]
        return (float(own.min()), float(own.max())) if own.size else None


Cables = Mapping[tuple[str, int], str]
"""The cable of each (station, antenna) over the window of a fit."""


def require_one_cable_each(spectra: Spectra, instrument: Instrument) -> Cables:
    """The cable of every antenna: each must be known to the instrument and keep its cable over the window."""
    instrument.require_dipoles(spectra.dipole, spectra.origin, spectra.arms_deg)
    found: dict[tuple[str, int], str] = {}
    first, last = float(spectra.time_unix.min()), float(spectra.time_unix.max())
    stations, station_at = spectra.key_codes["station"]
    for k, station in enumerate(stations):
        for antenna in np.unique(spectra.antenna[station_at == k]):
            try:
                cables = instrument.cables_between(str(station), int(antenna), first, last)
            except BadInputError as error:
                row = int(np.flatnonzero((spectra.station == station) & (spectra.antenna == antenna))[0])
                place = f"{spectra.origin}: antenna, row {row}: {error.place}"
                raise BadInputError(place, error.expected, error.found) from error
            if len(cables) > 1:
                raise BadInputError(
                    f"{spectra.origin}: station {station}, antenna {antenna}",
                    "one cable over the window: fit the time before and after the change separately",
                    f"cables {', '.join(cables)}",
                )
            found[str(station), int(antenna)] = cables[0]
    return found


def paths_of_scope(
    spectra: Spectra,
    simulation: Simulation,
    scope: str,
    cable_of: Cables,
    elsewhere: Callable[[Owner], Sequence[MemberLines]] = lambda _: (),
) -> Iterator[Callable[[], Paths]]:
    """The paths of a scope (`antenna`, `station`, `array`), a batch at a time, each read by whoever has a core for it.

    Parameters
    ----------
    cable_of
        Cable names by (station, antenna): of the spectra, and of those that a mean may have although they are away.
    elsewhere
        The members of a mean in other windows that have the same hardware in all, the nearest first.
    """
    typical, smallest = float(np.median(spectra.blocks)), radiometer_limit(spectra)

    def fit(block: SpectraBlock) -> SingleFits:
        return fit_singles(block, simulation, typical)

    if scope == "antenna":
        for block in iterate_blocks(spectra):
            yield partial(_paths_of_block, block, simulation, typical, smallest, fit)
        return
    for station in spectra.key_codes["station"][0].tolist() if scope == "station" else [None]:
        is_own = np.ones(len(spectra), dtype=bool) if station is None else spectra.station == station
        for dipole in np.unique(spectra.dipole[is_own]).tolist():
            events = np.unique(spectra.event_id[is_own & (spectra.dipole == dipole)])
            blocks = iterate_blocks(spectra, station, dipole)
            owner = (station, None, dipole)
            yield partial(
                _mean_path, blocks, events, simulation, owner, cable_of, elsewhere(owner), typical, smallest, fit
            )


def radiometer_limit(spectra: Spectra) -> float:
    """The least relative scatter that the power of a typical spectrum can have, whatever the sampling rate.

    A channel of width B observed for a time t holds B t independent samples. Blocks are 1024 samples, taken at twice
    the highest frequency or faster.
    """
    if spectra.duration_s is not None:
        seconds = float(np.median(spectra.duration_s))
    else:
        seconds = float(np.median(spectra.blocks)) * BLOCK_SAMPLES / (2e6 * float(spectra.frequency_mhz[-1]))
    return float((1e6 * seconds * np.median(spectra.channel_widths())) ** -0.5)


def _paths_of_block(
    block: SpectraBlock,
    simulation: Simulation,
    typical_blocks: float,
    smallest_scatter: float,
    fit: Callable[[SpectraBlock], SingleFits],
) -> Paths:
    """The paths of a block without anomalous spectra."""
    fitted = fit(block)
    screened = leave_out(block, fitted.is_left_out)
    return Paths(
        owners=[(block.station, int(antenna), block.dipole) for antenna in block.antennas],
        power=screened.power,
        relative_variance=relative_variance_of(screened, typical_blocks),
        lst_hours=simulation.sidereal_time(block.station, block.time_unix),
        time_unix=block.time_unix,
        anomalies=fitted.anomalies,
        smallest_scatter=smallest_scatter,
        typical_blocks=typical_blocks,
        fits=fitted,
    )


def _mean_path(
    blocks: Iterator[SpectraBlock],
    events: NDArray[np.str_],
    simulation: Simulation,
    owner: Owner,
    cable_of: Cables,
    elsewhere: Sequence[MemberLines],
    typical_blocks: float,
    smallest_scatter: float,
    fit: Callable[[SpectraBlock], SingleFits],
) -> Paths:
    """The mean over antennas as a path of its own, the reference chain.

    In each event the deviations from each antenna's own lines, over the antennas present, are put on the mean of the
    lines: an antenna missing from an event then does not pull the mean towards the others. An antenna counts with its
    power, as in the mean of the lines. If all counted alike, the scatter would be that of a mean which weak antennas
    (long cables) enter as much as strong ones, and the variance of C would be too small by 1 + var(P_p) / mean(P_p)^2,
    1.15 for the cables of the Superterp. The chain of the array stands where the instrument does, wherever its stations
    stand: each deviates from its lines against the sky that it sees itself.

    A path with too many anomalous spectra takes part in no event; where other windows have its lines it is a member all
    the same. Where most have too many, they are what the station records, and are averaged.
    """
    station, _, dipole = owner
    mean = MeanOfEvents(events.size, simulation.instrument.frequency_mhz.size)
    lst_hours, time_unix = np.zeros((2, events.size))
    anomalies: list[Anomaly] = []
    found: list[MemberLines] = []
    singles: list[SinglePaths] = []
    scatters: list[Floats] = []
    for block in blocks:
        fitted = fit(block)
        anomalies += fitted.anomalies
        at = np.searchsorted(events, block.event_id)
        lst_hours[at], time_unix[at] = simulation.sidereal_time(station, block.time_unix), block.time_unix
        screened = leave_out(block, fitted.is_left_out)
        is_member = screened.is_present.sum(axis=1) >= MIN_EVENTS
        if np.mean(fitted.is_steady) > SHARE_OF_STEADY_PATHS:
            is_member &= fitted.is_steady
        if not np.any(is_member):
            continue
        power, variance = screened.power[is_member], relative_variance_of(screened, typical_blocks)[is_member]
        sky = simulation.sky_at(block.station, dipole, block.time_unix)
        lines = fitted.lines.select(np.flatnonzero(is_member))
        level = (lines.slope * sky.mean(axis=0) + lines.intercept).mean(axis=1)
        mean.add(at, power, sky, lines.slope, lines.intercept, level, variance)
        antennas = block.antennas[is_member]
        stations = np.full(antennas.size, block.station)
        found.append(MemberLines(stations, antennas, lines.slope, lines.intercept, level, lines.levels.of_band))
        averaged = [(block.station, int(antenna)) for antenna in antennas]
        scatters.append(np.median(lines.levels.radiometer, axis=1))
        singles.append(_single_paths(averaged, fitted, is_member, simulation.instrument, cable_of))
    member_lines = join_away(join_members(found), elsewhere) if found else None
    power, relative_variance = mean.take(simulation.sky_power.of_station(station).at(dipole, lst_hours), member_lines)
    has_data = np.isfinite(relative_variance)
    unit = float(np.median(relative_variance[has_data])) if np.any(has_data) else 1.0
    relative_variance /= unit
    return Paths(
        owners=[owner],
        power=power[None],
        relative_variance=relative_variance[None],
        lst_hours=lst_hours,
        time_unix=time_unix,
        anomalies=anomalies,
        smallest_scatter=smallest_scatter,
        scatter=np.array([np.median(np.concatenate(scatters))]) if scatters else None,
        members=[] if member_lines is None else member_lines.names,
        singles=join_paths(singles) if singles else None,
        typical_blocks=typical_blocks,
        variance_unit=unit,
        member_lines=member_lines,
    )


class MeanOfEvents:
    """Sums over the members of a mean, event by event; shape (event, freq) and (event,)."""

    def __init__(self, events: int, channels: int) -> None:
        self._deviation, self._total = np.zeros((2, events, channels))
        self._share, self._scatter = np.zeros((2, events))

    def add(
        self,
        at: NDArray[np.intp],
        power: Floats,
        sky: Floats,
        slope: Floats,
        intercept: Floats,
        level: Floats,
        relative_variance: Floats,
    ) -> None:
        """Add members: what they recorded, shape (path, event, freq), and what their lines say of these events."""
        is_present = np.isfinite(relative_variance).astype(float)
        expected = (is_present.T @ slope) * sky + is_present.T @ intercept
        self._deviation[at] += np.einsum("pe,pef->ef", is_present, power) - expected
        self._total[at] += expected
        of_path = level[:, None] * is_present
        self._share[at] += of_path.sum(axis=0)
        self._scatter[at] += np.sum(of_path**2 * np.where(is_present > 0, relative_variance, 0.0), axis=0)

    def take(self, sky: Floats, members: MemberLines | None) -> tuple[Floats, Floats]:
        """The power of the mean, shape (event, freq), and its relative variance, infinite where nobody recorded."""
        has_data = self._share > 0
        if members is None:
            return np.ones_like(sky), np.full(has_data.size, np.inf)
        mean = members.slope.mean(axis=0) * sky + members.intercept.mean(axis=0)
        total = np.where(has_data[:, None], self._total, 1.0)
        power = np.where(has_data[:, None], mean * (1.0 + self._deviation / total), 1.0)
        return power, np.where(has_data, self._scatter / np.where(has_data, self._share, 1.0) ** 2, np.inf)


def _single_paths(
    owners: list[tuple[str, int]],
    fitted: SingleFits,
    is_member: NDArray[np.bool_],
    instrument: Instrument,
    cable_of: Cables,
) -> SinglePaths:
    """The slopes of paths fitted by themselves; NaN where the fit determined none."""
    cables = [cable_of[owner] for owner in owners]
    slope, sigma = fitted.slopes_of(np.flatnonzero(is_member))
    return SinglePaths(
        stations=np.array([station for station, _ in owners]),
        cables=np.array(cables),
        slope=slope,
        sigma=sigma,
        loss=np.array([instrument.cables[cable] for cable in cables]),
    )
