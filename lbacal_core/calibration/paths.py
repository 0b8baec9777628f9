"""The paths that a fit is made of: every antenna's dipole, or the mean over a station or the array as one path."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lbacal_core.anomalies import Anomaly
from lbacal_core.calibration.lines import ChainForms, Lines, fit_lines
from lbacal_core.calibration.separable import solve_separable
from lbacal_core.calibration.spreads import SinglePaths, join_paths
from lbacal_core.chain.noise import noise_constants
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument
from lbacal_core.kept_lines import MemberLines, join_members
from lbacal_core.screening import screen_block
from lbacal_core.sidereal import local_sidereal_time
from lbacal_core.skypower.table import SkyPower
from lbacal_core.spectra import Spectra
from lbacal_core.spectra_blocks import SpectraBlock, iterate_blocks, split_into_blocks

MIN_EVENTS = 60
"""Fewer events leave C worse than 2 % and the noise levels worse than 10 %."""
BLOCK_SAMPLES = 1024
SHARE_OF_STEADY_PATHS = 0.5


@dataclass(frozen=True)
class Paths:
    """Paths to be fitted together: who they are, what was recorded and when.

    A mean of paths is one, with the (station, antenna) it is the mean of and what each of these gave by itself.
    `relative_variance` is infinite for spectra that are absent or, as `anomalies` says, left out. `smallest_scatter` is
    the least radiometer noise that a single typical spectrum can have, `scatter` what those of a mean have, shape
    (path,); None where the path is a single one. The relative variance of a mean is in units of `variance_unit`, and
    `member_lines` are those that it was taken with.
    """

    owners: list[tuple[str | None, int | None, str]]
    power: Floats
    relative_variance: Floats
    lst_hours: Floats
    anomalies: Sequence[Anomaly] = ()
    smallest_scatter: float = 0.0
    scatter: Floats | None = None
    members: Sequence[tuple[str, int]] = ()
    singles: SinglePaths | None = None
    typical_blocks: float = 1.0
    variance_unit: float = 1.0
    member_lines: MemberLines | None = None


Cables = Mapping[tuple[str, int], str]
"""The cable of each (station, antenna) over the window of a fit."""


def require_one_cable_each(spectra: Spectra, instrument: Instrument) -> Cables:
    """The cable of every antenna: each must be known to the instrument and keep its cable over the window."""
    instrument.require_dipoles(spectra.dipole, spectra.origin)
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
    spectra: Spectra, instrument: Instrument, sky_power: SkyPower, scope: str, cable_of: Cables
) -> Iterable[Paths]:
    """The paths of a scope, a batch at a time."""
    typical, smallest = float(np.median(spectra.blocks)), radiometer_limit(spectra)
    if scope == "antenna":
        for block in iterate_blocks(spectra):
            yield replace(_paths_of_block(block, instrument, typical), smallest_scatter=smallest)
        return
    blocks = split_into_blocks(spectra)
    groups = {(block.station if scope == "station" else None, block.dipole) for block in blocks}
    for station, dipole in sorted(groups, key=lambda key: (key[0] or "", key[1])):
        members = [b for b in blocks if b.dipole == dipole and station in (None, b.station)]
        parts = [_paths_of_block(b, instrument, typical, is_for_mean=True) for b in members]
        yield replace(_mean_path(parts, members, instrument, sky_power, station, cable_of), smallest_scatter=smallest)


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
    block: SpectraBlock, instrument: Instrument, typical_blocks: float, *, is_for_mean: bool = False
) -> Paths:
    """The paths of a block without anomalous spectra; for a mean without those paths that have too many of them.

    Where most paths have too many, they are what the station records, and are averaged.
    """
    longitude_deg = instrument.at_station(block.station).longitude_deg
    screened = screen_block(block, longitude_deg)
    with np.errstate(divide="ignore"):
        relative_variance = typical_blocks / screened.block.blocks
    if is_for_mean and np.mean(screened.is_steady) > SHARE_OF_STEADY_PATHS:
        relative_variance[~screened.is_steady] = np.inf
    return Paths(
        owners=[(block.station, int(antenna), block.dipole) for antenna in block.antennas],
        power=screened.block.power,
        relative_variance=relative_variance,
        lst_hours=local_sidereal_time(block.time_unix, longitude_deg),
        anomalies=screened.anomalies,
        typical_blocks=typical_blocks,
    )


def _mean_path(
    parts: list[Paths],
    blocks: list[SpectraBlock],
    instrument: Instrument,
    sky_power: SkyPower,
    station: str | None,
    cable_of: Cables,
) -> Paths:
    """The mean over antennas as a path of its own, the reference chain.

    In each event the deviations from each antenna's own lines, over the antennas present, are put on the mean of the
    lines: an antenna missing from an event then does not pull the mean towards the others. An antenna counts with its
    power, as in the mean of the lines. If all counted alike, the scatter would be that of a mean which weak antennas
    (long cables) enter as much as strong ones, and the variance of C would be too small by 1 + var(P_p) / mean(P_p)^2,
    1.15 for the cables of the Superterp. The chain of the array stands where the instrument does, wherever its stations
    stand: each deviates from its lines against the sky that it sees itself.
    """
    events = np.unique(np.concatenate([block.event_id for block in blocks]))
    dipole = blocks[0].dipole
    channels = blocks[0].frequency_mhz.size
    mean = MeanOfEvents(events.size, channels)
    lst_hours = np.zeros(events.size)
    members: list[tuple[str, int]] = []
    found: list[MemberLines] = []
    singles: list[SinglePaths] = []
    scatters: list[Floats] = []
    forms, place = chain_forms(instrument), instrument.at_station(station)
    for part, block in zip(parts, blocks, strict=True):
        at = np.searchsorted(events, block.event_id)
        lst_hours[at] = local_sidereal_time(block.time_unix, place.longitude_deg)
        has_enough = np.isfinite(part.relative_variance).sum(axis=1) >= MIN_EVENTS
        if not np.any(has_enough):
            continue
        power, variance = part.power[has_enough], part.relative_variance[has_enough]
        sky = sky_power.of_station(block.station).at(dipole, part.lst_hours)
        lines = fit_lines(power, sky, variance, forms)
        expected = lines.power(sky)
        level = expected.mean(axis=(1, 2))
        mean.add(at, power, expected, level, variance)
        stations = np.full(len(power), block.station)
        antennas = block.antennas[has_enough]
        found.append(MemberLines(stations, antennas, lines.slope, lines.intercept, level, lines.levels.of_band))
        averaged = [(block.station, int(antenna)) for antenna in block.antennas[has_enough]]
        members += averaged
        scatters.append(np.median(lines.levels.radiometer, axis=1))
        singles.append(_single_paths(averaged, lines, instrument, cable_of))
    member_lines = join_members(found) if found else None
    power, relative_variance = mean.take(sky_power.of_station(station).at(dipole, lst_hours), member_lines)
    has_data = np.isfinite(relative_variance)
    unit = float(np.median(relative_variance[has_data])) if np.any(has_data) else 1.0
    relative_variance /= unit
    return Paths(
        owners=[(station, None, dipole)],
        power=power[None],
        relative_variance=relative_variance[None],
        lst_hours=lst_hours,
        anomalies=[anomaly for part in parts for anomaly in part.anomalies],
        scatter=np.array([np.median(np.concatenate(scatters))]) if scatters else None,
        members=members,
        singles=join_paths(singles) if singles else None,
        typical_blocks=parts[0].typical_blocks,
        variance_unit=unit,
        member_lines=member_lines,
    )


class MeanOfEvents:
    """Sums over the members of a mean, event by event; shape (event, freq) and (event,)."""

    def __init__(self, events: int, channels: int) -> None:
        self._deviation, self._total = np.zeros((2, events, channels))
        self._share, self._scatter = np.zeros((2, events))

    def add(
        self, at: NDArray[np.intp], power: Floats, expected: Floats, level: Floats, relative_variance: Floats
    ) -> None:
        """Add members: what they recorded and what their lines say of these events, shape (path, event, freq)."""
        is_present = np.isfinite(relative_variance)
        self._deviation[at] += np.einsum("pe,pef->ef", is_present, power - expected)
        self._total[at] += np.einsum("pe,pef->ef", is_present, expected)
        of_path = level[:, None] * is_present
        self._share[at] += of_path.sum(axis=0)
        self._scatter[at] += np.sum(of_path**2 * np.where(is_present, relative_variance, 0.0), axis=0)

    def take(self, sky: Floats, members: MemberLines | None) -> tuple[Floats, Floats]:
        """The power of the mean, shape (event, freq), and its relative variance, infinite where nobody recorded."""
        has_data = self._share > 0
        if members is None:
            return np.ones_like(sky), np.full(has_data.size, np.inf)
        mean = members.slope.mean(axis=0) * sky + members.intercept.mean(axis=0)
        total = np.where(has_data[:, None], self._total, 1.0)
        power = np.where(has_data[:, None], mean * (1.0 + self._deviation / total), 1.0)
        return power, np.where(has_data, self._scatter / np.where(has_data, self._share, 1.0) ** 2, np.inf)


def _single_paths(owners: list[tuple[str, int]], lines: Lines, instrument: Instrument, cable_of: Cables) -> SinglePaths:
    """The slopes of paths fitted by themselves; NaN where the fit determined none."""
    solution = solve_separable(lines.slope, lines.intercept, lines.information, noise_constants(instrument))
    channels = instrument.frequency_mhz.size
    variance = np.einsum("pii->pi", solution.covariance)[:, :channels]
    is_good = (solution.is_converged & solution.is_identifiable)[:, None] & np.isfinite(solution.x) & (variance > 0)
    cables = [cable_of[owner] for owner in owners]
    return SinglePaths(
        stations=np.array([station for station, _ in owners]),
        cables=np.array(cables),
        slope=np.where(is_good, solution.x, np.nan),
        sigma=np.sqrt(np.where(is_good, variance, np.nan)),
        loss=np.array([instrument.cables[cable] for cable in cables]),
    )


def chain_forms(instrument: Instrument) -> ChainForms:
    """The forms along frequency by which the gain of an event may fluctuate."""
    return ChainForms.of(instrument.frequency_mhz, instrument.antenna_gain, instrument.receiver_gain)
