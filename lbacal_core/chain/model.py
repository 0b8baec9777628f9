"""The signal chain, from sky power to recorded power and to the calibration factor.

`chain_power` is eq. full_chain of Mulrey et al. 2019 written out, the oracle of `chain.terms.ChainTerms.power` and of
every fast path. At one frequency it is a straight line in P_sky, which is what the fit works with:

    P = s P_sky + b,    s = G_ant A L_coax G_RCU S,    b = N_LNA s + N_RCU S G_RCU + N_ADC.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lbacal_core.grids import Floats


def chain_power(
    sky_power: Floats,
    *,
    antenna_gain: Floats,
    correction: Floats,
    cable_loss: Floats,
    receiver_gain: Floats,
    scale: float,
    n_lna: float,
    n_rcu: float,
    n_adc: float,
) -> Floats:
    """Simulated recorded power P_sim,3 (eq. full_chain).

    Parameters
    ----------
    sky_power
        P_sky, shape (..., freq), W m^-2 MHz^-1 for D = 1 at zenith.
    antenna_gain, correction, cable_loss, receiver_gain
        G_ant (m^2), A, L_coax, G_RCU, shape (freq,), linear power.
    scale
        S, ADC^2/Ohm per W.
    n_lna, n_rcu, n_adc
        The noise constants, each in the unit of the point where it enters: that of P_sky, W/MHz, ADC^2/Ohm/MHz.

    Returns
    -------
    Shape (..., freq), ADC^2/Ohm/MHz.
    """
    behind_cable = (sky_power + n_lna) * antenna_gain * correction * cable_loss
    return np.asarray((behind_cable + n_rcu) * receiver_gain * scale + n_adc)


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
