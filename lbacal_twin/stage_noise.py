"""Noise of a chain that is given as a list of stages, drawn stage by stage as the signal passes them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.instrument.stages import SEEN, Stage, split_stages

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


def _typical(values: Floats) -> float:
    return float(np.exp(np.log(values).mean()))
