"""What nuisances take: causes that differences between sky models hide, and what the noise's vectors take of each.

With the amounts of the differences free without limit, no information on such a cause is left. What their prior leaves
tells how much models differ, and nothing about the instrument. The noise that events share along frequency takes a part
of the information on every cause, which the report gives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lbacal_core.causes.cause import Cause
from lbacal_core.discovery.correlations import see_best
from lbacal_core.discovery.families import list_families
from lbacal_core.discovery.hypothesis import Target
from lbacal_core.discovery.project import LinearModel

NEARLY_FREE = 1e-4
"""Inverse variance of differences a hundred times as large as those of real models."""


@dataclass(frozen=True)
class HiddenCause:
    """A cause of the whole station that the differences between models describe.

    Attributes
    ----------
    share
        Share of its information that is left under the prior.
    sigma, plain_sigma
        Standard deviation of its size with the differences profiled out, and with the sky taken as exact.
    """

    cause: Cause
    share: float
    sigma: float
    plain_sigma: float

    @property
    def why(self) -> str:
        """The reason in a report."""
        return (
            "the differences between sky and antenna models describe its signature: "
            f"{self.share:.1%} of its information is left, one standard deviation is {self.sigma:.2g} "
            f"({self.cause.unit}) instead of {self.plain_sigma:.2g}; a sky power at its word shows it"
        )


def list_hidden(
    model: LinearModel, causes: Sequence[Cause], target: Target, smallest_share: float
) -> list[HiddenCause]:
    """Causes of the whole station of which free differences leave less than `smallest_share` of the information.

    The shares are computed for the data at hand; the list is empty where the sky power is taken as exact.
    """
    if model.modes is None:
        return []
    # A cause that smooth waves along LST describe shows beside them where it is larger than these.
    known = replace(model, modes=replace(model.modes, waves=None))
    plain, free = replace(model, modes=None), replace(known, modes=replace(model.modes, waves=None, prior=NEARLY_FREE))
    hidden = []
    for cause in causes:
        if cause.scopes != ("station",) or "lst" not in cause.axes:
            continue
        families = list_families(model.station.conditions, [cause])
        seen = [see_best((plain, free, known), family, target) for family in families]
        whole, bare, left = (np.array([one[m].max() for one in seen]) for m in range(3))
        if not whole.size or whole.min() <= 0:
            continue
        # A wider prior leaves less; where it leaves more, that is rounding.
        if np.all(np.minimum(bare, left) < smallest_share * whole):
            best = int(np.argmax(left / whole))
            sigma, plain_sigma = float(left[best] ** -0.5), float(whole[best] ** -0.5)
            hidden.append(HiddenCause(cause, float(left[best] / whole[best]), sigma, plain_sigma))
    return hidden


def shares_taken(model: LinearModel, causes: Sequence[Cause], target: Target) -> dict[str, float]:
    """Share of the information on each cause of the station that the vectors of the noise take."""
    levels = model.residuals.levels
    nothing, of_paths = np.zeros_like(levels.common_sum), np.zeros_like(levels.path_shared)
    plain = model.with_levels(replace(levels, path_shared=of_paths, common_sum=nothing, common_difference=nothing))
    taken = {}
    for cause in causes:
        families = list_families(model.station.conditions, [cause]) if "station" in cause.scopes else []
        if families:
            typical = families[len(families) // 2]
            left, whole = see_best((model, plain), typical, target)
            best = int(np.argmax(whole))
            if whole[best] > 0:
                taken[cause.identifier] = float(1.0 - left[best] / whole[best])
    return taken
