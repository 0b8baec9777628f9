"""What the intercept of a line is made of: b = (known + n F) s + q H, with the noise in front of A and behind it.

Noise that enters in front of the free response A(nu) is multiplied by the slope s, as the sky is; noise that enters
behind it is not. Each row of F and H is what one constant adds per unit along frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.grids import Floats

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

    def split_behind(self, q: Floats) -> tuple[Floats, Floats]:
        """The noise of the receiver and that of the converter, shape (freq,) each, for constants behind, shape (k,)."""
        of_receiver = len(q) - self.ends_in_adc
        return q[:of_receiver] @ self.behind[:of_receiver], q[of_receiver:] @ self.behind[of_receiver:]

    def select(self, channels: NDArray[Any]) -> Intercepts:
        """The same on some of the channels."""
        return Intercepts(
            self.names, self.front[:, channels], self.behind[:, channels], self.known[channels],
            self.mean, self.precision, self.units, self.ends_in_adc,
        )  # fmt: skip


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
