"""The paths that a fit is made of: every antenna's dipole, or the mean over a station or the array as one path."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from lbacal_core.calibration.singles import (
    FEWEST_EVENTS,
    MIN_EVENTS,
    SingleFits,
    fit_singles,
    hears_the_sky,
    relative_variance_of,
)
from lbacal_core.calibration.spreads import SinglePaths, join_paths
from lbacal_core.curves.curves import NOT_IDENTIFIABLE, Anomaly, CalibrationCurve
from lbacal_core.curves.kept_lines import MemberLines, Owner, join_away, join_members
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.spectra.blocks import Recorded, SpectraBlock, iterate_blocks
from lbacal_core.spectra.screening import leave_out
from lbacal_core.spectra.spectra import Spectra

BLOCK_SAMPLES = 1024
LST_BINS = 96
"""The 15-minute bins of section 3.1 of the paper."""
MIN_LST_BINS = 24
"""A quarter of the sidereal day: less sees the Galaxy neither rise nor set."""
LEAST_COVERAGE = MIN_LST_BINS / LST_BINS
SHARE_OF_STEADY_PATHS = 0.5


def is_undetermined(curve: CalibrationCurve) -> bool:
    """Whether the data of a path with enough events at enough sidereal times do not determine C."""
    return curve.status == NOT_IDENTIFIABLE and curve.lst_coverage >= LEAST_COVERAGE


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


def require_one_cable_each(spectra: Recorded, instrument: Instrument) -> Cables:
    """The cable of every antenna: each must be known to the instrument and keep its cable over the window."""
    quarters, origin = spectra.quarter_hashes, spectra.head.origin
    letters = spectra.dipole if isinstance(spectra, Spectra) else np.array([dipole for *_, dipole in quarters])
    instrument.require_dipoles(letters, origin, spectra.head.arms_deg)
    found: dict[tuple[str, int], str] = {}
    for station, antenna in sorted({(station, antenna) for station, antenna, _ in quarters}):
        try:
            cables = instrument.cables_between(station, antenna, *spectra.span_unix)
        except BadInputError as error:
            row = int(np.argmax(spectra.read(station).is_of([(station, antenna)])))
            place = f"{origin}: antenna, row {row}: {error.place}"
            raise BadInputError(place, error.expected, error.found) from error
        if len(cables) > 1:
            raise BadInputError(
                f"{origin}: station {station}, antenna {antenna}",
                "one cable over the window: fit the time before and after the change separately",
                f"cables {', '.join(cables)}",
            )
        found[station, antenna] = cables[0]
    return found


def unchanged_cables(
    names: Iterable[tuple[str, int]], first_unix: float, last_unix: float, instrument: Instrument
) -> Cables:
    """The cables of those (station, antenna) that have one on record, from the first event to the last, s UTC."""
    held: dict[tuple[str, int], list[AntennaRecord]] = {name: [] for name in names}
    for record in instrument.antennas:
        held.get((record.station, record.antenna), []).append(record)
    return {
        name: records[0].cable
        for name, records in held.items()
        if len(records) == 1 and all(records[0].covers(edge) for edge in (first_unix, last_unix))
    }


def paths_of_scope(
    spectra: Recorded,
    simulation: Simulation,
    scope: str,
    cable_of: Cables,
    elsewhere: Callable[[Owner], Sequence[MemberLines]] = lambda _: (),
) -> Iterator[Callable[[], Paths]]:
    """The paths of a scope (`antenna`, `station`, `array`), a batch at a time, each read by whoever has a core for it.

    Parameters
    ----------
    spectra
        Those that are read station by station have the scope ``array`` alone.
    cable_of
        Cable names by (station, antenna): of the spectra, and of those that a mean may have although they are away.
    elsewhere
        The members of a mean in other windows that have the same hardware in all, the nearest first.
    """
    reader = _Reader(simulation, cable_of, float(np.median(spectra.blocks)), radiometer_limit(spectra))
    if scope == "array":
        key = "sums of the array", spectra.digest(), simulation.form
        sums: Mapping[str, _Sums] = simulation.made.get(key, lambda: _add_up(spectra.each(reader.sum_stations)))
        for dipole in sorted(sums):
            yield partial(reader.average, sums[dipole], (None, None, dipole), elsewhere((None, None, dipole)))
        return
    if not isinstance(spectra, Spectra):
        raise BadInputError("scope", "array, where spectra are read station by station", scope)
    for block in iterate_blocks(spectra):
        owner = block.station, None, block.dipole
        is_mean = scope == "station"
        yield partial(reader.average_block, block, elsewhere(owner)) if is_mean else partial(reader.read, block)


def radiometer_limit(spectra: Recorded) -> float:
    """The least relative scatter that the power of a typical spectrum can have, whatever the sampling rate.

    A channel of width B observed for a time t holds B t independent samples. Blocks are 1024 samples, taken at twice
    the highest frequency or faster.
    """
    if spectra.duration_s is not None:
        seconds = float(np.median(spectra.duration_s))
    else:
        seconds = float(np.median(spectra.blocks)) * BLOCK_SAMPLES / (2e6 * float(spectra.head.frequency_mhz[-1]))
    return float((1e6 * seconds * np.median(spectra.head.channel_widths())) ** -0.5)


@dataclass(frozen=True)
class _Reader:
    """Makes paths of blocks of spectra; `typical_blocks` and `smallest_scatter` as in `Paths`."""

    simulation: Simulation
    cable_of: Cables
    typical_blocks: float
    smallest_scatter: float

    def read(self, block: SpectraBlock) -> Paths:
        """The paths of a block without anomalous spectra."""
        fitted = fit_singles(block, self.simulation, self.typical_blocks)
        screened = leave_out(block, fitted.is_left_out)
        return Paths(
            owners=[(block.station, int(antenna), block.dipole) for antenna in block.antennas],
            power=screened.power,
            relative_variance=relative_variance_of(screened, self.typical_blocks),
            lst_hours=self.simulation.sidereal_time(block.station, block.time_unix),
            time_unix=block.time_unix,
            anomalies=fitted.anomalies,
            smallest_scatter=self.smallest_scatter,
            typical_blocks=self.typical_blocks,
            fits=fitted,
        )

    def sum_stations(self, spectra: Spectra) -> Mapping[str, _Sums]:
        """Add up the paths of stations for the mean of the array, by dipole."""
        # as threads of a station's blocks alone: those of all would be in memory beside the spectra
        with threadpool_limits(1), ThreadPoolExecutor(os.cpu_count()) as pool:
            of_stations = (iterate_blocks(spectra, one) for one in spectra.key_codes["station"][0].tolist())
            sums = (own for blocks in of_stations for own in pool.map(self.sum_block, blocks))
            return _add_up({own.dipole: own} for own in sums)

    def sum_block(self, block: SpectraBlock, station: str | None = None, *, is_small: bool = False) -> _Sums:
        """Add up the paths of a block for the mean of a station, or of the array.

        In each event the deviations from each antenna's own lines, over the antennas present, are put on the mean of
        the lines: an antenna missing from an event then does not pull the mean towards the others. An antenna counts
        with its power, as in the mean of the lines. If all counted alike, the scatter would be that of a mean which
        weak antennas (long cables) enter as much as strong ones, and the variance of C would be too small by
        1 + var(P_p) / mean(P_p)^2, 1.15 for the cables of the Superterp. The chain of the array stands where the
        instrument does, wherever its stations stand: each deviates from its lines against the sky that it sees itself.

        A path that hardly hears the sky, as in a search, or has too many anomalous spectra, takes part in no event;
        where other windows have its lines it is a member all the same. Where most have too many, they are what the
        station records, and are averaged. A small window has those with half of the most events, in the events of one
        that has the most: too few for a fit by itself.
        """
        fitted = fit_singles(block, self.simulation, self.typical_blocks)
        screened = leave_out(block, fitted.is_left_out)
        events = screened.is_present.sum(axis=1)
        is_member = events >= (max(FEWEST_EVENTS, events.max() / 2) if is_small else MIN_EVENTS)
        if np.mean(fitted.is_steady) > SHARE_OF_STEADY_PATHS:
            is_member &= fitted.is_steady
        sky = self.simulation.sky_at(block.station, block.dipole, block.time_unix)
        if not is_small and np.any(is_member):
            of_sky = fitted.lines.slope[is_member] * sky.mean(axis=0)
            share = np.median(of_sky / (of_sky + fitted.lines.intercept[is_member]), axis=1)
            is_member[is_member] = hears_the_sky(share)
        lines, antennas = fitted.lines.select(np.flatnonzero(is_member)), block.antennas[is_member]
        power, variance = screened.power[is_member], relative_variance_of(screened, self.typical_blocks)[is_member]
        if is_small:
            variance[:, ~screened.is_present[np.argmax(np.where(is_member, events, 0))]] = np.inf
        level = (lines.slope * sky.mean(axis=0) + lines.intercept).mean(axis=1)
        stations = np.full(antennas.size, block.station)
        members = MemberLines(stations, antennas, lines.slope, lines.intercept, level, lines.levels.of_band)
        lst_hours = self.simulation.sidereal_time(station, block.time_unix)
        mean = MeanOfEvents.of(block, lst_hours, sky, members, power, variance)
        if not antennas.size:
            return _Sums(block.dipole, mean, fitted.anomalies)
        solved = members.names, fitted, is_member, self.simulation.instrument, self.cable_of
        singles = [] if is_small else [_single_paths(*solved)]
        scatter = np.median(lines.levels.radiometer, axis=1)
        return _Sums(block.dipole, mean, fitted.anomalies, [members], singles, [scatter])

    def average_block(self, block: SpectraBlock, elsewhere: Sequence[MemberLines]) -> Paths:
        """The mean over the antennas of a station as a path of its own."""
        sums = self.sum_block(block, block.station)
        sums = sums if sums.members else self.sum_block(block, block.station, is_small=True)
        return self.average(sums, (block.station, None, block.dipole), elsewhere)

    def average(self, sums: _Sums, owner: Owner, elsewhere: Sequence[MemberLines]) -> Paths:
        """The mean over antennas as a path of its own, the reference chain."""
        station, _, dipole = owner
        members = join_away(join_members(sums.members), elsewhere) if sums.members else None
        sky = self.simulation.sky_power.of_station(station).at(dipole, sums.mean.lst_hours)
        power, relative_variance = sums.mean.take(sky, members)
        has_data = np.isfinite(relative_variance)
        unit = float(np.median(relative_variance[has_data])) if np.any(has_data) else 1.0
        relative_variance /= unit
        return Paths(
            owners=[owner],
            power=power[None],
            relative_variance=relative_variance[None],
            lst_hours=sums.mean.lst_hours,
            time_unix=sums.mean.time_unix,
            anomalies=sums.anomalies,
            smallest_scatter=self.smallest_scatter,
            scatter=np.array([np.median(np.concatenate(sums.scatters))]) if sums.scatters else None,
            members=[] if members is None else members.names,
            singles=join_paths(sums.singles) if sums.singles else None,
            typical_blocks=self.typical_blocks,
            variance_unit=unit,
            member_lines=members,
        )


@dataclass(frozen=True)
class _Sums:
    """What paths of one dipole add to a mean: to its events, and what each gave by itself."""

    dipole: str
    mean: MeanOfEvents
    anomalies: Sequence[Anomaly]
    members: Sequence[MemberLines] = ()
    singles: Sequence[SinglePaths] = ()
    scatters: Sequence[Floats] = ()

    def __add__(self, other: _Sums) -> _Sums:
        lists = ([*getattr(self, name), *getattr(other, name)] for name in list(vars(self))[2:])
        return _Sums(self.dipole, self.mean + other.mean, *lists)


def _add_up(parts: Iterable[Mapping[str, _Sums]]) -> Mapping[str, _Sums]:
    """The sums of all parts by dipole, one part after the other."""
    found: dict[str, _Sums] = {}
    for part in parts:
        for dipole, own in part.items():
            found[dipole] = found[dipole] + own if dipole in found else own
    return found


@dataclass(frozen=True)
class MeanOfEvents:
    """Sums over members of a mean, event by event, shape (event, freq) and (event,), in the order of `event_id`."""

    event_id: NDArray[np.str_]
    lst_hours: Floats
    time_unix: Floats
    deviation: Floats
    total: Floats
    share: Floats
    scatter: Floats

    @classmethod
    def of(
        cls, block: SpectraBlock, lst_hours: Floats, sky: Floats, members: MemberLines, power: Floats, variance: Floats
    ) -> MeanOfEvents:
        """Add up what members recorded in the events of a block, shape (path, event, freq), and what their lines say.

        `lst_hours`, shape (event,), is where the mean stands, `sky`, shape (event, freq), what the members see.
        """
        is_present = np.isfinite(variance).astype(float)
        total = (is_present.T @ members.slope) * sky + is_present.T @ members.intercept
        deviation = np.einsum("pe,pef->ef", is_present, power) - total
        of_path = members.level[:, None] * is_present
        scatter = np.sum(of_path**2 * np.where(is_present > 0, variance, 0.0), axis=0)
        values = lst_hours, block.time_unix, deviation, total, of_path.sum(axis=0), scatter
        order = np.argsort(block.event_id)
        return cls(block.event_id[order], *(one[order] for one in values))

    def __add__(self, other: MeanOfEvents) -> MeanOfEvents:
        event_id, is_new = np.union1d(self.event_id, other.event_id), ("lst_hours", "time_unix")
        found = {k: np.zeros((event_id.size, *one.shape[1:])) for k, one in vars(self).items() if k != "event_id"}
        for one in (self, other):
            at = np.searchsorted(event_id, one.event_id)
            for name, values in found.items():
                values[at] = getattr(one, name) + (0.0 if name in is_new else values[at])
        return MeanOfEvents(event_id, **found)

    def take(self, sky: Floats, members: MemberLines | None) -> tuple[Floats, Floats]:
        """The power of the mean, shape (event, freq), and its relative variance, infinite where nobody recorded."""
        has_data = self.share > 0
        if members is None:
            return np.ones_like(sky), np.full(has_data.size, np.inf)
        mean = members.slope.mean(axis=0) * sky + members.intercept.mean(axis=0)
        total = np.where(has_data[:, None], self.total, 1.0)
        power = np.where(has_data[:, None], mean * (1.0 + self.deviation / total), 1.0)
        return power, np.where(has_data, self.scatter / np.where(has_data, self.share, 1.0) ** 2, np.inf)


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
