"""What a reader of a foreign format returns: which paths and channels there are, and integrations in blocks of time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lbacal_core.errors import BadInputError, name_path
from lbacal_core.grids import Floats, require_channels
from lbacal_core.instrument.antennas import EXPECTED, are_dipole_names
from lbacal_core.spectra.spectra import BLOCK_S, Spectra, name_event, require_possible


@dataclass(frozen=True)
class Integrations:
    """Successive integrations of all paths of a source.

    Attributes
    ----------
    time_unix, duration_s
        Middle and length of each integration, shape (time,), s.
    power
        Shape (time, path, freq), any unit of power per MHz; NaN or <= 0 where it was flagged or not recorded.
    event_id
        Names of the integrations, shape (time,), empty where one has none; None where none has.
    flag
        Why an integration must not be used, shape (time,), empty where it may; None where all may.
    environment
        Covariates by name, shape (time,) each.
    """

    time_unix: Floats
    duration_s: Floats
    power: NDArray[np.floating]
    event_id: NDArray[np.str_] | None = None
    flag: NDArray[np.str_] | None = None
    environment: Mapping[str, Floats] = field(default_factory=dict)


@dataclass(frozen=True)
class Source:
    """Data in a foreign format, of which a part at a time is in memory.

    Attributes
    ----------
    name
        The file or folder, for messages.
    frequency_mhz, width_mhz
        Centres (rising) and widths of the channels, shape (freq,), MHz.
    station, antenna, dipole
        Which path each column of the power is, shape (path,).
    read
        Yields the integrations in order of time.
    notes
        What a user must know about the data, one sentence each.
    arms_deg
        Azimuths of the arms by dipole, north through east, deg, where the data say so.
    """

    name: str
    frequency_mhz: Floats
    width_mhz: Floats
    station: NDArray[np.str_]
    antenna: NDArray[np.int64]
    dipole: NDArray[np.str_]
    read: Callable[[], Iterator[Integrations]]
    notes: tuple[str, ...] = ()
    arms_deg: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require_channels(self.name, self.frequency_mhz)
        if self.antenna.size == 0:
            raise BadInputError(self.name, "at least one path (antenna and dipole)", "none")
        bad = np.flatnonzero(~are_dipole_names(self.dipole))
        if bad.size:
            raise BadInputError(f"{self.name}: dipole of path {bad[0]}", EXPECTED, repr(str(self.dipole[bad[0]])))
        paths = list(zip(self.station.tolist(), self.antenna.tolist(), self.dipole.tolist(), strict=True))
        twice = [path for path, count in Counter(paths).items() if count > 1]
        if twice:
            raise BadInputError(self.name, "each path once", f"{twice[0][0]} antenna {twice[0][1]} {twice[0][2]} twice")


# Integrations of any length and channels of any width to background spectra: averages over time and over frequency.
#
# The mean of an interval weighs every integration with its length and every channel with its width; what is flagged
# counts nowhere. An integration that is flagged as a whole counts only where its interval has no other: then the
# average bears its flag. In memory are the averages and one block of integrations, whatever the length of the source.

WHOLE_SHARE = 0.5
"""An averaged channel must have recorded this share of what the best channel of its spectrum recorded."""
EDGE_MHZ = 1e-9
"""A channel on the edge of two averages belongs to the upper one, whatever rounding does."""
COMMON_SHARE = 0.5
"""Channels that fewer spectra have than this are left out."""
FILLED_SHARE, FILLED_CHANNELS, FEWEST_COMPLETE = 0.2, 0.1, 4
"""A spectrum that lacks some of the others is filled where at most so many of the path's spectra lack each of these,
it lacks at most so many of its channels, and the path has so many complete spectra; else it is left out. The fit takes
what was filled for measured: its error of C in such a channel is too small by at most 1 - 0.8^0.5, 11 %."""


@dataclass(frozen=True)
class Channels:
    """The channels to average to: centres and widths, shape (freq,), MHz."""

    frequency_mhz: Floats
    width_mhz: Floats


@dataclass(frozen=True)
class Averaged:
    """Spectra, and what was left out on the way to them.

    Attributes
    ----------
    channels_left_out
        Centres of the channels that most spectra lack, MHz.
    spectra_left_out
        How many spectra lacked one of the other channels.
    flags
        How many spectra bear each flag.
    integrations
        How many integrations were read.
    spectra_filled
        How many spectra lacked a few channels, which the path's other spectra filled.
    events
        How many events have a name of their own; the others are intervals.
    negatives
        How many values of the power are below 0: they count nowhere.
    paths_left_out
        Names of the paths that have no spectrum.
    """

    spectra: Spectra
    channels_left_out: Floats
    spectra_left_out: int
    integrations: int
    flags: Mapping[str, int]
    spectra_filled: int = 0
    events: int = 0
    negatives: int = 0
    paths_left_out: tuple[str, ...] = ()


def average(
    source: Source,
    interval_s: float | None,
    channels: Channels | None = None,
    say: Callable[[int], None] = lambda _: None,
    *,
    is_merging_events: bool = True,
) -> Averaged:
    """Average a source to background spectra.

    Parameters
    ----------
    interval_s
        Length of the intervals, s; they begin with the first integration. None: every integration is an event of its
        own, with its name where it has one; integrations of one name are one event.
    channels
        What to average to; without it the channels of the source.
    say
        Is called with the number of integrations read so far.
    is_merging_events
        Whether integrations that have names are averaged over the intervals too.

    Returns
    -------
    Spectra whose `event_id` is the UTC second in which an interval begins, whose `time_unix` is the mean of what was
    averaged, and whose covariate `flagged_fraction` is the share of samples that were flagged; other covariates are
    means over the interval.
    """
    channels = channels or Channels(source.frequency_mhz, source.width_mhz)
    sums = _Sums(source, interval_s, channels, is_merging_events and interval_s is not None)
    for block in source.read():
        sums.add(block)
        say(sums.integrations)
    if sums.integrations == 0:
        raise BadInputError(source.name, "at least one integration", "none")
    return sums.finish()


@dataclass
class _Sum:
    """What one interval holds: sums over its integrations.

    Attributes
    ----------
    power, weight
        Shape (path, channel).
    clock
        Sums of length, of length x time since the beginning, and of flagged length.
    covariates
        By name: the sums of value x length, and of the length in which it is known.
    """

    power: Floats
    weight: Floats
    clock: Floats
    covariates: dict[str, Floats]

    def add(self, other: _Sum) -> None:
        self.power += other.power
        self.weight += other.weight
        self.clock += other.clock
        for name, values in other.covariates.items():
            self.covariates[name] = self.covariates.get(name, np.zeros(2)) + values


class _Sums:
    """The sums of every interval, what is flagged as a whole by itself."""

    def __init__(self, source: Source, interval_s: float | None, channels: Channels, is_merging_events: bool) -> None:
        self.source, self.interval_s, self.channels = source, interval_s, channels
        self.is_merging_events = is_merging_events
        self.members, self.edges = _find_members(source, channels)
        self.begin: float | None = None
        self.integrations = 0
        self.negatives = 0
        self.sums: dict[tuple[str, int, str], _Sum] = {}
        """By name of the event, or by the number of its interval where it has none, and by flag."""

    def add(self, block: Integrations) -> None:
        count = block.time_unix.size
        if count == 0:
            return
        instants = block.time_unix.astype("datetime64[s]").astype(np.str_)
        require_possible(self.source.name, block.environment, instants)  # before a mean hides it
        if self.begin is None:
            self.begin = float(block.time_unix[0] - block.duration_s[0] / 2)
        since = block.time_unix - self.begin
        if self.interval_s is None:
            interval = self.integrations + np.arange(count)
        else:
            interval = np.floor(since / self.interval_s).astype(np.int64)
        power = block.power[:, :, self.members].astype(float)
        self.negatives += int(np.sum(power < 0))
        is_good = np.isfinite(power) & (power > 0)
        width = self.source.width_mhz[self.members]
        power *= width
        power[~is_good] = 0.0
        share = is_good * width
        inside = np.add.reduceat(power, self.edges, axis=-1)
        recorded = np.add.reduceat(share, self.edges, axis=-1)
        flagged = 1.0 - recorded.sum(axis=(1, 2)) / (width.sum() * power.shape[1])
        flags = np.full(count, "") if block.flag is None else block.flag
        names = np.full(count, "") if block.event_id is None or self.is_merging_events else block.event_id
        interval = np.where(names == "", interval, 0)
        for name, k, flag in dict.fromkeys(zip(names.tolist(), interval.tolist(), flags.tolist(), strict=True)):
            rows = np.flatnonzero((names == name) & (interval == k) & (flags == flag))
            length = block.duration_s[rows]
            found = _Sum(
                np.tensordot(length, inside[rows], axes=1),
                np.tensordot(length, recorded[rows], axes=1),
                np.array([length.sum(), length @ since[rows], length @ flagged[rows]]),
                {name: _sum_known(values[rows], length) for name, values in block.environment.items()},
            )
            if (name, k, flag) in self.sums:
                self.sums[name, k, flag].add(found)
            else:
                self.sums[name, k, flag] = found
        self.integrations += count

    def _chosen(self) -> list[tuple[str, int, str]]:
        """One sum an event or interval, in order of time: what is not flagged, else the first flag in the alphabet."""
        chosen: dict[tuple[str, int], str] = {}
        for name, interval, flag in sorted(self.sums):
            chosen.setdefault((name, interval), flag)
        keys = [(*key, flag) for key, flag in chosen.items()]
        return sorted(keys, key=lambda key: self.sums[key].clock[1] / self.sums[key].clock[0])

    def finish(self) -> Averaged:
        keys = self._chosen()
        sums = [self.sums[key] for key in keys]
        weight = np.array([one.weight for one in sums])
        power = np.array([one.power for one in sums]) / np.where(weight > 0, weight, 1.0)
        share = weight / self.channels.width_mhz
        best = share.max(axis=-1, keepdims=True)
        is_whole = (share > 0) & (share >= WHOLE_SHARE * best)
        is_recorded = is_whole.any(axis=-1)
        if not is_recorded.any():
            found = f"{self.negatives} values below 0 (decibels?)" if self.negatives else "everything flagged"
            raise BadInputError(self.source.name, "power on a linear scale, > 0 where it is not flagged", found)
        is_kept = is_whole[is_recorded].mean(axis=0) >= COMMON_SHARE
        power, is_whole = power[..., is_kept], is_whole[..., is_kept]
        is_filled = _fill(power, is_whole, np.log(self.channels.frequency_mhz[is_kept]))
        is_usable = is_whole.all(axis=-1) | is_filled
        at, path = np.nonzero(is_usable)
        if at.size == 0:
            raise BadInputError(self.source.name, "spectra that have all their channels", "none")
        lengths, moments, flagged = np.array([one.clock for one in sums]).T
        duration_s = best[at, path, 0]
        begin = float(self.begin or 0.0)
        time_unix = begin + moments / lengths
        begins = time_unix if self.interval_s is None else begin + self.interval_s * np.array([k for _, k, _ in keys])
        names = [name or name_event(float(t)) for (name, *_), t in zip(keys, begins, strict=True)]
        flags = np.array([flag for *_, flag in keys])[at]
        covariates = dict[str, Floats]()
        for name in sorted({name for one in self.sums.values() for name in one.covariates}):
            total, known = np.array([one.covariates.get(name, np.zeros(2)) for one in sums]).T
            covariates[name] = np.divide(total, known, out=np.full(len(sums), np.nan), where=known > 0)[at]
        spectra = Spectra(
            frequency_mhz=self.channels.frequency_mhz[is_kept],
            power=power[at, path],
            event_id=np.array(names)[at],
            time_unix=time_unix[at],
            station=self.source.station[path],
            antenna=self.source.antenna[path],
            dipole=self.source.dipole[path],
            blocks=np.maximum(1, np.rint(duration_s / BLOCK_S)).astype(np.int64),
            environment=covariates | {"flagged_fraction": (flagged / lengths)[at]},
            origin=self.source.name,
            width_mhz=self.channels.width_mhz[is_kept],
            duration_s=duration_s,
            flag=flags if np.any(flags != "") else None,
            arms_deg=self.source.arms_deg,
        )
        left_out = self.channels.frequency_mhz[~is_kept]
        counts = {str(flag): int(np.sum(flags == flag)) for flag in np.unique(flags[flags != ""])}
        events = len({name for name, *_ in keys if name})
        lost = int(is_recorded.sum() - is_usable.sum())
        own = zip(self.source.station.tolist(), self.source.antenna.tolist(), self.source.dipole.tolist(), strict=True)
        without = tuple(name_path(*one) for one, has in zip(own, is_usable.any(axis=0), strict=True) if not has)
        filled = int(is_filled.sum())
        return Averaged(spectra, left_out, lost, self.integrations, counts, filled, events, self.negatives, without)


def _fill(power: Floats, is_whole: NDArray[np.bool_], place: Floats) -> NDArray[np.bool_]:
    """Fill the few channels that some spectra lack, in place.

    A channel over its neighbours, interpolated in logarithms, is what it is in the median of the path's complete
    spectra: sky and chain differ little along frequency from event to event, so that the event keeps its level.

    Parameters
    ----------
    power, is_whole
        Shape (interval, path, channel): the power, and whether it was recorded.
    place
        ln of the frequency, shape (channel,).

    Returns
    -------
    Which spectra were filled, shape (interval, path).
    """
    recorded = np.maximum(is_whole.any(axis=-1).sum(axis=0), 1)
    is_often = is_whole.sum(axis=0) >= (1.0 - FILLED_SHARE) * recorded[:, None]
    lacks = ~is_whole
    is_filled = is_whole.any(axis=-1) & lacks.any(axis=-1) & (lacks.mean(axis=-1) <= FILLED_CHANNELS)
    is_filled &= np.all(is_whole | is_often, axis=-1) & (is_whole.all(axis=-1).sum(axis=0) >= FEWEST_COMPLETE)
    for path in np.flatnonzero(is_filled.any(axis=0)):
        complete = power[is_whole[:, path].all(axis=-1), path]
        rows = np.flatnonzero(is_filled[:, path])
        patterns, which = np.unique(lacks[rows, path], axis=0, return_inverse=True)
        for number, pattern in enumerate(patterns):
            good, missing = np.flatnonzero(~pattern), np.flatnonzero(pattern)
            upper = np.clip(np.searchsorted(good, missing), 1, good.size - 1)
            low, high = good[upper - 1], good[upper]
            share = np.clip((place[missing] - place[low]) / (place[high] - place[low]), 0.0, 1.0)
            beside = np.median(np.log(complete[:, missing]) - _between(complete, low, high, share), axis=0)
            at = rows[np.ravel(which) == number]
            power[at[:, None], path, missing] = np.exp(_between(power[at, path], low, high, share) + beside)
    return np.asarray(is_filled)


def _between(power: Floats, low: NDArray[np.int64], high: NDArray[np.int64], share: Floats) -> Floats:
    """The logarithm of the power between two channels each, so far on the way from the lower to the upper one."""
    return np.asarray((1.0 - share) * np.log(power[:, low]) + share * np.log(power[:, high]))


def _sum_known(values: Floats, length: Floats) -> Floats:
    is_known = np.isfinite(values)
    return np.array([values[is_known] @ length[is_known], length[is_known].sum()])


def _find_members(source: Source, channels: Channels) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which channels of a source belong to each wanted one, one after the other, and where each wanted one begins."""
    centre = source.frequency_mhz
    begin = np.searchsorted(centre, channels.frequency_mhz - channels.width_mhz / 2 - EDGE_MHZ)
    end = np.searchsorted(centre, channels.frequency_mhz + channels.width_mhz / 2 - EDGE_MHZ)
    empty = np.flatnonzero(end <= begin)
    if empty.size:
        raise BadInputError(
            f"{source.name}: channels",
            f"some within {channels.width_mhz[empty[0]] / 2:g} MHz of {channels.frequency_mhz[empty[0]]:g} MHz",
            f"{centre.size} channels from {centre[0]:g} to {centre[-1]:g} MHz",
        )
    members = np.concatenate([np.arange(low, high) for low, high in zip(begin, end, strict=True)])
    return members, np.append(0, np.cumsum(end - begin)[:-1])
