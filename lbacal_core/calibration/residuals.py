"""What a fitted curve predicts, term by term."""

from __future__ import annotations

import numpy as np

from lbacal_core.curves import CalibrationCurve
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument


def noise_at_input(curve: CalibrationCurve, instrument: Instrument) -> dict[str, Floats]:
    """The noise terms of a fitted curve referred to the start of the chain (Fig. 5 of the paper).

    Each constant divided by what amplifies the sky up to the point where it was fitted: N_RCU S G_RCU and N_ADC by
    G_ant / C^2.

    Returns
    -------
    `lna`, `rcu` and `adc`, each shape (freq,), in the unit of P_sky.
    """
    if curve.c is None:
        raise ValueError(f"{curve.name} has no curve")
    slope = instrument.antenna_gain / curve.c**2
    return {
        "lna": np.full_like(slope, curve.parameters["n_lna"].value),
        "rcu": curve.parameters["n_rcu"].value * instrument.receiver_gain / slope,
        "adc": curve.parameters["n_adc"].value / slope,
    }


def predict_power(curve: CalibrationCurve, instrument: Instrument, sky: Floats) -> Floats:
    """Recorded power of a fitted path for a sky power of shape (event, freq)."""
    if curve.c is None:
        raise ValueError(f"{curve.name} has no curve")
    return np.asarray((sky + sum(noise_at_input(curve, instrument).values())) * instrument.antenna_gain / curve.c**2)
