"""The baseline of one station: every path's chain fitted, and what the events and classes of paths look like to causes.

All that is static and belongs to one path (its A(nu), its gain in front of or behind N_RCU, its noise levels) is fitted
freely; a cause is claimed on top of it. Paths of the same dipole letter and cable form a class with common signatures.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.calibration.fit import MIN_EVENTS
from lbacal_core.calibration.lines import fit_lines
from lbacal_core.calibration.separable import SeparableSolution, solve_separable
from lbacal_core.causes.terms import ChainTerms, Conditions
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument
from lbacal_core.sidereal import local_sidereal_time
from lbacal_core.sky.sources import SOURCES
from lbacal_core.skypower.differences import model_difference_modes
from lbacal_core.skypower.model import compute_sky_power
from lbacal_core.skypower.sources import response_towards, source_sky_power
from lbacal_core.skypower.table import SkyPower
from lbacal_core.skypower.variation import vary_sky_power
from lbacal_core.spectra import Spectra
from lbacal_core.spectra_blocks import SpectraBlock, split_into_blocks
from lbacal_core.sun import sun_position

SOURCE_KEYS = {"Cas A": "cas-a", "Cyg A": "cyg-a", "Tau A": "tau-a", "Vir A": "vir-a"}


@dataclass(frozen=True)
class StationData:
    """The spectra of one station on a (path, event, freq) grid, and the conditions of the events.

    Attributes
    ----------
    antenna, dipole
        Of each path, shape (path,).
    class_of
        Class of each path, shape (path,).
    power
        Shape (path, event, freq), ADC^2/Ohm/MHz.
    excess
        Variance of the radiometer noise over that of the typical spectrum, shape (path, event); infinite where absent.
    sky
        P_sky of each class, shape (class, event, freq).
    """

    station: str
    antenna: NDArray[np.int64]
    dipole: NDArray[np.str_]
    class_of: NDArray[np.int64]
    power: Floats
    excess: Floats
    event_id: NDArray[np.str_]
    sky: Floats
    conditions: Conditions

    @property
    def is_present(self) -> NDArray[np.bool_]:
        """Whether a spectrum exists, shape (path, event)."""
        return np.isfinite(self.excess)


@dataclass(frozen=True)
class Baseline:
    """The fitted chain of every path.

    Attributes
    ----------
    residual
        Relative deviation of the spectra from the model, shape (path, event, freq); 0 where absent.
    terms
        The chain of the mean path of each class.
    solution
        Slopes s and noise constants of every path with their covariance.
    """

    residual: Floats
    terms: ChainTerms
    solution: SeparableSolution


def gather_stations(spectra: Spectra, instrument: Instrument, sky_power: SkyPower) -> list[StationData]:
    """Lay the spectra of each station out; stations with too few events are refused with their count."""
    blocks = split_into_blocks(spectra)
    changes = relative_sky_changes(instrument)
    stations = []
    for name in np.unique(spectra.station):
        members = [block for block in blocks if block.station == name]
        stations.append(_gather(str(name), members, instrument, sky_power, float(np.median(spectra.blocks)), changes))
    return stations


def _gather(
    name: str,
    blocks: list[SpectraBlock],
    instrument: Instrument,
    sky_power: SkyPower,
    typical_blocks: float,
    changes: Mapping[str, SkyPower],
) -> StationData:
    times: dict[str, float] = {}
    for block in blocks:
        times.update(zip(block.event_id.tolist(), block.time_unix.tolist(), strict=True))
    events = np.array(sorted(times, key=lambda event: (times[event], event)))
    time_unix = np.array([times[event] for event in events.tolist()])
    place = {event: k for k, event in enumerate(events.tolist())}
    paths = sum(block.antennas.size for block in blocks)
    power = np.ones((paths, events.size, instrument.frequency_mhz.size))
    excess = np.full((paths, events.size), np.inf)
    antenna, dipole, cable = [], [], []
    row = 0
    environment: dict[str, Floats] = {}
    for block in blocks:
        at = np.array([place[event] for event in block.event_id.tolist()])
        rows = slice(row, row + block.antennas.size)
        power[rows, at] = block.power
        with np.errstate(divide="ignore"):
            excess[rows, at] = typical_blocks / block.blocks
        antenna += block.antennas.tolist()
        dipole += [block.dipole] * block.antennas.size
        cable += [instrument.cable_of(name, int(a), float(time_unix.mean())) for a in block.antennas]
        for key, values in block.environment.items():
            environment.setdefault(key, np.full(events.size, np.nan))[at] = values
        row = rows.stop
    has_enough = np.isfinite(excess).sum(axis=1) >= MIN_EVENTS
    if not np.any(has_enough):
        most = int(np.isfinite(excess).sum(axis=1).max())
        raise BadInputError(f"station {name}", f"{MIN_EVENTS} events or more of a path", f"{most}; ingest more")
    kept = np.flatnonzero(has_enough)
    labels = [(dipole[k], cable[k]) for k in kept]
    classes = sorted(set(labels))
    conditions = _conditions(classes, instrument, sky_power, time_unix, environment, changes)
    return StationData(
        station=name,
        antenna=np.array(antenna)[kept],
        dipole=np.array(dipole)[kept],
        class_of=np.array([classes.index(label) for label in labels]),
        power=power[kept],
        excess=excess[kept],
        event_id=events,
        sky=np.stack([sky_power.at(letter, conditions.lst_hours) for letter, _ in classes]),
        conditions=conditions,
    )


def _conditions(
    classes: list[tuple[str, str]],
    instrument: Instrument,
    sky_power: SkyPower,
    time_unix: Floats,
    environment: Mapping[str, Floats],
    changes: Mapping[str, SkyPower],
) -> Conditions:
    lst = local_sidereal_time(time_unix, instrument.longitude_deg)
    altitude, azimuth = sun_position(time_unix, instrument.latitude_deg, instrument.longitude_deg)
    letters = [letter for letter, _ in classes]
    other = {"X": "Y", "Y": "X"}

    def at(key: SkyPower, hours: Floats) -> Floats:
        return np.stack([key.at(letter, hours) for letter in letters])

    sun_response = None
    if changes:
        towards = {
            letter: response_towards(instrument, letter, np.pi / 2 - altitude, azimuth) for letter in set(letters)
        }
        sun_response = np.stack([towards[letter] for letter in letters])
    return Conditions(
        frequency_mhz=instrument.frequency_mhz,
        time_unix=time_unix,
        lst_hours=lst,
        utc_hours=(time_unix / 3600.0) % 24.0,
        sun_altitude=altitude,
        sun_azimuth=azimuth,
        temperature_c=environment.get("temperature_c"),
        rain_mm_h=environment.get("rain_mm_h"),
        dipoles=letters,
        cables=[cable for _, cable in classes],
        mean_sky=np.stack([sky_power.power[letter].mean(axis=0) for letter in letters]),
        other_sky=np.stack([sky_power.at(other[letter], lst) for letter in letters]),
        sky_at=lambda hours: at(sky_power, hours),
        antenna_gain=instrument.antenna_gain,
        receiver_gain=instrument.receiver_gain,
        cable_log_loss=np.stack([np.log(instrument.cables[cable]) for _, cable in classes]),
        sky_change={name: np.log(at(change, lst)) for name, change in changes.items()},
        sun_response=sun_response,
    )


def relative_sky_changes(instrument: Instrument) -> dict[str, SkyPower]:
    """exp(d ln P_sky per unit) of causes that need directions, from the package's own sky and antenna.

    Empty where the own models do not cover the instrument's channels.
    """
    try:
        own = compute_sky_power(instrument)
    except BadInputError:
        return {}

    def change(upper: SkyPower, lower: SkyPower, span: float) -> SkyPower:
        values = {d: np.exp(np.log(upper.power[d] / lower.power[d]) / span) for d in own.power}
        return SkyPower(own.frequency_mhz, own.lst_hours, values, "relative change")

    changes = {
        "dipole_azimuth": change(
            vary_sky_power(instrument, azimuth_deg=1.0), vary_sky_power(instrument, azimuth_deg=-1.0), 2.0
        ),
        "zenith_weighting": change(
            vary_sky_power(instrument, zenith_exponent=0.1), vary_sky_power(instrument, zenith_exponent=-0.1), 0.2
        ),
        "pattern_width": change(
            vary_sky_power(instrument, zenith_gain_fraction=0.05),
            vary_sky_power(instrument, zenith_gain_fraction=-0.05),
            0.1,
        ),
    }
    for name, key in SOURCE_KEYS.items():
        share = {d: source_sky_power(instrument, SOURCES[key], d, own.lst_hours) / own.power[d] for d in own.power}
        values = {d: np.exp(relative) for d, relative in share.items()}
        changes[name] = SkyPower(own.frequency_mhz, own.lst_hours, values, f"{name} through D")
    return changes


def fit_baseline(data: StationData, ratio: Floats | None = None) -> Baseline:
    """Fit every path's chain, after dividing the recorded power by what causes already found do to it.

    Parameters
    ----------
    ratio
        Power with the causes over power without, shape (path, event, freq); None where there is none.
    """
    power = data.power if ratio is None else data.power / ratio
    paths, _, channels = power.shape
    conditions = data.conditions
    design = np.stack([conditions.receiver_gain, np.ones(channels)], axis=1)
    slope, intercept = np.empty((paths, channels)), np.empty((paths, channels))
    information = np.empty((paths, 2 * channels, 2 * channels))
    for index in range(len(conditions.dipoles)):
        members = np.flatnonzero(data.class_of == index)
        lines = fit_lines(power[members], data.sky[index], data.excess[members])
        slope[members], intercept[members], information[members] = lines.slope, lines.intercept, lines.information
    solution = solve_separable(slope, intercept, information, design)
    noise = solution.n[:, None] * solution.x + solution.q @ design.T
    residual = np.empty_like(power)
    for index in range(len(conditions.dipoles)):
        members = np.flatnonzero(data.class_of == index)
        model = solution.x[members][:, None, :] * data.sky[index] + noise[members][:, None, :]
        residual[members] = power[members] / model - 1.0
    residual *= data.is_present[:, :, None]
    return Baseline(residual, _mean_terms(data, solution), solution)


def _mean_terms(data: StationData, solution: SeparableSolution) -> ChainTerms:
    """The chain of the mean path of each class: noise constants of the station, slopes of the class."""
    classes = len(data.conditions.dipoles)
    # Where no path of a class is identifiable all of them have to do.
    is_good = np.isfinite(solution.covariance[:, 0, 0])
    of_class = [data.class_of == index for index in range(classes)]
    members = [np.flatnonzero(own & is_good if np.any(own & is_good) else own) for own in of_class]
    is_good |= not np.any(is_good)
    channels = solution.x.shape[1]
    # A level that comes out at zero or below may still be wrong by its error: causes act on at least half of that.
    variance = np.diagonal(solution.covariance[is_good], axis1=1, axis2=2)[:, channels:]
    floor = 0.5 * np.sqrt(np.nan_to_num(np.median(variance, axis=0)))
    levels = np.column_stack([solution.n[is_good], solution.q[is_good]])
    n_lna, *noise = np.maximum(np.median(levels, axis=0), floor)
    slope = np.stack([np.median(solution.x[rows], axis=0) for rows in members])
    return ChainTerms(
        sky=data.sky,
        n_lna=np.array(n_lna),
        front=slope[:, None, :],
        receiver_noise=noise[0] * data.conditions.receiver_gain,
        adc_noise=np.array(noise[1]),
    )


def model_modes(data: StationData, instrument: Instrument) -> Floats:
    """Relative changes of P_sky by which sky and antenna models differ, shape (mode, class, event, freq)."""
    table = model_difference_modes(
        data.conditions.frequency_mhz, data.conditions.lst_hours, instrument.dipole_azimuth_deg
    )
    return np.stack([table[letter] for letter in data.conditions.dipoles], axis=1)
