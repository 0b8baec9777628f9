"""The signal chain, from sky power to recorded power and to the calibration factor.

At one frequency eq. full_chain of Mulrey et al. 2019 is a straight line in P_sky, which is what the fit works with:

    P = s P_sky + b,    s = G_ant A L_coax G_RCU S,    b = N_LNA s + N_RCU S G_RCU + N_ADC.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.data.constants import BOLTZMANN
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.instrument.matching import power_per_kelvin_sr
from lbacal_core.instrument.stages import FREE, SEEN, Stage, multiply_gains, split_stages


def calibration_factor(slope: Floats, antenna_gain: Floats) -> Floats:
    """C = (A L_coax G_RCU S)^-1/2 (eq. cal_equation) from the slope s = G_ant A L_coax G_RCU S of each frequency.

    Parameters
    ----------
    slope
        Shape (..., freq), recorded power per sky power.
    antenna_gain
        G_ant, shape (freq,): it is not part of C, because a pulse comes from another direction than the sky.

    Returns
    -------
    Shape (..., freq), V per ADC unit.
    """
    return np.asarray(np.sqrt(antenna_gain / slope))


# The terms of eq. full_chain for each class of paths: what a cause changes, and the power that follows.


@dataclass(frozen=True)
class ChainTerms:
    """The terms of eq. full_chain for each class of paths, broadcastable to shape (class, event, freq).

    Paths of one station with the same polarisation and cable share their terms: they are one *class* of paths.

    Attributes
    ----------
    sky
        P_sky.
    n_lna
        N_LNA, in the unit of P_sky.
    front
        s = G_ant A L_coax G_RCU S: from the sky to the output.
    receiver_noise
        N_RCU S G_RCU, at the output.
    adc_noise
        N_ADC, at the output.
    """

    sky: Floats
    n_lna: Floats
    front: Floats
    receiver_noise: Floats
    adc_noise: Floats

    def power(self) -> Floats:
        """Recorded power (eq. full_chain), shape (class, event, freq)."""
        return np.asarray((self.sky + self.n_lna) * self.front + self.receiver_noise + self.adc_noise)


# The noise constants of an instrument: which there are, what each adds along frequency, what is known of it.

# What the intercept of a line is made of: b = (known + n F) s + q H, with the noise in front of A and behind it.
#
# Noise that enters in front of the free response A(nu) is multiplied by the slope s, as the sky is; noise that enters
# behind it is not. Each row of F and H is what one constant adds per unit along frequency.

SKY_UNIT, OUTPUT_UNIT = "P_sky", "ADC^2/Ohm/MHz"
"""Units of a noise constant in front of the antenna, and of one at the output."""


@dataclass(frozen=True)
class Intercepts:
    """The noise constants of a chain, those in front of A(nu) first.

    Attributes
    ----------
    names
        Name of each constant, r in front and k behind.
    front
        What a unit of each constant in front adds to P_sky, shape (r, freq).
    behind
        What a unit of each constant behind adds at the output, shape (k, freq).
    known
        What is known to be added to P_sky, shape (freq,).
    mean, precision
        Mean and inverse variance of what is known of each constant in front, shape (r,); precision 0: nothing.
    units
        Unit of each constant.
    ends_in_adc
        Whether the last constant is the noise of the converter.
    """

    names: Sequence[str]
    front: Floats
    behind: Floats
    known: Floats
    mean: Floats
    precision: Floats
    units: Sequence[str]
    ends_in_adc: bool = True

    @property
    def free_count(self) -> int:
        """How many constants the data alone determine."""
        return int(np.sum(self.precision == 0)) + len(self.behind)

    @property
    def design(self) -> Floats:
        """H as columns, shape (freq, k)."""
        return np.ascontiguousarray(self.behind.T)

    def describe(self) -> str:
        """Each constant with its unit, and what is known of it."""
        words = [f"{name} in {unit}" for name, unit in zip(self.names, self.units, strict=True)]
        for k in np.flatnonzero(self.precision > 0).tolist():
            words[k] += f", known as {self.mean[k]:g} +- {self.precision[k] ** -0.5:g}"
        return "; ".join(words)

    def before(self, n: Floats) -> Floats:
        """All noise in front of A(nu) in the unit of P_sky, shape (..., freq), for constants of shape (..., r)."""
        return np.asarray(self.known + n @ self.front)

    def on_line(self, x: Floats, n: Floats, q: Floats) -> Floats:
        """The intercepts b of slopes, shape (..., freq), and constants, (..., r) and (..., k)."""
        return np.asarray(self.before(n) * x + q @ self.behind)

    def split_behind(self, q: Floats) -> tuple[Floats, Floats]:
        """The noise of the receiver and that of the converter, shape (freq,) each, for constants behind, shape (k,)."""
        of_receiver = len(q) - self.ends_in_adc
        return q[:of_receiver] @ self.behind[:of_receiver], q[of_receiver:] @ self.behind[of_receiver:]

    def select(self, channels: NDArray[Any]) -> Intercepts:
        """The same on some of the channels."""
        front, behind, known = self.front[:, channels], self.behind[:, channels], self.known[channels]
        return replace(self, front=front, behind=behind, known=known)


def three_constants(receiver_gain: Floats) -> Intercepts:
    """The constants of eq. full_chain: N_LNA in front, N_RCU S and N_ADC behind.

    Parameters
    ----------
    receiver_gain
        G_RCU, shape (freq,).
    """
    return Intercepts(
        names=("n_lna", "n_rcu", "n_adc"),
        front=np.ones((1, receiver_gain.size)),
        behind=np.stack([receiver_gain, np.ones_like(receiver_gain)]),
        known=np.zeros(receiver_gain.size),
        mean=np.zeros(1),
        precision=np.zeros(1),
        units=(SKY_UNIT, OUTPUT_UNIT, OUTPUT_UNIT),
    )


PUBLISHED, BEHIND, SLOPED = "published", "behind", "sloped"
FORMS: Mapping[str, Sequence[str]] = {
    PUBLISHED: ("n_lna",),
    BEHIND: ("n_lna", "n_amplifier"),
    SLOPED: ("n_lna", "n_lna_slope"),
}
"""The constants in front of A(nu) in each form of the chain. The published one has N_LNA alone, flat in units of P_sky.
An amplifier's voltage noise enters behind the antenna's resonance, (P_sky G_ant + N) A L: it adds N / G_ant to P_sky.
Beside it N_LNA stays, as which a sky whose zero level is off appears. Or N_LNA has a slope, (nu - 55 MHz) / 25 MHz."""
FRONT_CONSTANTS: Sequence[str] = tuple(dict.fromkeys(name for names in FORMS.values() for name in names))


def constants_of_form(instrument: Instrument, names: Sequence[str]) -> Intercepts:
    """The noise constants of eq. full_chain with other ones in front of A(nu), by their names."""
    flat = np.ones(instrument.frequency_mhz.size)
    forms = {
        "n_lna": (flat, SKY_UNIT),
        "n_amplifier": (flat / instrument.antenna_gain, f"{SKY_UNIT} m^2"),
        "n_lna_slope": ((instrument.frequency_mhz - 55.0) / 25.0, f"{SKY_UNIT}/25 MHz"),
    }
    front, units = zip(*(forms[name] for name in names), strict=True)
    plain = three_constants(instrument.receiver_gain)
    return replace(
        plain,
        names=(*names, *plain.names[1:]),
        front=np.array(front),
        mean=np.zeros(len(names)),
        precision=np.zeros(len(names)),
        units=(*units, *plain.units[1:]),
    )


WATT_PER_MHZ = 1e6 * BOLTZMANN
"""Noise power of 1 K, W/MHz."""


def noise_constants(instrument: Instrument, form: str = PUBLISHED) -> Intercepts:
    """The noise constants of an instrument: of its stages, or of one of `FORMS` of eq. full_chain where it lists none.

    A temperature that is known at the input of a stage is referred to the sky through the tables of what stands in
    front of it: N G_ant g_1 ... = k_B T.
    """
    if not instrument.stages:
        return constants_of_form(instrument, FORMS[form])
    front, behind = split_stages(instrument.stages)
    channels = instrument.frequency_mhz.size
    names, units, forms, means, errors = [], [], [], [], []
    known = np.zeros(channels)
    for k, stage in enumerate((*front, *behind)):
        if not stage.has_noise or (k >= len(front) and stage.is_free):
            continue
        added = _refer_to_sky(instrument, [*front, *behind], k, is_behind=k >= len(front))
        if stage.noise_k is not None and not stage.error_k:
            known += stage.noise_k * added
            continue
        level = 0.0 if stage.noise_k is None else float(stage.noise_k.mean())
        names.append(f"n_{stage.name}")
        units.append(_unit_of(stage))
        forms.append(added if stage.noise_k is None else added * stage.noise_k / level)
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
