"""What makes a measured power scatter about its expectation: radiometer noise and the gain of single events."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lbacal_core.grids import Floats
from lbacal_twin.settings import TwinSettings


def draw_scatter(
    settings: TwinSettings,
    blocks: NDArray[np.int64],
    channels: int,
    rng: np.random.Generator,
    sky_correlation: float = 0.0,
) -> Floats:
    """Draw what scatters a measured power about its expectation, as a factor of mean 1.

    A power averaged over n independent samples follows a gamma distribution of shape n; the gain of an event is flat
    along frequency. Antennas that see the same sky share a part `sky_correlation` of the radiometer variance.

    Returns
    -------
    Shape (antenna, dipole, event, freq).
    """
    antennas, dipoles, events = blocks.shape
    variance = settings.radiometer**2 * 100.0 / blocks[..., None]
    own = (1.0 - sky_correlation) * variance
    if settings.radiometer > 0:
        scatter = rng.standard_gamma(np.broadcast_to(1.0 / own, (*blocks.shape, channels)))
        scatter *= own
    else:
        scatter = np.ones((*blocks.shape, channels))
    if sky_correlation > 0:
        scatter *= 1.0 + np.sqrt(sky_correlation * variance) * rng.normal(size=(1, dipoles, events, channels))
    scatter *= 1.0 + settings.event_gain_common * rng.normal(size=(1, 1, events, 1))
    scatter *= 1.0 + settings.event_gain_path * rng.normal(size=(antennas, dipoles, events, 1))
    return scatter
