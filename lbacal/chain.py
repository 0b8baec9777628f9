"""The signal chain in Python: stages with their gains and noise, in astropy's units."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from astropy import units as u
from numpy.typing import NDArray

from lbacal.units import convert_number, convert_numbers
from lbacal_core.errors import BadInputError, require_kind
from lbacal_core.grids import Floats, interpolate
from lbacal_core.instrument.matching import (
    Impedance,
    interpolate_impedance,
    length_gain,
    match_noise,
    match_power,
    read_impedance,
    require_passive,
    turn_reflection,
)
from lbacal_core.instrument.stages import FREE, gain_behind, interpolate_gain, read_touchstone_gain, require_chain
from lbacal_core.instrument.stages import Stage as CoreStage

T = TypeVar("T", np.float64, np.complex128)


@dataclass(frozen=True)
class Stage:
    """One stage of a chain with its noise (docs/how-to/describe-your-chain.md).

    Attributes
    ----------
    kind
        antenna, ground, ice, load, lna, cable, filter, amplifier or adc.
    gain
        Power gain: a factor, a Quantity in dB, a table (frequency, gain), a function of the frequency in MHz such as
        `mismatch`, or the name of a Touchstone file; None for what has none, and for the cable of `Chain`.
    noise
        Noise temperature at the input, K: a number, a table (frequency, temperature), or a function of the frequency in
        MHz such as `lna_noise`; ``"free"`` where the data determine it; None for no noise.
    error
        Standard deviation of a known noise temperature, K.
    solid_angle
        Integral of D over a ground or ice, sr.
    name
        The name of its noise constant; the kind, unless given.
    """

    kind: str
    gain: Any = None
    noise: Any = None
    error: Any = 0.0
    solid_angle: Any = 1.0
    name: str | None = None

    def on_channels(self, frequency_mhz: Floats) -> CoreStage:
        """The stage with its tables on the channels of an instrument."""
        is_free = isinstance(self.noise, str) and self.noise == FREE
        noise = (
            None if self.noise is None or is_free else spread_numbers(self.noise, u.K, frequency_mhz, "chain: noise")
        )
        stage = CoreStage(
            name=self.name or self.kind,
            kind=self.kind,
            gain=None if self.gain is None else convert_gain(self.gain, frequency_mhz),
            noise_k=noise,
            is_free=is_free,
            error_k=convert_number(self.error, u.K),
            solid_angle_sr=convert_number(self.solid_angle, u.sr),
        )
        stage.require_whole(f"chain: stage {stage.name!r}")
        return stage


@dataclass(frozen=True)
class Chain:
    """The signal chain after the antenna: a list of stages, each a power gain, or a `Stage` with its noise.

    Attributes
    ----------
    stages
        In the order of the signal, each a gain as `Stage.gain`, or a `Stage`; none for a flat receiver. Where one is a
        `Stage`, bare gains among them are filters without noise.
    cable
        L_coax, a gain of at most 1.
    kelvin_error
        Error of a receiver that is calibrated in kelvin, a fraction of the power; None for spectra in ADC units.
    """

    stages: Sequence[Any] = ()
    cable: Any = 1.0
    kelvin_error: float | None = None

    def core_stages(self, frequency_mhz: Floats) -> tuple[CoreStage, ...]:
        """The stages on the channels; none where no stage says anything of its noise."""
        require_kind("chain: stages", self.stages, list | tuple, "a list of stages, such as [20 * u.dB]")
        if not any(isinstance(one, Stage) for one in self.stages):
            return ()
        made = tuple(
            (one if isinstance(one, Stage) else Stage("filter", one, name=f"gain {k}")).on_channels(frequency_mhz)
            for k, one in enumerate(self.stages)
        )
        require_chain(made, "chain: stages")
        return made

    def receiver_gain(self, frequency_mhz: Floats) -> Floats:
        """The product of the gains behind the cable, shape (freq,)."""
        made = self.core_stages(frequency_mhz)
        if made:
            return gain_behind(made, frequency_mhz.size)
        return np.asarray(np.prod([convert_gain(one, frequency_mhz) for one in (1.0, *self.stages)], axis=0))

    def cable_loss(self, frequency_mhz: Floats) -> Floats:
        """Compute L_coax of each cable, shape (freq,)."""
        gains = [one.gain for one in self.core_stages(frequency_mhz) if one.kind == "cable" and one.gain is not None]
        return gains[0] if gains else convert_gain(self.cable, frequency_mhz, largest=1.0)


def convert_gain(gain: Any, frequency_mhz: Floats, largest: float = np.inf) -> Floats:
    """Linear power gain of one stage on the channels, shape (freq,): a factor above 0, and at most the largest."""
    found = _convert_gain(gain, frequency_mhz)
    wrong = found[~((found > 0) & (found <= largest))]
    if wrong.size:
        most = "" if np.isinf(largest) else f" and at most {largest:g}"
        expected = f"a power factor above 0{most}, or decibels such as -20 * u.dB"
        raise BadInputError("chain: gain", expected, f"{wrong[0]:g}")
    return found


def _convert_gain(gain: Any, frequency_mhz: Floats) -> Floats:
    if isinstance(gain, str | Path):
        return read_touchstone_gain(Path(gain), frequency_mhz)
    return _spread(gain, _linear, frequency_mhz, "chain: gain", interpolate_gain)


def mismatch(antenna: Any, load: Any = 50.0, off: complex = 0.0) -> Callable[[Floats], Floats]:
    """The share of an antenna's available power that the receiver takes: the gain of a stage of the kind ``load``.

    Parameters
    ----------
    antenna, load
        Impedances: ohm, complex or a Quantity; a table (frequency, impedance); a function of the frequency in MHz; or
        the name of a Touchstone file, of which S11 counts (.s1p, or .s2p of an amplifier).
    off
        By what fraction of itself the antenna's reflection to 50 ohm is off: 0.05 is 5 % in size, 0.05j in phase
        (`Instrument.with_alternative`).

    Examples
    --------
    >>> import lbacal
    >>> import numpy as np
    >>> float(lbacal.mismatch(antenna=73 + 42.5j)(np.array([55.0]))[0].round(4))
    0.8621
    """
    return lambda nu: match_power(_antenna(antenna, nu, off), _impedance(load, nu, "load"))


def effective_length(length: Any, antenna: Any, off: complex = 0.0) -> Callable[[Floats], Floats]:
    """The `gain` of an `Antenna` by its effective length, m^2: what is available in front of the mismatch.

    Parameters
    ----------
    length
        Open-circuit voltage over a field along the arm from the zenith, m: a number, a table (frequency, length), or a
        function of the frequency in MHz. With a `mismatch` behind it the loaded voltage is recorded.
    antenna, off
        Its impedance, as in `mismatch`.

    Examples
    --------
    >>> import lbacal
    >>> import numpy as np
    >>> float(lbacal.effective_length(1.5, antenna=75.0)(np.array([55.0]))[0])
    0.375
    """
    return lambda nu: length_gain(spread_numbers(length, u.m, nu, "antenna: length"), _antenna(antenna, nu, off))


def lna_noise(
    antenna: Any, minimum: Any, resistance: Any, optimum: Any, off: complex = 0.0
) -> Callable[[Floats], Floats]:
    """The noise of an amplifier at an antenna, from its noise parameters: that of the stage of the kind ``load``.

    Parameters
    ----------
    antenna, off, optimum
        Impedance of the antenna, and the one at which the amplifier is least noisy, as in `mismatch`.
    minimum
        Noise temperature at the optimum, K.
    resistance
        R_n, ohm.

    Examples
    --------
    >>> import lbacal
    >>> import numpy as np
    >>> best = lbacal.lna_noise(antenna=100.0, minimum=60.0, resistance=8.0, optimum=100.0)
    >>> float(best(np.array([55.0]))[0])
    60.0
    """

    def temperature(nu: Floats) -> Floats:
        seen, best = _antenna(antenna, nu, off), _impedance(optimum, nu, "optimum")
        return match_noise(seen, convert_number(minimum, u.K), convert_number(resistance, u.ohm), best)

    return temperature


def _antenna(given: Any, frequency_mhz: Floats, off: complex) -> Impedance:
    return turn_reflection(_impedance(given, frequency_mhz, "antenna"), off, "chain: impedance of antenna")


def _impedance(given: Any, frequency_mhz: Floats, name: str) -> Impedance:
    place = f"chain: impedance of {name}"
    if isinstance(given, str | Path):
        return read_impedance(Path(given), frequency_mhz)
    read = partial(convert_numbers, unit=u.ohm, kind=complex)
    return require_passive(_spread(given, read, frequency_mhz, place, interpolate_impedance), place)


def _spread(
    given: Any, read: Callable[[Any], NDArray[T]], frequency_mhz: Floats, place: str, between: Callable[..., NDArray[T]]
) -> NDArray[T]:
    """A number, one a channel, a table (frequency, number) or a function of the frequency in MHz, shape (freq,)."""
    if isinstance(given, tuple) and len(given) == 2:
        return between(convert_numbers(given[0], u.MHz), read(given[1]), frequency_mhz, place)
    found = read(given(frequency_mhz) if callable(given) else given)
    if found.shape not in ((), (1,), frequency_mhz.shape):
        raise BadInputError(place, f"one number, or one of each of {frequency_mhz.size} channels", f"{found.size}")
    return np.broadcast_to(found, frequency_mhz.shape).copy()


def spread_numbers(given: Any, unit: u.UnitBase, frequency_mhz: Floats, place: str) -> Floats:
    """Numbers in a unit on the channels, shape (freq,)."""
    return _spread(given, partial(convert_numbers, unit=unit), frequency_mhz, place, interpolate)


def _linear(gain: Any) -> Floats:
    """A power gain, linear or in dB, as a linear one."""
    if isinstance(gain, u.Quantity) and gain.unit == u.dB:
        return np.asarray(10.0 ** (np.asarray(gain.value, dtype=float) / 10.0))
    try:
        return np.asarray(u.Quantity(gain, u.dimensionless_unscaled).value, dtype=float)
    except (u.UnitsError, TypeError, ValueError) as error:
        raise BadInputError("chain: gain", "a power factor, or decibels such as -20 * u.dB", repr(gain)) from error
