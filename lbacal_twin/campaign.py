"""A simulated campaign of the Superterp: spectra as an experiment would store them, and the truth behind them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lbacal_core.errors import UnknownNameError
from lbacal_core.grids import Floats, require_same_grid
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.instrument.sidereal import local_sidereal_time
from lbacal_core.sky.table import SkyPower
from lbacal_core.spectra.spectra import Spectra
from lbacal_twin.faults.fault import Fault
from lbacal_twin.gains import BEHIND_EVERYTHING, EventGains, draw_scatter
from lbacal_twin.hardware import Scene, Stages, build_station, path_calibration
from lbacal_twin.nuisances import NONE, Nuisances, add_interference, deafen, depart, lose_spectra, mismatch_antennas
from lbacal_twin.settings import StationTruth, Truth, TwinSettings
from lbacal_twin.view import View
from lbacal_twin.weather import draw_event_times, draw_weather

UNIX_2010 = 1_262_304_000
"""LOFAR names an event by the whole seconds since 2010-01-01 UTC."""


@dataclass(frozen=True)
class Campaign:
    """Spectra, and the truth that whoever analyses them must not see."""

    spectra: Spectra
    truth: Truth


def simulate_campaign(
    settings: TwinSettings,
    instrument: Instrument,
    sky_power: SkyPower,
    rng: np.random.Generator,
    faults: Sequence[Fault] = (),
    nuisances: Nuisances = NONE,
    view: View | None = None,
    gains: EventGains = BEHIND_EVERYTHING,
) -> Campaign:
    """Simulate the spectra of every event, station, antenna and dipole.

    The random numbers of the weather, the hardware and the noise are independent of the faults: the same `rng` with
    and without a fault differs by the fault alone. A `view` made once for the instrument saves the seconds that the
    first fault with a direction takes to build it; `gains` say where the gains of events act.
    """
    drawn, of_losses = draw_stations(settings, instrument, sky_power, rng, nuisances, view)
    blocks, powers = [], []
    for one in drawn:
        power = expected_power(gains.move(one.stages, one.scene, settings, one.of_gains), one.scene, faults)
        if nuisances.interference > 0:
            add_interference(power, nuisances.interference, one.of_gains)
        counts = one.of_noise.integers(settings.fewest_blocks, settings.most_blocks + 1, size=power.shape[:3])
        scatter = draw_scatter(gains.behind(settings), counts, power.shape[3], one.of_noise, nuisances.sky_correlation)
        if one.scene.station in nuisances.noisy_stations:
            scatter = 1.0 + nuisances.noise_factor * (scatter - 1.0)
        power *= scatter
        blocks.append(counts)
        powers.append(power)
    spectra = _gather([one.scene for one in drawn], powers, blocks)
    if nuisances != NONE:
        spectra = lose_spectra(spectra, nuisances, instrument.longitude_deg, of_losses)
    return Campaign(
        spectra,
        Truth(
            settings.as_dict() | {"nuisances": nuisances.as_dict(), "gains": gains.as_dict()},
            instrument.frequency_mhz,
            [one.truth for one in drawn],
            [fault.as_dict() for fault in faults],
            drawn[0].scene.dipoles,
        ),
    )


@dataclass(frozen=True)
class DrawnStation:
    """One station of a campaign before its noise: `expected_power` of it is exact, with any faults or none."""

    scene: Scene
    stages: Stages
    truth: StationTruth
    of_noise: np.random.Generator
    of_gains: np.random.Generator


def draw_stations(
    settings: TwinSettings,
    instrument: Instrument,
    sky_power: SkyPower,
    rng: np.random.Generator,
    nuisances: Nuisances = NONE,
    view: View | None = None,
) -> tuple[list[DrawnStation], np.random.Generator]:
    """Draw events, weather and hardware as `simulate_campaign` does from the same `rng`.

    Returns
    -------
    The stations, and the random numbers that decide which spectra are lost.
    """
    require_same_grid(sky_power.origin, sky_power.frequency_mhz, instrument.frequency_mhz, instrument.name)
    stations = _stations(settings, instrument)
    of_events, *of_stations, of_losses = rng.spawn(2 + len(stations))
    time_unix = draw_event_times(
        settings.start_unix, settings.years, settings.event_count, of_events, nuisances.clustered
    )
    weather = draw_weather(time_unix, instrument.longitude_deg, of_events)
    own_view = view or View.of(instrument)
    drawn = []
    for station, of_station in zip(stations, of_stations, strict=True):
        place = instrument.at_station(station)
        antennas = np.array(sorted({r.antenna for r in instrument.antennas if r.station == station}), dtype=np.int64)
        antennas = antennas[: settings.antennas]
        scene = Scene(
            station=station,
            latitude_deg=place.latitude_deg,
            longitude_deg=place.longitude_deg,
            frequency_mhz=instrument.frequency_mhz,
            antennas=antennas,
            cables=np.array([instrument.cable_of(station, int(a), float(time_unix[0])) for a in antennas]),
            time_unix=time_unix,
            lst_hours=local_sidereal_time(time_unix, place.longitude_deg),
            temperature_c=weather.temperature_at(time_unix),
            rain_mm_h=weather.rain_at(time_unix),
            sky_power=sky_power.of_station(station),
            weather=weather,
            view=own_view,
        )
        of_hardware, of_noise, of_departures, of_gains = of_station.spawn(4)
        stages, truth = build_station(settings, instrument, scene, of_hardware)
        if nuisances.departures > 0:
            stages = depart(stages, nuisances.departures, of_departures)
        if nuisances.mismatch > 0:
            stages = mismatch_antennas(stages, instrument.frequency_mhz, nuisances.mismatch, of_departures)
        if nuisances.deaf_antennas > 0:
            stages = deafen(stages, nuisances.deaf_antennas, of_departures)
        if nuisances.departures > 0 or nuisances.mismatch > 0 or nuisances.deaf_antennas > 0:
            truth = replace(truth, c=path_calibration(stages, instrument))
        drawn.append(DrawnStation(scene, stages, truth, of_noise, of_gains))
    return drawn, of_losses


def expected_power(stages: Stages, scene: Scene, faults: Sequence[Fault]) -> Floats:
    """The power of every path and event without scatter, shape (antenna, dipole, event, freq), ADC^2/Ohm/MHz."""
    for fault in faults:
        stages = fault.alter(stages, scene)
    power = stages.power_at_converter()
    for fault in faults:
        power = fault.alter_at_converter(power, scene)
    return power + stages.adc_noise


def _stations(settings: TwinSettings, instrument: Instrument) -> list[str]:
    known = sorted({record.station for record in instrument.antennas})
    for station in settings.stations:
        if station not in known:
            raise UnknownNameError("station", station, known)
    return list(settings.stations) or known


def _gather(scenes: list[Scene], powers: list[Floats], blocks: list[NDArray[np.int64]]) -> Spectra:
    """One row per station, antenna, dipole and event, in that order."""
    scene = scenes[0]
    events = len(scene.time_unix)
    event_id = np.array([str(int(t) - UNIX_2010) for t in scene.time_unix])
    paths = [(one.station, int(a), dipole) for one in scenes for a in one.antennas for dipole in one.dipoles]
    return Spectra(
        frequency_mhz=scene.frequency_mhz,
        power=np.concatenate([power.reshape(-1, power.shape[3]) for power in powers]),
        event_id=np.tile(event_id, len(paths)),
        time_unix=np.tile(scene.time_unix, len(paths)),
        station=np.repeat(np.array([station for station, _, _ in paths]), events),
        antenna=np.repeat(np.array([antenna for _, antenna, _ in paths], dtype=np.int64), events),
        dipole=np.repeat(np.array([dipole for _, _, dipole in paths]), events),
        blocks=np.concatenate([counts.reshape(-1) for counts in blocks]),
        environment={
            "temperature_c": np.tile(scene.temperature_c, len(paths)),
            "rain_mm_h": np.tile(scene.rain_mm_h, len(paths)),
        },
        origin="twin",
    )
