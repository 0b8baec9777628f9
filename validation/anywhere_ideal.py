"""How well a fault of a drawn instrument could be seen at best: its ideal SNR, from the twin's truth alone.

An ideal detector knows the template d = P(with) / P(without) - 1 of every path, event and channel, and the noise. It
leaves free what a fit leaves free, N: A(nu) in each channel of a path, and the amounts of a path's noise in front of
the receiver, in it and in the converter. With the covariance V of the noise, its generalised least squares have

    SNR^2 = d' V^-1 d - (N' V^-1 d)' (N' V^-1 N)^-1 (N' V^-1 d).

In an event of the twin's plain campaigns every channel has radiometer noise, every path a gain of its own, and all
paths a common one. V^-1 is then diagonal but for the sums over the channels of a path (Woodbury). No code is shared
with what searches; `validation.hidden.ideal` is the same for the three constants and the nuisances of LOFAR.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lbacal_core.grids import Floats
from lbacal_twin.campaign import DrawnStation, expected_power
from lbacal_twin.faults.fault import Fault
from lbacal_twin.settings import TwinSettings

SMALLEST = 1e-10
"""Share of the largest eigenvalue of N' V^-1 N below which free vectors are combinations of others."""


def ideal_snr(drawn: DrawnStation, faults: Sequence[Fault], settings: TwinSettings) -> float:
    """SNR of faults in a plain campaign of one station."""
    stages, scene = drawn.stages, drawn.scene
    power = expected_power(stages, scene, ())
    shape = (power.shape[0] * power.shape[1], *power.shape[2:])

    def of_paths(values: Floats) -> Floats:
        """Values that broadcast against (antenna, dipole, event, freq), relative to the power, (path, event, freq)."""
        return np.broadcast_to(values / power, power.shape).reshape(shape)

    template = of_paths(expected_power(stages, scene, faults) - power)
    slope = stages.gain * stages.antenna * stages.cable * stages.receiver
    noise = (stages.lna_noise * slope, stages.rcu_noise * stages.receiver, stages.adc_noise)
    constants = np.stack([of_paths(one) for one in noise], axis=1)
    response = of_paths((stages.sky + stages.lna_noise) * slope)
    paths, events, channels = shape
    free = np.zeros((paths, channels + len(noise) + 1, events, channels))
    free[:, np.arange(channels), :, np.arange(channels)] = np.moveaxis(response, 2, 0)
    free[:, channels:-1] = constants
    free[:, -1] = template
    # all inner products at once: of vectors of one path channel by channel, of all through the sums over channels
    gains = settings.event_gain_path**2 * np.eye(paths) + settings.event_gain_common**2
    precision = settings.radiometer**-2
    shared = precision**2 * np.linalg.inv(np.linalg.inv(gains) + channels * precision * np.eye(paths))
    sums = free.sum(axis=3)
    product = -np.einsum("pie,pq,qje->piqj", sums, shared, sums, optimize=True)
    at = np.arange(paths)
    product[at, :, at] += precision * np.einsum("pief,pjef->pij", free, free, optimize=True)
    # the template is one vector of all paths
    of_free = product[:, :-1, :, :-1].reshape(paths * (channels + len(noise)), -1)
    onto = product[:, :-1, :, -1].sum(axis=2).ravel()
    size = np.sqrt(np.maximum(np.diag(of_free), SMALLEST**2))
    solved = np.linalg.pinv(of_free / np.outer(size, size), rcond=SMALLEST, hermitian=True) @ (onto / size)
    return float(np.sqrt(max(product[:, -1, :, -1].sum() - solved @ (onto / size), 0.0)))
