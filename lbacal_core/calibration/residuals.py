"""What a fitted curve predicts, term by term."""

from __future__ import annotations

import numpy as np

from lbacal_core.chain.noise import noise_constants
from lbacal_core.curves import CalibrationCurve
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument


def noise_at_input(curve: CalibrationCurve, instrument: Instrument) -> dict[str, Floats]:
    """The noise terms of a fitted curve referred to the start of the chain (Fig. 5 of the paper).

    Each constant divided by what amplifies the sky up to the point where it was fitted: those behind A by
    G_ant / C^2.

    Returns
    -------
    By name of the stage (`lna`, `rcu` and `adc` of a chain without stages), each shape (freq,), in the unit of P_sky;
    `known` is what the instrument states without an error.
    """
    if curve.c is None:
        raise ValueError(f"{curve.name} has no curve")
    slope, noise = instrument.antenna_gain / curve.c**2, noise_constants(instrument)
    value = np.array([curve.parameters[name].value for name in noise.names])
    forms = np.concatenate([noise.front, noise.behind / slope])
    terms = {name.removeprefix("n_"): one for name, one in zip(noise.names, value[:, None] * forms, strict=True)}
    return terms | ({"known": noise.known} if np.any(noise.known) else {})


def predict_power(curve: CalibrationCurve, instrument: Instrument, sky: Floats) -> Floats:
    """Recorded power of a fitted path for a sky power of shape (event, freq)."""
    if curve.c is None:
        raise ValueError(f"{curve.name} has no curve")
    return np.asarray((sky + sum(noise_at_input(curve, instrument).values())) * instrument.antenna_gain / curve.c**2)
