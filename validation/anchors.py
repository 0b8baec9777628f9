"""How hot the sky was measured to be: experiments against a sky model, their mean, each predicted by the others."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np
import scipy

from lbacal_core.antenna.ideal import ShortDipole
from lbacal_core.data.tables import read_prior
from lbacal_core.grids import Floats
from lbacal_core.linear import invert_symmetric
from lbacal_core.sky.model import SkyModel
from lbacal_core.sky.names import PIVOT_MHZ, SkyLevel, load_sky
from lbacal_core.sky.sky_terms import mean_temperature

SCATTERS = np.linspace(0.0, 0.3, 121)
"""Scatter between families in ln T, beyond the stated errors, over which the result is averaged."""
SHARE_OF_SCATTER = 0.5
"""Its half-normal prior, as a share of the error of the sky's level."""
SLOPE = 0.3
"""Spectral index: those of sky models differ by less; experiments at one frequency would be degenerate without it."""


@dataclass(frozen=True)
class Anchor:
    """The absolute brightness of the sky by one experiment.

    Attributes
    ----------
    family
        Experiments of one family share receiver and calibration: they are left out together.
    kind
        ``temperature``: mean over LST seen by a dipole; ``map``: a factor and an offset that a sky model needs;
        ``sky``: a sky model of its own.
    latitude_deg, dipole_height_m
        Where the sky is averaged, with a short dipole above a plane as the beam.
    measurement_error, channel_error
        Relative, one standard deviation: shared by the frequencies and by the family, and each frequency's own.
    model_error
        Relative, of evaluating it with a sky model that is not its own.
    """

    experiment: str
    family: str
    kind: str
    latitude_deg: float
    dipole_height_m: float
    frequency_mhz: Floats
    measurement_error: float
    channel_error: float
    model_error: float
    source: str
    temperature_k: Floats | None = None
    scale: float = 1.0
    offset_k: float = 0.0
    sky: str | None = None

    def ln_ratio(self, base: SkyModel) -> Floats:
        """Ln of the measured mean temperature over that of a sky model, shape (freq,)."""
        beam = ShortDipole(self.dipole_height_m)
        model = mean_temperature(base, beam, self.frequency_mhz, self.latitude_deg)
        measured = self.scale * model + self.offset_k if self.temperature_k is None else self.temperature_k
        if self.sky is not None:
            measured = mean_temperature(load_sky(self.sky), beam, self.frequency_mhz, self.latitude_deg)
        return np.asarray(np.log(measured / model))


def read_anchors() -> list[Anchor]:
    """The experiments that ship with the package."""
    rows: list[dict[str, Any]] = json.loads((files("lbacal_core") / "data/sky_anchors.json").read_text())
    for row in rows:
        row["frequency_mhz"] = np.array(row["frequency_mhz"])
        if "temperature_k" in row:
            row["temperature_k"] = np.array(row["temperature_k"])
    return [Anchor(**row) for row in rows]


def combine_anchors(anchors: Sequence[Anchor], base: SkyModel) -> SkyLevel:
    """Level and slope of the sky by generalised least squares, averaged over the scatter between families."""
    ratio, design, stated, between = stack_anchors(anchors, base)
    prior, found, weights = read_prior(), [], []
    for scatter in SCATTERS:
        mean, covariance, ln_likelihood = _solve(ratio, design, stated + scatter**2 * between)
        found.append((mean, covariance))
        weights.append(ln_likelihood - 0.5 * (scatter / (SHARE_OF_SCATTER * prior["sky_level"].size)) ** 2)
    weight = np.exp(np.array(weights) - max(weights))
    weight /= weight.sum()
    means = np.array([mean for mean, _ in found])
    centre = weight @ means
    spread = means - centre
    covariance = np.einsum("k,kij->ij", weight, [c for _, c in found]) + np.einsum(
        "k,ki,kj->ij", weight, spread, spread
    )
    scatter = float(np.sqrt(weight @ SCATTERS**2))
    return SkyLevel(float(centre[0]), float(centre[1]), covariance, scatter)


def stack_anchors(anchors: Sequence[Anchor], base: SkyModel) -> tuple[Floats, Floats, Floats, Floats]:
    """Ln ratios, design (level, slope), stated covariance, and which of them share a family."""
    ratio = np.concatenate([anchor.ln_ratio(base) for anchor in anchors])
    frequency_mhz = np.concatenate([anchor.frequency_mhz for anchor in anchors])
    design = np.stack([np.ones_like(frequency_mhz), np.log(frequency_mhz / PIVOT_MHZ)], axis=1)
    family = np.concatenate([[anchor.family] * anchor.frequency_mhz.size for anchor in anchors])
    shared = (family[:, None] == family[None, :]).astype(float)
    error = np.concatenate([np.full(anchor.frequency_mhz.size, anchor.measurement_error) for anchor in anchors])
    blocks = [
        np.full((one.frequency_mhz.size,) * 2, one.model_error**2)
        + one.channel_error**2 * np.eye(one.frequency_mhz.size)
        for one in anchors
    ]
    stated = np.outer(error, error) * shared + scipy.linalg.block_diag(*blocks)
    return ratio, design, stated, shared


def _solve(ratio: Floats, design: Floats, covariance: Floats) -> tuple[Floats, Floats, float]:
    """Level and slope, their covariance, and ln of the likelihood with both integrated out."""
    weight = invert_symmetric(covariance)
    precision = design.T @ weight @ design + np.diag([0.0, SLOPE**-2])
    inverse = invert_symmetric(precision)
    mean = inverse @ (design.T @ weight @ ratio)
    left = ratio - design @ mean
    chi2 = left @ weight @ left + (mean[1] / SLOPE) ** 2
    log_determinants = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(precision)[1]
    return mean, inverse, float(-0.5 * (chi2 + log_determinants))


# Each family of experiments predicted by all others: whether their stated errors and their scatter tell the truth.


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
