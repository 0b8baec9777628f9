"""Causes in the antenna: its dipoles and its resonance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import scipy

from lbacal_core.antenna.lofar import ResonanceCircuit
from lbacal_core.causes.cause import RAIN, TEMPERATURE, Cause, Conditions, SizeRange, Template, read_between
from lbacal_core.grids import Floats
from lbacal_core.instrument.chain import ChainTerms

SEASON_SPAN_S = 250 * 86_400.0
"""Shorter data cannot tell a season from a drift."""


CIRCUIT = ResonanceCircuit()
STIFFNESS = (2.0 / (2 * np.pi)) ** 4
"""Smoothing of the spline through ln A(nu) in channels of 1 MHz: it halves waves of 2 MHz, the noise of the fit, and
keeps details of 4 MHz, without which the score of a widening loses a quarter."""


@dataclass(frozen=True)
class DipoleSwap(Cause):
    """Each dipole records a share of the other's sky; a share of 1 is an exchange."""

    identifier: str = "dipole_swap"
    unit: str = "share, 1 = exchanged"
    meaning: str = "the dipoles X and Y are mixed or exchanged"
    confirm: str = (
        "unplug one dipole, compare the azimuths of the arms with the file that names them, or look at the "
        "polarisation of a bright source"
    )
    scopes: Sequence[str] = ("station", "antenna")
    largest_step: float = 0.7
    sizes: SizeRange = SizeRange(0.0, 1.0, physical_end=1.0)
    whole_array_size: float | None = 1.0
    whole_array_meaning: str = "the letters of the dipoles X and Y are exchanged"
    needs: str = "the instrument has one dipole"
    spectral_parameters: Sequence[str] = ("between",)

    def templates(self, conditions: Conditions) -> list[Template]:
        """One for each pair of letters, without a parameter where there is only one pair."""
        pairs = conditions.dipole_pairs
        return [Template()] * len(pairs) if len(pairs) < 2 else [Template({"between": " ".join(p)}) for p in pairs]

    def is_another(self, template: Template, earlier: Template) -> bool:
        """Whether the pairs differ."""
        return template.parameters != earlier.parameters

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:
        """P_X -> (1 - f) P_X + f P_Y."""
        first, second = template.parameters.get("between", " ".join(conditions.dipole_pairs[0])).split()
        other = conditions.across(terms.sky, (first, second))
        return replace(terms, sky=(1.0 - amount) * terms.sky + amount * other)


@dataclass(frozen=True)
class ResonanceCause(Cause):
    """A property of the resonance that follows temperature, season or wetness.

    Its spectral template depends on what resonates: the curve of G_ant as a whole (``curve``), or the circuit of
    dipole and LNA behind which the other losses stay (``circuit``).
    """

    needs: str = "no temperature, rain or season in these data; what is static is in A"
    axes: Sequence[str] = ("temperature", "rain", "date")
    scopes: Sequence[str] = ("station", "antenna")
    spectral_parameters: Sequence[str] = ("model",)

    def templates(self, conditions: Conditions) -> list[Template]:
        """One template for each covariate or season that a mechanical or chemical property can follow."""
        followed: list[dict[str, Any]] = []
        if conditions.covariate(TEMPERATURE) is not None:
            followed.append({"follows": "temperature"})
        if np.ptp(conditions.time_unix) > SEASON_SPAN_S:
            followed += [{"follows": "season", "phase_deg": phase} for phase in (0.0, 45.0, 90.0, 135.0)]
        if conditions.covariate(RAIN) is not None:
            followed += [{"follows": "wetness", "wetness": kind} for kind in ("flag", "linear", "saturating")]
        return [Template(one | {"model": model}) for model in ("curve", "circuit") for one in followed]

    def covariates(self, template: Template) -> Sequence[str]:
        """The column that is followed; none of the season."""
        return {"temperature": (TEMPERATURE,), "wetness": (RAIN,), "season": ()}[template.parameters["follows"]]

    def finer_templates(self, conditions: Conditions, template: Template) -> list[Template]:
        """Every phase of the season, every kind of wetness, both models."""
        alike = [
            one for one in self.templates(conditions) if one.parameters["follows"] == template.parameters["follows"]
        ]
        if template.parameters["follows"] != "season":
            return alike
        phases = np.arange(0.0, 360.0, 15.0).tolist()
        return [
            Template({"follows": "season", "phase_deg": phase, "model": model})
            for model in ("curve", "circuit")
            for phase in phases
        ]

    def time_profile(self, conditions: Conditions, template: Template) -> Floats:
        """The season, temperature about its mean, or rain, as ``follows`` of the template says, shape (event, 1)."""
        kind = template.parameters["follows"]
        if kind == "season":
            return conditions.season(template.parameters["phase_deg"])
        if kind == "temperature":
            return conditions.warmth()
        return conditions.wetness(template.parameters["wetness"])

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:
        """Another G_ant in front.

        It is changed by the amount as `of_circuit` or `of_curve` says, by the ``model`` of the template.
        """
        if template.parameters["model"] == "circuit":
            change = self.of_circuit(conditions, amount)
        else:
            change = self.of_curve(conditions.frequency_mhz, fitted_log_gain(terms, conditions), amount)
        return replace(terms, front=terms.front * np.exp(change))

    def of_curve(self, frequency_mhz: Floats, log_gain: Floats, amount: Floats) -> Floats:
        """Change of ln G_ant by an amount, from the curve that was fitted; broadcast over (event, freq)."""
        raise NotImplementedError

    def of_circuit(self, conditions: Conditions, amount: Floats) -> Floats:
        """As `of_curve` to first order, from the circuit of dipole and LNA, shape of `amount` with freq."""
        raise NotImplementedError


@dataclass(frozen=True)
class ResonanceShift(ResonanceCause):
    """The resonance moves with the weather."""

    identifier: str = "resonance_shift"
    unit: str = "MHz per 10 K, at full season or wetness, or per mm/h"
    sizes: SizeRange = SizeRange(-5.0, 5.0)
    meaning: str = "the antenna's resonance moves with temperature, season or wetness"
    confirm: str = "measure the antenna's impedance warm and cold, dry and wet"
    step: float = 0.01

    def of_curve(self, frequency_mhz: Floats, log_gain: Floats, amount: Floats) -> Floats:
        """Change of ln G_ant read at nu - `amount`, MHz, shape (..., freq) for an amount of shape (..., 1)."""
        return read_between(frequency_mhz, log_gain, frequency_mhz - amount) - log_gain

    def of_circuit(self, conditions: Conditions, amount: Floats) -> Floats:
        """Change of ln G_ant by the length of the arms, shape (..., freq).

        `amount` is the shift of the half-power points, MHz.
        """
        longer, shorter = (replace(CIRCUIT, arm_m=CIRCUIT.arm_m * factor) for factor in (1.001, 0.999))
        change = np.log(longer.gain(conditions.frequency_mhz) / shorter.gain(conditions.frequency_mhz))
        return np.asarray(amount * change / (np.mean(_half_power_mhz(longer)) - np.mean(_half_power_mhz(shorter))))


@dataclass(frozen=True)
class ResonanceWidth(ResonanceCause):
    """The resonance widens with the weather."""

    identifier: str = "resonance_width"
    unit: str = "fraction per 10 K, at full season or wetness, or per mm/h"
    sizes: SizeRange = SizeRange(-0.9, 5.0)
    meaning: str = "the antenna's resonance widens with temperature, season or wetness"
    confirm: str = "measure the antenna's impedance warm and cold, dry and wet"
    step: float = 0.002

    def of_curve(self, frequency_mhz: Floats, log_gain: Floats, amount: Floats) -> Floats:
        """Change of ln G_ant read closer to its resonance, shape (..., freq): the peak widens by exp(`amount`)."""
        centre = frequency_mhz[np.argmax(log_gain)]
        closer = centre + (frequency_mhz - centre) * np.exp(-amount)
        return read_between(frequency_mhz, log_gain, closer) - log_gain

    def of_circuit(self, conditions: Conditions, amount: Floats) -> Floats:
        """Change of ln G_ant by resistance in the dipole, shape (..., freq).

        `amount` is ln of the width at half power.
        """
        more, less = (replace(CIRCUIT, resistance_ohm=CIRCUIT.resistance_ohm * factor) for factor in (1.001, 0.999))
        change = np.log(more.gain(conditions.frequency_mhz) / less.gain(conditions.frequency_mhz))
        return np.asarray(amount * change / np.log(np.ptp(_half_power_mhz(more)) / np.ptp(_half_power_mhz(less))))


def log_gain(terms: ChainTerms, conditions: Conditions) -> Floats:
    """Ln (G_ant A) of the station as fitted, the median of the classes, shape (freq,)."""
    behind = conditions.receiver_gain * np.exp(conditions.cable_log_loss[:, None, :])
    # Other causes may have made the gain depend on the event: the mean counts.
    own = np.log(np.maximum(np.mean(terms.front / behind, axis=1), 1e-300))
    return np.asarray(np.median(own, axis=0))


def fitted_log_gain(terms: ChainTerms, conditions: Conditions) -> Floats:
    """Ln (G_ant A) of the station as fitted, ln A smoothed in frequency, shape (freq,).

    Smoothing removes the noise of the fit from channel to channel.
    """
    of_table = np.log(conditions.antenna_gain)
    own = log_gain(terms, conditions) - of_table
    return np.asarray(smoother(tuple(conditions.frequency_mhz.tolist())) @ own + of_table)


@lru_cache(maxsize=8)
def smoother(frequency_mhz: tuple[float, ...]) -> Floats:
    """The smoothing spline of values in channels is linear in these: its matrix, shape (freq, freq)."""
    channels, each = np.array(frequency_mhz), np.eye(len(frequency_mhz))
    splines = [scipy.interpolate.make_smoothing_spline(channels, one, lam=STIFFNESS) for one in each]
    return np.stack([spline(channels) for spline in splines], axis=1)


def _half_power_mhz(circuit: ResonanceCircuit) -> tuple[float, float]:
    """Frequencies at which the circuit's gain is half its largest, below and above."""
    grid = np.arange(25.0, 90.0, 0.02)
    level = np.log(circuit.gain(grid))
    top = int(np.argmax(level))
    half = level[top] - np.log(2.0)
    return float(np.interp(half, level[:top], grid[:top])), float(np.interp(-half, -level[top:], grid[top:]))
