"""Oracles, slow and obvious: eq. full_chain of Mulrey et al. 2019 written out, and the ledger asked one by one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from lbacal_core.antenna.model import AntennaModel
from lbacal_core.antenna.varied import on_hemisphere
from lbacal_core.curves.validity import Instant, Promotion, Scope
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


def beam_solid_angle(antenna: AntennaModel, frequency_mhz: Floats) -> Floats:
    """Integral of D over the hemisphere, shape (freq,), sr."""
    response, weight, _ = on_hemisphere(antenna, frequency_mhz)
    return np.asarray((response * weight).sum(axis=(1, 2)))


def newest_covering(promotions: Iterable[Promotion], instant: Instant) -> Promotion | None:
    """The promotion of one scope that decides at an instant."""
    covering = (promotion for promotion in promotions if promotion.covers(instant))
    return max(covering, key=lambda promotion: (promotion.at, promotion.number), default=None)


def answer_path(promotions: Sequence[Promotion], path: Scope, instant: Instant) -> Promotion | None:
    """The promotion that answers for a path at an instant: the narrowest scope with a version in effect."""
    for scope in path.widening:
        decisive = newest_covering((p for p in promotions if p.scope == scope), instant)
        if decisive is not None and decisive.calibration is not None:
            return decisive
    return None
