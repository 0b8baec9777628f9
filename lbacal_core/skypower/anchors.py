"""How hot the sky was measured to be: experiments against a sky model, their mean, each predicted by the others."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from lbacal_core.antenna.ideal import ShortDipole
from lbacal_core.antenna.model import AntennaModel
from lbacal_core.grids import Floats
from lbacal_core.linear import invert_symmetric
from lbacal_core.sky.frames import DATA_EPOCH
from lbacal_core.sky.measured import PIVOT_MHZ, SkyLevel
from lbacal_core.sky.model import SkyModel
from lbacal_core.sky.multipoles import precess_multipoles
from lbacal_core.sky.names import load_sky
from lbacal_core.skypower.modes import beam_multipoles, beam_on_equator

SCATTERS = np.linspace(0.0, 0.3, 121)
"""Scatter between families in ln T, beyond the stated errors, over which the result is averaged."""
SCATTER_PRIOR = 0.06
"""Its half-normal prior: half of the 12 % by which seven sky models differ (Buesken et al. 2023, arXiv 2211.03086)."""
SLOPE_PRIOR = 0.3
"""Spectral indices of sky models differ by less than 0.3; keeps single-frequency experiments from being degenerate."""


@dataclass(frozen=True)
class Anchor:
    """What one experiment says of the absolute brightness of the sky.

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


def dipole_temperature(
    sky: SkyModel,
    antenna: AntennaModel,
    frequency_mhz: Floats,
    latitude_deg: float,
    lst_hours: Floats,
    arm: float = 0.0,
) -> Floats:
    """Brightness averaged over the response of a dipole, shape (lst, freq), K."""
    beam = beam_multipoles(antenna, frequency_mhz, sky.lmax)
    seen = beam_on_equator(beam, arm, latitude_deg)
    modes = np.einsum("flm,flm->mf", precess_multipoles(extended_temperature(sky, frequency_mhz), DATA_EPOCH), seen)
    order = np.arange(modes.shape[0])
    phase = np.exp(1j * np.pi / 12.0 * np.outer(lst_hours, order)) * np.where(order == 0, 1.0, 2.0)
    return np.asarray((phase @ modes).real / (np.sqrt(4 * np.pi) * beam[:, 0, 0].real))


def mean_temperature(sky: SkyModel, antenna: AntennaModel, frequency_mhz: Floats, latitude_deg: float) -> Floats:
    """Its mean over the sidereal day, shape (freq,), K."""
    return np.asarray(dipole_temperature(sky, antenna, frequency_mhz, latitude_deg, np.arange(24.0)).mean(axis=0))


def extended_temperature(sky: SkyModel, frequency_mhz: Floats) -> Any:
    """Multipoles of the brightness; above the range of the model a power law with the index at its end."""
    low, end = sky.frequency_mhz[-2:]
    inside = sky.temperature(np.minimum(frequency_mhz, end))
    first, last = sky.temperature(np.array([low, end]))[:, 0, 0].real
    index = np.log(last / first) / np.log(end / low)
    return inside * (np.maximum(frequency_mhz, end) / end)[:, None, None] ** index


def combine_anchors(anchors: Sequence[Anchor], base: SkyModel) -> SkyLevel:
    """Level and slope of the sky by generalised least squares, averaged over the scatter between families."""
    ratio, design, stated, between = _system(anchors, base)
    found, weights = [], []
    for scatter in SCATTERS:
        mean, covariance, ln_likelihood = _solve(ratio, design, stated + scatter**2 * between)
        found.append((mean, covariance))
        weights.append(ln_likelihood - 0.5 * (scatter / SCATTER_PRIOR) ** 2)
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


@dataclass(frozen=True)
class LeftOut:
    """A family, and what the others say of it: ln T over that of the sky model, weighted mean of its frequencies."""

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
        ratio, design, stated, _ = _system(own, base)
        weight = invert_symmetric(stated).sum(axis=1)
        weight /= weight.sum()
        row = weight @ design
        variance = weight @ stated @ weight + row @ level.covariance @ row + level.scatter**2
        predicted = float(row @ [level.level, level.slope])
        lines.append(LeftOut(family, float(weight @ ratio), predicted, float(np.sqrt(variance))))
    return lines


def _system(anchors: Sequence[Anchor], base: SkyModel) -> tuple[Floats, Floats, Floats, Floats]:
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
    stated = np.outer(error, error) * shared + block_diag(*blocks)
    return ratio, design, stated, shared


def _solve(ratio: Floats, design: Floats, covariance: Floats) -> tuple[Floats, Floats, float]:
    """Level and slope, their covariance, and ln of the likelihood with both integrated out."""
    weight = invert_symmetric(covariance)
    precision = design.T @ weight @ design + np.diag([0.0, SLOPE_PRIOR**-2])
    inverse = invert_symmetric(precision)
    mean = inverse @ (design.T @ weight @ ratio)
    left = ratio - design @ mean
    chi2 = left @ weight @ left + (mean[1] / SLOPE_PRIOR) ** 2
    log_determinants = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(precision)[1]
    return mean, inverse, float(-0.5 * (chi2 + log_determinants))
