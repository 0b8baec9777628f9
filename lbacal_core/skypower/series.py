"""P_sky on any LST grid as a Fourier series, by least squares.

P(t) = sum over |m| <= M of c_m exp(2 pi i m t / 24 h) is linear in its 2 M + 1 coefficients. A grid determines them if
the error of the series nowhere exceeds a few times that of a value: its variance at t, in units of that of a value, is
b(t)^T (B^T B)^-1 b(t), with b the harmonics and B their values on the grid. On an even grid of T instants it is
(2 M + 1) / T everywhere; where instants are missing it grows without bound.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.linear import pseudo_invert

HARMONICS = 8
"""The LBA sees no more to 0.005 %."""
EVEN_INSTANTS = 96
LARGEST_VARIANCE = 4.0
"""Largest error of the series between instants, in units of the error of a value: it may double."""
SMALLEST_PIVOT = 1e-9
"""Below this share of the largest a direction is not determined at all."""
DAY_HOURS = 24.0


@dataclass(frozen=True)
class HarmonicFit:
    """How a series of harmonics fits a table.

    Attributes
    ----------
    instants, harmonics
        Rows of the table, and M.
    rms, largest
        Relative residual over both dipoles, all instants and channels.
    """

    instants: int
    harmonics: int
    rms: float
    largest: float

    def __str__(self) -> str:
        return (
            f"{self.harmonics} harmonics fitted to {self.instants} uneven instants, "
            f"residual {self.rms:.2%} r.m.s. and {self.largest:.2%} at most"
        )


def make_even(
    place: str, lst_hours: Floats, power: Mapping[str, Floats]
) -> tuple[Floats, dict[str, Floats], HarmonicFit]:
    """Fit a table on uneven instants and evaluate it on even ones.

    Parameters
    ----------
    place
        What the table was read from, for messages.
    lst_hours
        Shape (lst,), hours, rising over at most a sidereal day.
    power
        Shape (lst, freq) for each polarisation.

    Returns
    -------
    Even instants, the power at them, and how well the series fits.
    """
    most, fewest = most_harmonics(lst_hours.size), fewest_harmonics(lst_hours.size)
    size = max(EVEN_INSTANTS, 4 * most)
    even = DAY_HOURS * np.arange(size) / size
    for harmonics in range(most, fewest - 1, -1):
        orthogonal, triangular = np.linalg.qr(_basis(lst_hours, harmonics))
        if np.min(np.abs(np.diag(triangular))) < SMALLEST_PIVOT * np.max(np.abs(np.diag(triangular))):
            continue
        series = _basis(even, harmonics) @ pseudo_invert(triangular)
        if np.max(np.sum(series**2, axis=1)) <= LARGEST_VARIANCE:
            break
    else:
        raise _undetermined(place, lst_hours, fewest)
    fitted, residuals = {}, []
    for dipole, values in power.items():
        projected = orthogonal.T @ values
        residuals.append((orthogonal @ projected / values - 1.0).ravel())
        fitted[dipole] = series @ projected
    residual = np.concatenate(residuals)
    rms, largest = float(np.sqrt(np.mean(residual**2))), float(np.max(np.abs(residual)))
    return even, fitted, HarmonicFit(lst_hours.size, harmonics, rms, largest)


def fewest_harmonics(instants: int) -> int:
    """What the LBA needs, or what so few instants can give at most."""
    return min(HARMONICS, (instants - 1) // 2)


def most_harmonics(instants: int) -> int:
    """One harmonic for four instants, so that half of the values test the series, or what the LBA needs."""
    return max(fewest_harmonics(instants), instants // 4)


def _basis(lst_hours: Floats, harmonics: int) -> Floats:
    """1, cosines and sines, shape (lst, 2 M + 1)."""
    angle = 2.0 * np.pi / DAY_HOURS * np.outer(lst_hours, np.arange(1, harmonics + 1))
    return np.concatenate([np.ones((lst_hours.size, 1)), np.cos(angle), np.sin(angle)], axis=1)


def _undetermined(place: str, lst_hours: Floats, harmonics: int) -> BadInputError:
    """The error that names the widest hole of a grid."""
    steps = np.diff(np.append(lst_hours, lst_hours[0] + DAY_HOURS))
    row = int(np.argmax(steps))
    after = "the last row" if row == lst_hours.size - 1 else f"row {row}"
    return BadInputError(
        f"{place}: lst_hours",
        f"instants that determine {harmonics} harmonics of the sidereal day, one in every "
        f"{DAY_HOURS / (2 * harmonics + 1):.1f} h or so",
        f"{steps[row]:.3g} h without one after {after}",
    )
