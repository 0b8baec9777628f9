"""Each family of experiments predicted by all others: whether their stated errors and their scatter tell the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lbacal_core.linear import invert_symmetric
from lbacal_core.sky.model import SkyModel
from lbacal_core.sky.sky_terms import Anchor, combine_anchors, stack_anchors


@dataclass(frozen=True)
class LeftOut:
    """A family of experiments and its prediction by the others: ln T over the sky model's, mean of its frequencies."""

    family: str
    measured: float
    predicted: float
    sigma: float

    @property
    def pull(self) -> float:
        """Measured less predicted over the standard deviation of the difference."""
        return (self.measured - self.predicted) / self.sigma

    def __str__(self) -> str:
        """One line of the table."""
        return f"{self.family}: {self.measured:+.3f}, predicted {self.predicted:+.3f} +- {self.sigma:.3f}"


def predict_left_out(anchors: Sequence[Anchor], base: SkyModel) -> list[LeftOut]:
    """Each family predicted by all others; sigma holds its own error, that of the prediction and the scatter."""
    lines = []
    for family in dict.fromkeys(anchor.family for anchor in anchors):
        own = [anchor for anchor in anchors if anchor.family == family]
        level = combine_anchors([anchor for anchor in anchors if anchor.family != family], base)
        ratio, design, stated, _ = stack_anchors(own, base)
        weight = invert_symmetric(stated).sum(axis=1)
        weight /= weight.sum()
        row = weight @ design
        variance = weight @ stated @ weight + row @ level.covariance @ row + level.scatter**2
        predicted = float(row @ [level.level, level.slope])
        lines.append(LeftOut(family, float(weight @ ratio), predicted, float(np.sqrt(variance))))
    return lines
