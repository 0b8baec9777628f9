"""Causes in the cables that are constant in time: only a comparison of antennas, or of cable names, shows them.

The antennas of a station share A(nu), so that a departure of one antenna's front gain along frequency is visible
beside it. An antenna is compared with others of its cable name alone: the noise of the common event gain moves the
slopes of short and long cables apart, all together and far beyond the error of each. A whole cable name is compared
with the others by its length, that noise known.
`AntennaTemplate` gives the departure of ln C^-2 = ln (A L_coax G_RCU S) that a cause makes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lbacal_core.causes.cause import Description
from lbacal_core.grids import Floats, guess_widths

FEWEST_CHANNELS = 8
FEWEST_PERIODS = 1.5
"""Periods of a ripple within the band, below which it cannot be told from a slope."""
EVEN_MHZ = 1e-6
SMALLEST_RIPPLE = 1e-3
"""Amplitude in the channels of a ripple of amplitude 1, below which it is none: its size would be a rounding error over
another, and was once named with 3e11."""


@dataclass(frozen=True)
class AntennaTemplate:
    """A departure of the log front gain per unit of size, shape (freq,), and its parameters."""

    parameters: dict[str, float]
    departure: Floats


@dataclass(frozen=True)
class AntennaCause(Description):
    """A cause that is constant in time: a comparison with other antennas of the same cable name shows it.

    Attributes
    ----------
    is_beside_smooth
        Whether it is looked for beside departures that are smooth along frequency, as all antennas have them. A cause
        that is smooth itself is not: it must be larger than those of the others.
    """

    scopes: Sequence[str] = ("antenna",)
    axes: Sequence[str] = ("antenna", "frequency")
    is_beside_smooth: bool = False

    def templates(self, frequency_mhz: Floats, log_loss_per_metre: Floats | None) -> list[AntennaTemplate]:
        """The departures to be tried; empty where these cables can show none."""
        raise NotImplementedError

    def finer_templates(self, template: AntennaTemplate, frequency_mhz: Floats) -> list[AntennaTemplate]:  # noqa: ARG002
        """Departures about one that was found."""
        return [template]

    def free_forms(self, template: AntennaTemplate, frequency_mhz: Floats) -> list[Floats]:  # noqa: ARG002
        """Forms of the cause about a template, each the departures whose amounts are free, shape (departure, freq)."""
        return [template.departure[None]]

    def note(self, parameters: Mapping[str, float], size: float) -> str:  # noqa: ARG002
        """A remark on the meaning of the size."""
        return ""


@dataclass(frozen=True)
class CableLength(AntennaCause):
    """The length on record is wrong."""

    identifier: str = "cable_length"
    unit: str = "m"
    meaning: str = "the length of the cable on record is wrong"
    confirm: str = "measure the delay of the cable, or compare with the delays of the station calibration"
    needs: str = "the names of the cables are not lengths in m"
    scopes: Sequence[str] = ("antenna", "cable")

    def templates(self, frequency_mhz: Floats, log_loss_per_metre: Floats | None) -> list[AntennaTemplate]:
        """Ln L_coax of one more metre, of an antenna against its cable name or of a name against the others."""
        return [] if log_loss_per_metre is None else [AntennaTemplate({}, log_loss_per_metre + 0.0 * frequency_mhz)]

    def note(self, parameters: Mapping[str, float], size: float) -> str:
        """Which cable it may be as well."""
        if "or_size" not in parameters:
            return ""
        return f"Only two cable names are compared: {-size:.2g} m more of the other one would look the same."


@dataclass(frozen=True)
class CableReflection(AntennaCause):
    """A mismatch at both ends of the cable makes a ripple in frequency."""

    identifier: str = "cable_reflection"
    unit: str = "amplitude of the ripple in power"
    meaning: str = "a reflection in the cable makes a ripple in frequency"
    confirm: str = "look for the echo in the autocorrelation of a trace, or reconnect the plug"
    is_beside_smooth: bool = True

    def templates(self, frequency_mhz: Floats, log_loss_per_metre: Floats | None) -> list[AntennaTemplate]:  # noqa: ARG002
        """Ripples of each delay and four phases, whose negatives are the other four."""
        if frequency_mhz.size < FEWEST_CHANNELS:
            return []
        phases = (0.0, 45.0, 90.0, 135.0)
        ripples = [_ripple(delay, phase, frequency_mhz) for delay in _delays_us(frequency_mhz) for phase in phases]
        return [one for one in ripples if _is_seen(one)]

    def finer_templates(self, template: AntennaTemplate, frequency_mhz: Floats) -> list[AntennaTemplate]:
        """Delays between those that were tried, and phases all around."""
        delays = template.parameters["delay_us"] + _step_us(frequency_mhz) * np.arange(-0.8, 1.0, 0.2)
        delays = delays[delays >= 2 * FEWEST_PERIODS * _step_us(frequency_mhz) - 1e-6]
        phases = np.arange(0.0, 360.0, 15.0)
        ripples = [_ripple(delay, phase, frequency_mhz) for delay in delays.tolist() for phase in phases.tolist()]
        return [one for one in ripples if _is_seen(one)]

    def free_forms(self, template: AntennaTemplate, frequency_mhz: Floats) -> list[Floats]:
        """Ripples of any amplitude and phase, of delays closer than those of `finer_templates`."""
        delays = template.parameters["delay_us"] + _step_us(frequency_mhz) * np.linspace(-0.2, 0.2, 9)
        return [
            np.stack([_ripple(delay, phase, frequency_mhz).departure for phase in (0.0, 90.0)])
            for delay in delays.tolist()
        ]

    def note(self, parameters: Mapping[str, float], size: float) -> str:
        """What else would look the same in even channels."""
        if "or_delay_us" not in parameters:
            return ""
        delay, other = parameters["delay_us"], parameters["or_delay_us"]
        width = 1.0 / (delay + other)
        larger = size * float(np.sinc(delay * width) / np.sinc(other * width))
        return (
            f"Channels of {width:.3g} MHz show the same of a delay of {other:.3g} us with an amplitude of {larger:.2g}."
        )


def _ripple(delay_us: float, phase_deg: float, frequency_mhz: Floats) -> AntennaTemplate:
    """A ripple of amplitude 1, as channels show it: their width damps it.

    In even channels a delay and its complement to one over their distance make the same ripple (``or_delay_us``).
    """
    wave = np.cos(2 * np.pi * delay_us * frequency_mhz - np.radians(phase_deg))
    parameters = {"delay_us": delay_us, "phase_deg": phase_deg}
    spacing = np.diff(frequency_mhz)
    if np.ptp(spacing) < EVEN_MHZ:
        parameters["or_delay_us"] = 1.0 / float(spacing.mean()) - delay_us
    return AntennaTemplate(parameters, np.sinc(delay_us * guess_widths(frequency_mhz)) * wave)


def _is_seen(ripple: AntennaTemplate) -> bool:
    """Whether channels show a ripple: at half a period a channel, one phase is zero in each, but for rounding."""
    return bool(np.abs(ripple.departure).max() > SMALLEST_RIPPLE)


def _step_us(frequency_mhz: Floats) -> float:
    """Distance of the delays that are tried: half of what the band resolves."""
    return 0.5 / float(np.ptp(frequency_mhz))


def _delays_us(frequency_mhz: Floats) -> list[float]:
    """Delays that channels tell apart: from some periods in the band to half a period between typical neighbours."""
    step, longest = _step_us(frequency_mhz), 0.5 / float(np.median(np.diff(frequency_mhz)))
    first = 2 * FEWEST_PERIODS * step
    return np.round(np.arange(first, longest + step / 2, step), 6).tolist()  # type: ignore[no-any-return]


def log_loss_per_metre(cables: dict[str, Floats]) -> Floats | None:
    """Change of ln L_coax per metre from cables named by their length (`50`, `50 m`), shape (freq,); else None."""
    try:
        lengths = {name: float(name.removesuffix("m")) for name in cables}
    except ValueError:
        return None
    per_metre = [np.log(loss) / lengths[name] for name, loss in cables.items() if lengths[name] > 0]
    return np.asarray(np.mean(per_metre, axis=0)) if per_metre else None
