"""Causes in the cables that are static: seen only by comparing an antenna with others of the same cable name.

A(nu) is shared by the antennas of a station, so a static departure of one antenna's front gain along frequency can be
told from it. Antennas of one cable name are not compared with those of another: the noise of the common event gain
moves the slopes of short and long cables apart, all together and far beyond the error of each.
`StaticShape` gives the departure of ln C^-2 = ln (A L_coax G_RCU S) that a cause makes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lbacal_core.grids import Floats

CHANNEL_WIDTH_MHZ = 1.0
DELAYS_US = tuple(np.round(np.arange(0.03, 0.98, 0.02), 3))
"""Delays tried; in channels 1 MHz apart a delay is known modulo 1 us only."""


@dataclass(frozen=True)
class StaticShape:
    """A departure of the log front gain per unit of size, shape (freq,), and its parameters."""

    parameters: dict[str, float]
    departure: Floats


@dataclass(frozen=True)
class CableLength:
    """The length on record is wrong."""

    identifier: str = "cable_length"
    unit: str = "m"
    meaning: str = "the length of the cable on record is wrong"
    confirm: str = "measure the delay of the cable, or compare with the delays of the station calibration"
    scopes: Sequence[str] = ("antenna",)

    def shapes(self, frequency_mhz: Floats, log_loss_per_metre: Floats | None) -> list[StaticShape]:
        """Ln L_coax of one more metre."""
        return [] if log_loss_per_metre is None else [StaticShape({}, log_loss_per_metre + 0.0 * frequency_mhz)]

    def why_not(self, log_loss_per_metre: Floats | None) -> str | None:
        """Needs cables whose names are their lengths."""
        return "the names of the cables are not lengths in m" if log_loss_per_metre is None else None


@dataclass(frozen=True)
class CableReflection:
    """A mismatch at both ends of the cable makes a ripple in frequency."""

    identifier: str = "cable_reflection"
    unit: str = "amplitude of the ripple in power"
    meaning: str = "a reflection in the cable makes a ripple in frequency"
    confirm: str = "look for the echo in the autocorrelation of a trace, or reconnect the plug"
    scopes: Sequence[str] = ("antenna",)

    def shapes(self, frequency_mhz: Floats, log_loss_per_metre: Floats | None) -> list[StaticShape]:  # noqa: ARG002
        """Cosine and sine of each delay, damped by the channel width."""
        shapes = []
        for delay in DELAYS_US:
            damping = np.sinc(delay * CHANNEL_WIDTH_MHZ)
            for phase_deg in (0.0, 90.0):
                ripple = damping * np.cos(2 * np.pi * delay * frequency_mhz - np.radians(phase_deg))
                shapes.append(StaticShape({"delay_us": float(delay), "phase_deg": phase_deg}, ripple))
        return shapes

    def why_not(self, log_loss_per_metre: Floats | None) -> str | None:  # noqa: ARG002
        """Any band can show it for one antenna or cable name; a ripple of all antennas is absorbed by A(nu)."""
        return None


def log_loss_per_metre(cables: dict[str, Floats]) -> Floats | None:
    """Change of ln L_coax per metre from cables named by their length in m, shape (freq,); None for other names."""
    try:
        lengths = {name: float(name) for name in cables}
    except ValueError:
        return None
    per_metre = [np.log(loss) / lengths[name] for name, loss in cables.items() if lengths[name] > 0]
    return np.asarray(np.mean(per_metre, axis=0)) if per_metre else None
