"""The noise of background spectra: independent in each channel, plus a gain that each event shares along frequency.

The relative deviation of event i in channel f from its model has the covariance

    C_i = k_i diag(sigma_f^2) + sigma_g^2 1 1^T,

radiometer noise (k_i: its variance against that of the typical number of blocks) and a gain that fluctuates from event
to event and multiplies the whole recorded power. Both levels are estimated from the data.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lbacal_core.grids import Floats


@dataclass(frozen=True)
class NoiseLevels:
    """Levels of the relative noise of paths.

    Attributes
    ----------
    radiometer
        Shape (path, freq), standard deviation at the typical number of blocks.
    event_gain
        Shape (path,), standard deviation of the gain common to all channels of an event.
    """

    radiometer: Floats
    event_gain: Floats

    def shared_weight(self, relative_variance: Floats) -> Floats:
        """The c_i of C_i^-1 = V_i - c_i V_i 1 1^T V_i (Sherman-Morrison), V_i = diag(sigma_f^-2) / k_i.

        Shape (path, event), for the variance factors k_i, shape (path, event), infinite where there is no spectrum.
        """
        variance = self.event_gain[:, None] ** 2
        return np.asarray(
            variance / (1.0 + variance * np.sum(self.radiometer**-2, axis=1)[:, None] / relative_variance)
        )


def estimate_noise_levels(residual: Floats, relative_variance: Floats, fitted_per_channel: int) -> NoiseLevels:
    """Estimate the levels from relative residuals of a fit that is linear in each channel.

    In each event the mean over channels, weighted by the inverse radiometer variances, keeps the gain plus
    1/sum(1/sigma_f^2); what differs from it keeps sigma_f^2 less the same amount. Two rounds reach the precision of
    the weights themselves.

    Parameters
    ----------
    residual
        Relative residuals, shape (path, event, freq); any finite number where absent.
    relative_variance
        k_i, shape (path, event); infinite where absent.
    fitted_per_channel
        Parameters that the fit spent on each channel.
    """
    is_present = np.isfinite(relative_variance)
    dof = np.maximum(is_present.sum(axis=1) - fitted_per_channel, 1)
    inverse_variance = np.where(is_present, 1.0 / relative_variance, 0.0)
    mean_variance = np.where(is_present, relative_variance, 0.0).sum(axis=1) / np.maximum(is_present.sum(axis=1), 1)
    weight = np.ones((residual.shape[0], residual.shape[2]))
    squares = np.matmul(inverse_variance[:, None, :], residual**2)[:, 0, :]
    for _ in range(2):
        share = weight / weight.sum(axis=1, keepdims=True)
        common = np.matmul(residual, share[:, :, None])[:, :, 0]
        # the sum over events of (r - common)^2 / k
        cross = np.matmul((inverse_variance * common)[:, None, :], residual)[:, 0, :]
        spread = (squares - 2 * cross + np.sum(inverse_variance * common**2, axis=1)[:, None]) / dof[:, None]
        floor = 1.0 / (1.0 / np.maximum(spread, 1e-300)).sum(axis=1)
        variance = np.maximum(spread + floor[:, None], 1e-12)
        weight = 1.0 / variance
    of_mean = np.sum(is_present * common**2, axis=1) / dof
    event_gain = np.sqrt(np.maximum(of_mean - mean_variance / weight.sum(axis=1), 0.0))
    return NoiseLevels(np.sqrt(variance), event_gain)
