"""The terms of eq. full_chain for each class of paths: what a cause changes, and the power that follows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lbacal_core.grids import Floats


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
