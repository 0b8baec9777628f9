"""Electronic noise in an LST curve, over the mean sky power of its band: what is known before the points are fitted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lbacal_core.data.lofar import DIPOLES, SUPERTERP
from lbacal_core.data.tables import read_table
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.instrument import Instrument
from lbacal_core.lstcurve.compare import published_noise_share
from lbacal_core.skypower.variation import vary_sky_power

SKY_SCALE = 0.23
"""Relative error of the simulated sky power to which the published noise is referred (Mulrey et al. 2019, Table 1)."""
LARGEST_RATIO = 99.0
"""Noise over sky of a noise share of 0.99."""


@dataclass(frozen=True)
class NoisePrior:
    """Electronic noise over the mean sky power of the band, the same for both polarisations.

    Attributes
    ----------
    mean, sigma
        `sigma` is infinite where nothing is known but that the noise share lies between 0 and 1.
    stages
        Power of LNA, receiver and digitiser at the output, shape (stage, freq), in any common unit.
    """

    mean: float
    sigma: float
    stages: Floats

    @property
    def is_known(self) -> bool:
        """Whether anything is known of the noise."""
        return bool(np.isfinite(self.sigma))


def noise_prior(instrument: Instrument, band_mhz: tuple[float, float], weights: Floats) -> NoisePrior:
    """What is published of the noise of an instrument; nothing, for any but the Superterp.

    The published noise was fitted against a sky power whose integral has a cosine of the zenith angle too many
    (docs/explanation/what-the-simulation-gets-wrong.md). Against our integral, which is larger, the ratio is smaller by
    the ratio of the two integrals. That cosine is an inference from published code: the standard deviation contains
    the whole change, beside the error of the sky's scale.

    Parameters
    ----------
    weights
        Weight of every channel in the band power, shape (freq,).
    """
    share = published_noise_share(band_mhz)
    lna_alone = np.stack([weights, 0.0 * weights, 0.0 * weights])
    if instrument.name != SUPERTERP or share is None:
        return NoisePrior(0.5, np.inf, lna_alone)
    try:
        own, narrow = (vary_sky_power(instrument, zenith_exponent=exponent) for exponent in (0.0, 1.0))
    except BadInputError:
        return NoisePrior(0.5, np.inf, lna_alone)
    cosine = float(np.mean([np.sum(narrow.power[d] @ weights) / np.sum(own.power[d] @ weights) for d in DIPOLES]))
    mean = cosine * share / (1.0 - share)
    terms = read_table("noise_terms")
    shapes = np.stack([weights, instrument.receiver_gain * (weights > 0), 1.0 * (weights > 0)])
    at_input = [np.interp(instrument.frequency_mhz, terms["mhz"], terms[stage]) for stage in ("lna", "rcu", "adc")]
    levels = (np.stack(at_input) * weights).sum(axis=1) / shapes.sum(axis=1)
    return NoisePrior(mean, mean * float(np.hypot(SKY_SCALE, 1.0 - cosine)), levels[:, None] * shapes)
