"""The hardware of a simulated station: gains, losses and noise levels drawn about the published ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.data.tables import read_table
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.instrument.stages import SEEN, Stage, split_stages
from lbacal_core.sky.table import SkyPower
from lbacal_twin.settings import StationTruth, TwinSettings
from lbacal_twin.view import View
from lbacal_twin.weather import Weather


def build_station(
    settings: TwinSettings, instrument: Instrument, scene: Scene, rng: np.random.Generator
) -> tuple[Stages, StationTruth]:
    """Draw the hardware of one station, in working order.

    A and S come from the published C(nu) with the station's mean cable, A S = 1/(C^2 L_coax G_RCU), times a smooth
    departure for each polarisation. The noise constants come from the published terms: each term, divided by the sky
    beside it, is a ratio that does not depend on units; times our own P_sky it is the noise referred to the sky;
    carried forward to the point where it enters (nothing for N_LNA, G_ant A L for N_RCU, G_ant A L G_RCU S for
    N_ADC) it is constant along frequency within the accuracy of the published figure and this chain. Its geometric
    mean over frequency is the constant. The frequency dependence in the spectra is the chain's, not the figure's.
    """
    frequency = instrument.frequency_mhz
    loss = _cable_loss(instrument, scene)
    mean_loss = loss.mean(axis=(0, 1, 2))
    published, terms = read_table("published_calibration"), read_table("noise_terms")
    c_published = np.interp(frequency, published["mhz"], published["c"])
    path_gain, own_response, to_antenna = settings.path_gain, settings.response, np.ones(1)
    if instrument.kelvin_error is not None:
        # the laboratory has divided receiver and cable out
        c_published, path_gain, own_response = np.full(frequency.size, KELVIN_W_MHZ**0.5), instrument.kelvin_error, 0.0
        to_antenna = mean_loss / loss
    response = 1.0 / (c_published**2 * mean_loss * instrument.receiver_gain)
    scale = float(np.median(response))
    wave = np.cos(np.pi * np.outer((frequency - frequency[0]) / (np.ptp(frequency) or 1.0), [1, 2, 3]))
    departure = rng.normal(scale=own_response / 1.5**0.5, size=(1, len(scene.dipoles), 1, 3)) @ wave.T
    antenna = instrument.antenna_gain * response / scale * np.exp(departure) * to_antenna
    receiver = instrument.receiver_gain * scale
    gain = np.exp(rng.normal(scale=path_gain, size=(len(scene.antennas), len(scene.dipoles), 1, 1)))
    sky = scene.mean_sky.mean(axis=(0, 1, 2))
    forward = {
        "lna": np.ones_like(sky),
        "rcu": antenna.mean(axis=(0, 1, 2)) * mean_loss,
        "adc": antenna.mean(axis=(0, 1, 2)) * mean_loss * receiver,
    }
    levels = {
        name: _typical(np.interp(frequency, terms["mhz"], terms[name] / terms["sky"]) * sky * carried)
        * float(np.exp(rng.normal(scale=settings.noise_level)))
        for name, carried in forward.items()
    }
    lna_noise, rcu_noise = np.full((1, 1, 1, 1), levels["lna"]), np.full((1, 1, 1, 1), levels["rcu"])
    adc, constants = levels["adc"], None
    if instrument.stages:
        noise = draw_stage_noise(instrument, levels["lna"], levels["rcu"] * scale, levels["adc"], rng)
        lna_noise, rcu_noise = noise.at_sky[None, None, None], (noise.at_output / receiver)[None, None, None]
        adc, constants = noise.adc, noise.constants
    stages = Stages(
        sky=scene.sky_at(scene.lst_hours),
        lna_noise=lna_noise,
        antenna=antenna,
        gain=gain,
        cable=loss,
        rcu_noise=rcu_noise,
        receiver=receiver[None, None, None, :],
        adc_noise=np.full((1, 1, 1, 1), adc),
    )
    truth = StationTruth(
        station=scene.station,
        antennas=scene.antennas,
        c=path_calibration(stages, instrument),
        path_gain=gain[:, :, 0, 0],
        n_lna=levels["lna"],
        n_rcu=levels["rcu"] * scale,
        n_adc=levels["adc"],
        constants=constants,
    )
    return stages, truth


def path_calibration(stages: Stages, instrument: Instrument) -> Floats:
    """C(nu) of every path with the cable of the first event, shape (antenna, dipole, freq)."""
    power_gain = stages.gain * stages.antenna / instrument.antenna_gain * stages.cable[:, :, :1] * stages.receiver
    return np.asarray(power_gain[:, :, 0] ** -0.5)


def _cable_loss(instrument: Instrument, scene: Scene) -> Floats:
    """L_coax of every antenna, shape (antenna, 1, event or 1, freq): with an event axis if a cable changes."""
    records = {
        int(a): [r for r in instrument.antennas if (r.station, r.antenna) == (scene.station, int(a))]
        for a in scene.antennas
    }
    names = sorted(instrument.cables)
    index = np.full((len(scene.antennas), len(scene.time_unix)), -1)
    for row, antenna in enumerate(scene.antennas):
        for record in records[int(antenna)]:
            since = -np.inf if record.since is None else record.since
            until = np.inf if record.until is None else record.until
            index[row, (scene.time_unix >= since) & (scene.time_unix < until)] = names.index(record.cable)
    for row, event in np.argwhere(index < 0)[:1]:
        instrument.cable_of(scene.station, int(scene.antennas[row]), float(scene.time_unix[event]))  # names the gap
    if np.all(index == index[:, :1]):
        index = index[:, :1]
    return np.asarray(np.array([instrument.cables[name] for name in names])[index][:, None])


def _typical(values: Floats) -> float:
    return float(np.exp(np.log(values).mean()))


# The twin's own signal chain, written from eq. full_chain without the code of `chain`, so that each tests the other.


@dataclass(frozen=True)
class Scene:
    """The surroundings of one station during a campaign.

    Attributes
    ----------
    antennas, cables
        Shape (antenna,), numbers, and names of the cables at the first event.
    time_unix, lst_hours, temperature_c, rain_mm_h
        Shape (event,).
    sky_power
        P_sky of each dipole at any LST.
    weather
        The weather at any instant, for what follows it with a delay.
    view
        Our own sky and antenna by direction, for what has a direction.
    """

    station: str
    latitude_deg: float
    longitude_deg: float
    frequency_mhz: Floats
    antennas: NDArray[np.int64]
    cables: NDArray[np.str_]
    time_unix: Floats
    lst_hours: Floats
    temperature_c: Floats
    rain_mm_h: Floats
    sky_power: SkyPower
    weather: Weather
    view: View

    @property
    def dipoles(self) -> tuple[str, ...]:
        """Letters of the dipoles, in the order of the axis."""
        return tuple(sorted(self.sky_power.power))

    def sky_at(self, lst_hours: Floats) -> Floats:
        """P_sky at one LST per event, shape (1, dipole, event, freq)."""
        return np.stack([self.sky_power.at(dipole, lst_hours) for dipole in self.dipoles])[None]

    @property
    def mean_sky(self) -> Floats:
        """P_sky averaged over LST, shape (1, dipole, 1, freq)."""
        return np.stack([self.sky_power.power[dipole].mean(axis=0) for dipole in self.dipoles])[None, :, None]

    @property
    def warmth(self) -> Floats:
        """Air temperature above 10 degrees Celsius in units of 10 K, shape (event, 1)."""
        return (self.temperature_c[:, None] - 10.0) / 10.0

    @property
    def utc_hours(self) -> Floats:
        """UTC hour of day, shape (event, 1)."""
        return (self.time_unix[:, None] / 3600.0) % 24.0


@dataclass(frozen=True)
class Stages:
    """The signal chain of one station, stage by stage in the order of eq. full_chain.

    Attributes
    ----------
    sky
        P_sky, directional, its unit that of the sky power.
    lna_noise
        N_LNA, referred to the sky.
    antenna
        G_ant A, the antenna and its correction.
    gain
        Gain of the path, in front of N_RCU.
    cable
        L_coax.
    rcu_noise
        N_RCU, at the input of the receiver.
    receiver
        G_RCU S.
    adc_noise
        N_ADC, at the output, ADC^2/Ohm/MHz.
    """

    sky: Floats
    lna_noise: Floats
    antenna: Floats
    gain: Floats
    cable: Floats
    rcu_noise: Floats
    receiver: Floats
    adc_noise: Floats

    def power_at_converter(self) -> Floats:
        """Power at the converter, before its own noise; ADC^2/Ohm/MHz."""
        slope = self.gain * self.antenna * self.cable * self.receiver
        power = self.sky * slope
        power += self.lna_noise * slope + self.rcu_noise * self.receiver
        return power


# Noise of a chain that is given as a list of stages, drawn stage by stage as the signal passes them.

KELVIN_W_MHZ = 1.380649e-23 * 1e6
"""Power of 1 K in 1 MHz, W/MHz."""
BODY_OF_A_STERADIAN = KELVIN_W_MHZ * 376.730313668 / 50.0 * (1e6 / 299_792_458.0) ** 2
"""What 1 K that fills 1 sr adds to P_sky at 1 MHz, W m^-2 MHz^-1, into 50 ohm; it goes as nu^2."""


@dataclass(frozen=True)
class StageNoise:
    """Noise of all stages.

    Attributes
    ----------
    at_sky
        What is multiplied by the slope, in the unit of P_sky, shape (freq,).
    at_output
        What the stages behind the cable add at the output but the converter, shape (freq,), ADC^2/Ohm/MHz.
    adc
        Noise of the converter.
    constants
        The planted value of each constant that a fit may report.
    """

    at_sky: Floats
    at_output: Floats
    adc: float
    constants: Mapping[str, float]


def draw_stage_noise(
    instrument: Instrument, at_sky: float, at_receiver: float, adc: float, rng: np.random.Generator
) -> StageNoise:
    """Noise of the free stages with the given sums, shared at random; of the known ones within their errors.

    Parameters
    ----------
    at_sky
        Typical sum in front of the cable, in the unit of P_sky.
    at_receiver
        Typical N_RCU S, at the output once multiplied by G_RCU.
    adc
        Noise of the converter at the output.
    """
    front, behind = split_stages(instrument.stages)
    free = [stage for stage in (*front, *behind) if stage.is_free]
    part = dict(zip([stage.name for stage in free], rng.uniform(0.5, 1.5, len(free)), strict=True))
    sum_front = sum(part[stage.name] for stage in front if stage.is_free)
    sum_behind = sum(part[stage.name] for stage in behind if stage.is_free and stage.kind != "adc")
    sky, output = np.zeros(instrument.frequency_mhz.size), np.zeros(instrument.frequency_mhz.size)
    constants, converter = {}, 0.0
    passed, left = instrument.antenna_gain, instrument.receiver_gain
    for stage in front:
        form = _at_sky(stage, instrument.frequency_mhz, passed)
        if stage.is_free:
            constants[f"n_{stage.name}"] = at_sky * part[stage.name] / sum_front / _typical(form)
            sky = sky + constants[f"n_{stage.name}"] * form
        sky = sky + _known(stage, form, constants, rng)
        passed = passed if stage.gain is None or stage.kind in SEEN else passed * stage.gain
    passed = passed * next(iter(instrument.cables.values()))
    for stage in behind:
        if stage.kind == "adc" and stage.is_free:
            constants[f"n_{stage.name}"] = converter = adc
        elif stage.is_free:
            share = part[stage.name] / sum_behind
            constants[f"n_{stage.name}"] = at_receiver * share * _typical(instrument.receiver_gain) / _typical(left)
            output = output + constants[f"n_{stage.name}"] * left
        sky = sky + _known(stage, _at_sky(stage, instrument.frequency_mhz, passed), constants, rng)
        passed, left = (passed, left) if stage.gain is None else (passed * stage.gain, left / stage.gain)
    return StageNoise(sky, output, converter, constants)


def _at_sky(stage: Stage, frequency_mhz: Floats, passed: Floats) -> Floats:
    """What a unit of a stage's noise is in P_sky, behind what the signal has passed, shape (freq,)."""
    if stage.kind == "antenna":
        return np.ones(frequency_mhz.size)
    if stage.kind in SEEN:
        return BODY_OF_A_STERADIAN * frequency_mhz**2 * (1.0 if stage.is_free else stage.solid_angle_sr)
    return KELVIN_W_MHZ / passed


def _known(stage: Stage, form: Floats, constants: dict[str, float], rng: np.random.Generator) -> Floats:
    """What a stage of known noise adds to P_sky, its temperature off by its error at random, shape (freq,)."""
    if stage.noise_k is None:
        return np.zeros(form.size)
    mean = float(stage.noise_k.mean())
    planted = mean + stage.error_k * float(rng.standard_normal())
    if stage.error_k:
        constants[f"n_{stage.name}"] = planted
    return np.asarray(stage.noise_k * planted / mean * form)
