"""The noise constants of an instrument: which there are, what each adds along frequency, what is known of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.constants import Boltzmann

from lbacal_core.chain.intercepts import OUTPUT_UNIT, SKY_UNIT, Intercepts, three_constants
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.instrument.stages import FREE, SEEN, Stage, multiply_gains, split_stages
from lbacal_core.skypower.power import power_per_kelvin_sr

WATT_PER_MHZ = 1e6 * Boltzmann
"""Noise power of 1 K, W/MHz."""


def noise_constants(instrument: Instrument) -> Intercepts:
    """The noise constants of an instrument: those of its stages, or N_LNA, N_RCU and N_ADC of eq. full_chain.

    A temperature that is known at the input of a stage is referred to the sky through the tables of what stands in
    front of it: N G_ant g_1 ... = k_B T.
    """
    if not instrument.stages:
        return three_constants(instrument.receiver_gain)
    front, behind = split_stages(instrument.stages)
    channels = instrument.frequency_mhz.size
    names, units, forms, means, errors = [], [], [], [], []
    known = np.zeros(channels)
    for k, stage in enumerate((*front, *behind)):
        if not stage.has_noise or (k >= len(front) and stage.is_free):
            continue
        form = _refer_to_sky(instrument, [*front, *behind], k, is_behind=k >= len(front))
        if stage.noise_k is not None and not stage.error_k:
            known += stage.noise_k * form
            continue
        level = 0.0 if stage.noise_k is None else float(stage.noise_k.mean())
        names.append(f"n_{stage.name}")
        units.append(_unit_of(stage))
        forms.append(form if stage.noise_k is None else form * stage.noise_k / level)
        means.append(level)
        errors.append(np.inf if stage.noise_k is None else stage.error_k)
    free = [k for k, stage in enumerate(behind) if stage.is_free]
    return Intercepts(
        names=(*names, *(f"n_{behind[k].name}" for k in free)),
        front=np.array(forms).reshape(-1, channels),
        behind=np.array([multiply_gains(behind[k:], channels) for k in free]).reshape(-1, channels),
        known=known,
        mean=np.array(means),
        precision=np.array(errors, dtype=float) ** -2.0,
        units=(*units, *(OUTPUT_UNIT for _ in free)),
        ends_in_adc=bool(free) and behind[free[-1]].kind == "adc",
    )


def _unit_of(stage: Stage) -> str:
    if stage.kind == "antenna":
        return SKY_UNIT
    return "K sr" if stage.kind in SEEN and stage.is_free else "K"


def _refer_to_sky(instrument: Instrument, order: Sequence[Stage], k: int, *, is_behind: bool) -> Floats:
    """What a unit of a stage's noise adds to P_sky, shape (freq,).

    The unit is P_sky's for the antenna, 1 K at its input for what the signal passes. A body of 1 K that fills 1 sr
    where D = 1 adds what a sky does.
    """
    stage, frequency_mhz = order[k], instrument.frequency_mhz
    if stage.kind == "antenna":
        return np.ones(frequency_mhz.size)
    if stage.kind in SEEN:
        return power_per_kelvin_sr(frequency_mhz) * (1.0 if stage.is_free else stage.solid_angle_sr)
    before = instrument.antenna_gain * multiply_gains(order[:k], frequency_mhz.size)
    return np.asarray(WATT_PER_MHZ / (before * _loss_of(instrument, stage) if is_behind else before))


def _loss_of(instrument: Instrument, stage: Stage) -> Floats:
    """L_coax that all antennas share."""
    losses = list(instrument.cables.values())
    if any(not np.array_equal(loss, losses[0]) for loss in losses):
        raise BadInputError(
            f"instrument {instrument.name}: stage {stage.name}: noise_temperature_k",
            f"{FREE}, or none, behind cables that differ from antenna to antenna",
            "a known one",
        )
    return losses[0]
