"""A station's spectra laid out as (path, event, freq), and the conditions of the events."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lbacal_core.calibration.paths import Cables, require_one_cable_each
from lbacal_core.calibration.singles import MIN_EVENTS
from lbacal_core.causes.axes import harmonics, list_axes
from lbacal_core.causes.cause import Conditions
from lbacal_core.causes.sky import SkyRatio, sky_ratios
from lbacal_core.data.tables import read_prior
from lbacal_core.errors import BadInputError
from lbacal_core.grids import DAY_S, Floats
from lbacal_core.instrument.sidereal import local_sidereal_time, sun_position
from lbacal_core.linear import pseudo_invert, solve_symmetric
from lbacal_core.provenance import Remembered
from lbacal_core.simulation.simulation import Simulation
from lbacal_core.sky.differences import ModelDifferences, Waves, waves_at
from lbacal_core.sky.sources import response_towards
from lbacal_core.sky.table import SkyPower, read_at
from lbacal_core.spectra.blocks import SpectraBlock, split_into_blocks
from lbacal_core.spectra.screening import find_dead, leave_out
from lbacal_core.spectra.spectra import Spectra

STRUCTURE_SHARE, SMALLEST_PROFILE = 1 / 3, 1e-6
"""Most profiles in time that are no noise, as a share of the events; and the size of one that others contain."""

SMALLEST_STEP = 0.5
"""Prior of the numbers of a step: events in which it may differ from what varies smoothly, which say nothing of it."""


@dataclass(frozen=True)
class Station:
    """The spectra of one station on a (path, event, freq) grid, and the conditions of the events.

    Paths of one polarisation and cable name form a class with common templates.

    Attributes
    ----------
    name
        Name of the station.
    antenna, dipole
        Antenna number and dipole of each path, shape (path,).
    class_of
        Class of each path, shape (path,).
    group
        Name of the hardware that each path shares with others, empty where none is on record, shape (path,).
    power
        Shape (path, event, freq), ADC^2/Ohm/MHz; 1 where absent.
    relative_variance
        Variance of the radiometer noise over that of the typical spectrum, shape (path, event); infinite where absent.
    sky
        P_sky of each class, shape (class, event, freq).
    apart
        Numbers of antennas that are no measure of others, as what they do has no name: the means are without them.
    """

    name: str
    antenna: NDArray[np.int64]
    dipole: NDArray[np.str_]
    class_of: NDArray[np.int64]
    group: NDArray[np.str_]
    power: Floats
    relative_variance: Floats
    event_id: NDArray[np.str_]
    sky: Floats
    conditions: Conditions
    apart: frozenset[int] = frozenset()

    @property
    def is_present(self) -> NDArray[np.bool_]:
        """Whether a spectrum exists, shape (path, event)."""
        return np.isfinite(self.relative_variance)

    @property
    def is_used(self) -> NDArray[np.bool_]:
        """Whether any path has a spectrum of an event, shape (event,)."""
        return np.asarray(self.is_present.any(axis=0))

    @cached_property
    def profiles_of_axes(self) -> Floats:
        """Orthonormal profiles in time of what varies smoothly along any axis of the data, shape (event, profile).

        What follows an axis is structure, which causes may explain, and no noise: noise would swallow it. Axes are
        taken in their order while the profiles are few beside the events.
        """
        events = self.power.shape[1]
        profiles: list[Floats] = [np.ones((1, events))]
        for axis in list_axes(self.conditions):
            basis = axis.basis(self.conditions)
            if basis is not None and sum(map(len, profiles)) + len(basis) <= STRUCTURE_SHARE * events:
                profiles.append(basis)
        found, sizes, _ = np.linalg.svd(np.concatenate(profiles).T, full_matrices=False)
        return np.asarray(found[:, sizes > SMALLEST_PROFILE * sizes[0]])

    def find_step(self, amount: Floats, known: Floats) -> tuple[float, Floats]:
        """The step that fits amounts best: at a date, an hour, a height of the Sun or a time of the week.

        Power that is added varies along LST, relative to that of the sky: a step is a level and two harmonics.

        Parameters
        ----------
        amount
            Shape (event,), without what varies smoothly along any axis and without `known`.
        known
            Orthonormal profiles of the steps before, shape (profile, event).

        Returns
        -------
        Its gain in chi^2 at a noise of 1, and its orthonormal profiles beside what varies smoothly, (profile, event).
        """
        conditions, smooth = self.conditions, np.concatenate([self.profiles_of_axes, known.T], axis=1)
        functions = np.stack([np.ones_like(amount), *harmonics(conditions.lst_hours / 24.0, 2)], axis=1)
        found = 0.0, functions[:, :0].T
        week = conditions.time_unix % (7.0 * DAY_S)
        for axis in (conditions.time_unix, conditions.utc_hours, conditions.sun_altitude, week):
            if not np.all(np.isfinite(axis)):
                continue
            order = np.argsort(-axis, kind="stable")
            own = functions[order]
            score = np.cumsum(own * amount[order, None], axis=0)
            shared = np.cumsum(own[:, :, None] * smooth[order, None], axis=0)
            product = np.cumsum(own[:, :, None] * own[:, None], axis=0) - shared @ np.swapaxes(shared, 1, 2)
            size = solve_symmetric(product + SMALLEST_STEP * np.eye(own.shape[1]), score[..., None])[..., 0]
            gain = np.sum(score * size, axis=1)
            best = int(np.argmax(gain))
            if gain[best] > found[0]:
                since = functions * (axis >= axis[order[best]])[:, None]
                profiles, _, _ = np.linalg.svd(since - smooth @ (smooth.T @ since), full_matrices=False)
                found = float(gain[best]), profiles.T
        return found

    def without_axes(self, values: Floats, is_ordinary: NDArray[np.bool_]) -> Floats:
        """Values, shape (..., event, any), less what follows these profiles in the ordinary events, shape (event,).

        A burst in one event would otherwise leave a part of itself in all that its profiles join with it.
        """
        profiles = self.profiles_of_axes
        onto = self._inverses.get(is_ordinary.tobytes(), lambda: pseudo_invert(profiles[is_ordinary]))
        return np.asarray(values - profiles @ (onto @ values[..., is_ordinary, :]))

    @cached_property
    def _inverses(self) -> Remembered[bytes, Floats]:
        """Inverses of the profiles in the ordinary events, which hardly change from round to round of a fit."""
        return Remembered(4)

    def on_events(self, is_known: NDArray[np.bool_]) -> Station:
        """The station without the spectra of other events; the grid stays."""
        if np.all(is_known):
            return self
        return replace(self, relative_variance=np.where(is_known, self.relative_variance, np.inf))

    def find_places(self, spectra: Spectra) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Rows of spectra that stand on the grid, with path and event of each, shape (row,)."""
        path, here = np.full(len(spectra), -1), spectra.station == self.name
        for k, (antenna, dipole) in enumerate(zip(self.antenna, self.dipole, strict=True)):
            path[here & (spectra.antenna == antenna) & (spectra.dipole == dipole)] = k
        rows, order = np.flatnonzero(path >= 0), np.argsort(self.event_id)
        return rows, path[rows], order[np.searchsorted(self.event_id[order], spectra.event_id[rows])]


def gather_stations(
    spectra: Spectra, simulation: Simulation, ratios: Mapping[str, SkyRatio] | None = None
) -> list[Station]:
    """Lay out the spectra of each station, without those that are dead: what they lack follows no course.

    Parameters
    ----------
    ratios
        `sky_ratios` of the instrument, where they are at hand.

    Raises
    ------
    BadInputError
        Where a station has too few events, or where an antenna changes its cable within the data.
    """
    cable_of = require_one_cable_each(spectra, simulation.instrument)
    blocks = [leave_out(one, find_dead(one)) for one in split_into_blocks(spectra)]
    of_array = sky_ratios(simulation.instrument) if ratios is None else ratios
    typical = float(np.median(spectra.blocks))

    def gather(name: str) -> Station:
        own = simulation.at_station(name)
        of_place = (
            of_array
            if own.instrument.latitude_deg == simulation.instrument.latitude_deg
            else sky_ratios(own.instrument)
        )
        of_station = [block for block in blocks if block.station == name]
        return _gather(of_station, own, cable_of, typical, of_place)

    return [gather(str(name)) for name in np.unique(spectra.station)]


def _gather(
    blocks: Sequence[SpectraBlock],
    simulation: Simulation,
    cable_of: Cables,
    typical_blocks: float,
    ratios: Mapping[str, SkyRatio],
) -> Station:
    name = blocks[0].station
    times: dict[str, float] = {}
    for block in blocks:
        times.update(zip(block.event_id.tolist(), block.time_unix.tolist(), strict=True))
    events = np.array(sorted(times, key=lambda event: (times[event], event)))
    time_unix = np.array([times[event] for event in events.tolist()])
    place = {event: k for k, event in enumerate(events.tolist())}
    paths = sum(block.antennas.size for block in blocks)
    power = np.ones((paths, events.size, simulation.instrument.frequency_mhz.size))
    variance = np.full((paths, events.size), np.inf)
    antenna, dipole, cable = [], [], []
    row = 0
    covariates: dict[str, Floats] = {}
    for block in blocks:
        at = np.array([place[event] for event in block.event_id.tolist()])
        rows = slice(row, row + block.antennas.size)
        power[rows, at] = block.power
        with np.errstate(divide="ignore"):
            variance[rows, at] = typical_blocks / block.blocks
        antenna += block.antennas.tolist()
        dipole += [block.dipole] * block.antennas.size
        cable += [cable_of[name, int(a)] for a in block.antennas]
        for key, values in block.environment.items():
            covariates.setdefault(key, np.full(events.size, np.nan))[at] = values
        row = rows.stop
    has_enough = np.isfinite(variance).sum(axis=1) >= MIN_EVENTS
    if not np.any(has_enough):
        most = int(np.isfinite(variance).sum(axis=1).max())
        raise BadInputError(f"station {name}", f"{MIN_EVENTS} events or more of a path", f"{most}; ingest more")
    kept = np.flatnonzero(has_enough)
    labels = [(dipole[k], cable[k]) for k in kept]
    classes = sorted(set(labels))
    span = float(time_unix.min()), float(time_unix.max())
    groups = {number: simulation.instrument.group_between(name, number, *span) or "" for number in set(antenna)}
    conditions = _conditions(classes, simulation, time_unix, covariates, ratios)
    return Station(
        name=name,
        antenna=np.array(antenna)[kept],
        dipole=np.array(dipole)[kept],
        class_of=np.array([classes.index(label) for label in labels]),
        group=np.array([groups[antenna[k]] for k in kept], dtype=str),
        power=power[kept],
        relative_variance=variance[kept],
        event_id=events,
        sky=np.stack([simulation.sky_power.at(letter, conditions.lst_hours) for letter, _ in classes]),
        conditions=conditions,
    )


def _conditions(
    classes: Sequence[tuple[str, str]],
    simulation: Simulation,
    time_unix: Floats,
    covariates: Mapping[str, Floats],
    ratios: Mapping[str, SkyRatio],
) -> Conditions:
    lst = local_sidereal_time(time_unix, simulation.instrument.longitude_deg)
    altitude, azimuth = sun_position(time_unix, simulation.instrument.latitude_deg, simulation.instrument.longitude_deg)
    letters = [letter for letter, _ in classes]

    def at(table: SkyPower, hours: Floats) -> Floats:
        of_dipole = {letter: table.at(letter, hours) for letter in set(letters)}
        return np.stack([of_dipole[letter] for letter in letters])

    sun_response = None
    if ratios:
        towards = {
            letter: response_towards(simulation.instrument, letter, np.pi / 2 - altitude, azimuth)
            for letter in set(letters)
        }
        sun_response = np.stack([towards[letter] for letter in letters])
    return Conditions(
        frequency_mhz=simulation.instrument.frequency_mhz,
        time_unix=time_unix,
        lst_hours=lst,
        utc_hours=(time_unix / 3600.0) % 24.0,
        sun_altitude=altitude,
        sun_azimuth=azimuth,
        dipoles=letters,
        cables=[cable for _, cable in classes],
        mean_sky=np.stack([simulation.sky_power.power[letter].mean(axis=0) for letter in letters]),
        sky_of={letter: simulation.sky_power.at(letter, lst) for letter in simulation.instrument.dipoles},
        sky_at=lambda hours: at(simulation.sky_power, hours),
        antenna_gain=simulation.instrument.antenna_gain,
        receiver_gain=simulation.instrument.receiver_gain,
        noise=simulation.noise,
        cable_log_loss=np.stack([np.log(simulation.instrument.cables[cable]) for _, cable in classes]),
        covariates=covariates,
        sky_ratio={name: ratio.at(letters, lst) for name, ratio in ratios.items()},
        sun_response=sun_response,
    )


@dataclass(frozen=True)
class SkyModes:
    """Relative changes of P_sky that are free, one standard deviation of their prior each.

    Attributes
    ----------
    common, own
        Differences between models, shape (mode, class, event, freq): those that both polarisations share, the level at
        each frequency, an isotropic brightness and what surveys of other frequencies have of the contrast; and those of
        each polarisation by itself, the shape along LST.
    waves
        Smooth waves along LST that no model need have, in both polarisations together and in each by itself.
    prior
        Inverse variance of the amounts of the differences between models; 0 leaves them free without limit.
    """

    common: Floats
    own: Floats
    waves: tuple[Waves, Waves] | None
    prior: float = 1.0


def model_modes(station: Station, differences: ModelDifferences) -> SkyModes:
    """What of the sky is free at the events of a station."""
    conditions = station.conditions
    lst, dipoles = conditions.lst_hours, conditions.dipoles
    # Brightness that does not depend on direction has a spectrum that nobody knows.
    brighter = np.stack([read_at(differences.isotropic[letter], lst) for letter in dipoles])
    isotropic = brighter * differences.smooth_spectra()[:, None, None]
    level = differences.level_modes()[:, None, None]
    # Published skies have edges at the frequencies of their surveys, which are no lines of interference.
    survey, log_sky = read_prior()["survey_contrast"], np.log(station.sky)
    edges = [np.interp(conditions.frequency_mhz, survey.at_mhz, own, 0.0, 0.0) for own in np.diag(survey.sizes)]
    contrast = (log_sky - log_sky.mean(axis=1, keepdims=True)) * np.stack(edges)[:, None, None]
    return SkyModes(
        common=np.concatenate([np.broadcast_to(level, (len(level), *brighter.shape)), isotropic, contrast]),
        own=_stack_modes([differences.changes_at(letter, lst) for letter in dipoles]),
        waves=waves_at(conditions.frequency_mhz, lst, is_search=True),
    )


def _stack_modes(modes: Sequence[Floats]) -> Floats:
    """Modes of each class side by side, shape (mode, class, event, freq); 0 where a class has fewer than others."""
    stacked = np.zeros((max(map(len, modes)), len(modes), *modes[0].shape[1:]))
    for c, own in enumerate(modes):
        stacked[: len(own), c] = own
    return stacked
