"""What is LOFAR's and nobody else's: the letters of its dipoles, and where its stations stand."""

from __future__ import annotations

DIPOLES = ("X", "Y")
SUPERTERP = "lofar-superterp"
"""The instrument that the published C(nu) and the published noise terms belong to."""
LOFAR_DEG = (52.9, 6.9)
LOFAR_RADIUS_DEG = 1.5
"""Latitude and longitude of LOFAR's core, and how far its Dutch stations reach: about 100 km."""
