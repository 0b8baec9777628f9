"""The hardware of a simulated station: gains, losses and noise levels drawn about the published ones."""

from __future__ import annotations

import numpy as np

from lbacal_core.data.tables import read_table
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_twin.settings import TwinSettings
from lbacal_twin.stage_noise import KELVIN_W_MHZ, draw_stage_noise
from lbacal_twin.stages import Scene, Stages
from lbacal_twin.truth import StationTruth


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
    path_gain, own_response = settings.path_gain, settings.response
    if instrument.kelvin_error is not None:
        # the laboratory has divided the receiver out
        c_published, path_gain, own_response = np.full(frequency.size, KELVIN_W_MHZ**0.5), instrument.kelvin_error, 0.0
    response = 1.0 / (c_published**2 * mean_loss * instrument.receiver_gain)
    scale = float(np.median(response))
    wave = np.cos(np.pi * np.outer((frequency - frequency[0]) / (np.ptp(frequency) or 1.0), [1, 2, 3]))
    departure = rng.normal(scale=own_response / 1.5**0.5, size=(1, len(scene.dipoles), 1, 3)) @ wave.T
    antenna = instrument.antenna_gain * response / scale * np.exp(departure)
    receiver = instrument.receiver_gain * scale
    gain = np.exp(rng.normal(scale=path_gain, size=(len(scene.antennas), len(scene.dipoles), 1, 1)))
    sky = scene.mean_sky.mean(axis=(0, 1, 2))
    forward = {
        "lna": np.ones_like(sky),
        "rcu": antenna.mean(axis=(0, 1, 2)) * mean_loss,
        "adc": antenna.mean(axis=(0, 1, 2)) * mean_loss * receiver,
    }
    levels = {
        name: _geometric_mean(np.interp(frequency, terms["mhz"], terms[name] / terms["sky"]) * sky * carried)
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


def _geometric_mean(values: Floats) -> float:
    return float(np.exp(np.log(values).mean()))
