"""A stand-in for the reference source of the paper: two characterisations that disagree.

The tables of the VSQ 1000 (manufacturer's measurements in an anechoic chamber with a reflecting floor, and in a GTEM
cell) are not public, nor is what the antennas recorded in May 2014. What stands here is a source whose field in free
space is known, seen by two laboratories as the physics of their surroundings says: it shows how large the effects
are, and that the method recovers the truth within its errors. No number of it is a measurement.
"""

from __future__ import annotations

import numpy as np

from lbacal_core.grids import Floats
from lbacal_paper.reference_source import SourceTable, floor_factor, near_field_factor

LABORATORY_M, HEIGHT_M = 3.0, 1.5
"""Distance and height of the characterisation in the chamber (appendix A)."""
SCALED_M = 10.0
"""The distance to which both tables are scaled (appendix A)."""
FIELD_MV_M = 1.0
"""Field of the stand-in at 10 m, mV/m/MHz^1/2: an arbitrary level."""
STATED = 0.18
"""Stated error of the field: the scale uncertainty quoted for Tunka-Rex with the VSQ 1000 (arXiv 1508.06210)."""
LEFT_OF_FLOOR = 0.15
"""Amplitude of the floor's reflection that the chamber's procedure does not take out, of a perfect reflection."""
CHAMBER, CELL = "stand-in, chamber", "stand-in, GTEM cell"


def true_field(frequency_mhz: Floats) -> Floats:
    """Field of the stand-in at 10 m in free space, shape (freq,), V/m/MHz^1/2: a comb whose level falls slowly."""
    return np.asarray(1e-3 * FIELD_MV_M * (frequency_mhz / 55.0) ** -0.5)


def stand_in_tables(frequency_mhz: Floats) -> tuple[SourceTable, SourceTable]:
    """What the two laboratories would state: chamber with a floor, and GTEM cell."""
    field, sigma = true_field(frequency_mhz), np.full_like(frequency_mhz, STATED)
    near = near_field_factor(frequency_mhz, LABORATORY_M)
    floor = floor_factor(frequency_mhz, LABORATORY_M, HEIGHT_M, HEIGHT_M, -LEFT_OF_FLOOR)
    return (
        SourceTable(CHAMBER, frequency_mhz, field * near * floor, sigma, SCALED_M),
        SourceTable(CELL, frequency_mhz, field * near, sigma, SCALED_M),
    )
