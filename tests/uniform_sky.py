"""A sky of one brightness, whose temperature every beam sees."""

from __future__ import annotations

import numpy as np

from lbacal_core.sky.model import SkyModel


def uniform(kelvin: float) -> SkyModel:
    """A sky of one brightness."""
    multipoles = np.zeros((1, 3, 3), dtype=complex)
    multipoles[0, 0, 0] = np.sqrt(4 * np.pi)
    nodes = np.array([10.0, 120.0])
    return SkyModel("uniform", nodes, np.full(2, kelvin), np.ones((2, 1)), multipoles, True, True, "a test")
