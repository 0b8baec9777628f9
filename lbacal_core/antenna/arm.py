"""Jones terms in somebody else's coordinates, turned so that the arm is where this package expects it.

Other programs count the angle phi counterclockwise seen from above, from an axis of their own. Which way the arm lies
is read from the pattern itself: at zenith a dipole answers to the field along its arm.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lbacal_core.antenna.model import Complexes
from lbacal_core.antenna.table import JonesTable
from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats

LEAST_LINEAR = 0.9
"""Share of the response at zenith along one direction, below which an antenna has no arm."""


def grid_rows(
    place: str, columns: tuple[Floats, Floats, Floats], values: tuple[Complexes, ...]
) -> tuple[list[Floats], list[Complexes]]:
    """Axes and grids of rows in any order: frequency, zenith angle and phi, each once, and every combination.

    Parameters
    ----------
    columns
        Frequency (MHz), zenith angle and phi (deg) of each row, shape (row,); 360 degrees of phi are 0.
    values
        What the rows hold, shape (row,) each.
    """
    frequency, zenith, phi = (np.round(column, 6) for column in columns)
    axes, places = [], []
    for column in (frequency, zenith, phi % 360.0):
        axis, at = np.unique(column, return_inverse=True)
        axes.append(axis)
        places.append(at)
    shape = tuple(axis.size for axis in axes)
    grids = []
    for value in values:
        grid = np.full(shape, np.nan, dtype=complex)
        grid[tuple(places)] = value
        grids.append(grid)
    holes = np.argwhere(np.isnan(grids[0]))
    if holes.size:
        nu, theta, angle = (axis[k] for axis, k in zip(axes, holes[0], strict=True))
        expected = "a row for every frequency, zenith angle and azimuth"
        raise BadInputError(place, expected, f"none at {nu:g} MHz, {theta:g}, {angle:g} deg")
    return axes, grids


def turn_to_arm(
    name: str, place: str, axes: list[Floats], theta: Complexes, phi: Complexes, *, has_level: bool
) -> JonesTable:
    """The table of a dipole, its arm at azimuth 0.

    Parameters
    ----------
    axes
        Frequency (MHz), zenith angle (deg, from 0), and phi (deg, even steps from 0, counterclockwise from above).
    theta, phi
        Response to a field along increasing zenith angle and phi, shape (freq, zenith, phi).
    """
    frequency_mhz, zenith, angles = axes
    if zenith[0] != 0 or angles.size < 8 or not np.allclose(angles, np.arange(angles.size) * 360.0 / angles.size):
        expected = "zenith angles from 0, and 8 or more even steps of phi from 0 to below 360 deg"
        raise BadInputError(place, expected, f"from {zenith[0]:g}; {angles.size} from {angles[0]:g} to {angles[-1]:g}")
    above = zenith <= 90.0
    turned = _along(np.radians(angles), _arm_of(place, np.radians(angles), theta[:, 0], phi[:, 0]))
    return JonesTable(
        name, frequency_mhz, zenith[above], angles, theta[:, above] @ turned, -phi[:, above] @ turned, has_level
    )


def _arm_of(place: str, angle: Floats, theta: Complexes, phi: Complexes) -> float:
    """The direction of the arm from the axis phi = 0, rad, from the response at zenith, shape (freq, phi) each.

    A field along the horizontal vector e gives h e; e_theta is (cos, sin) of phi there, and e_phi (-sin, cos).
    """
    along_x = np.mean(theta * np.cos(angle) - phi * np.sin(angle), axis=1)
    along_y = np.mean(theta * np.sin(angle) + phi * np.cos(angle), axis=1)
    size = np.maximum(np.abs(along_x) ** 2 + np.abs(along_y) ** 2, 1e-300)
    response = np.stack([along_x, along_y]) / np.sqrt(size)
    share, directions = np.linalg.eigh(np.mean((response[:, None] * response[None].conj()).real, axis=2))
    if not share[1] >= LEAST_LINEAR:
        expected = f"one arm: {LEAST_LINEAR:.0%} of the response at zenith to a field along one direction"
        raise BadInputError(place, expected, f"{max(share[1], 0.0):.0%}")
    return float(np.arctan2(directions[1, 1], directions[0, 1]))


def _along(angle: Floats, arm: float) -> NDArray[np.complex128]:
    """What takes values at phi to the azimuths from the arm: phi = arm - azimuth; shape (phi, azimuth).

    Interpolation between the steps of phi is by the Fourier series through them.
    """
    size = angle.size
    order = np.arange(-(size // 2), size // 2 + 1)
    weight = np.where((2 * np.abs(order) == size), 0.5, 1.0)
    there = np.exp(-1j * np.outer(angle, order)) * weight / size
    return np.asarray(there @ np.exp(1j * np.outer(order, arm - angle)))
