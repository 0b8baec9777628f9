"""Arms that do not lie level: an antenna model with its arm raised, on the scale of the level one."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from lbacal_core.antenna.model import AntennaModel
from lbacal_core.antenna.varied import VariedAntenna
from lbacal_core.errors import BadInputError

LARGEST_TURN_DEG = 20.0
"""A pattern that was computed above ground is turned as a whole by no more than this."""


@runtime_checkable
class CanTilt(Protocol):
    """An antenna model that knows its own response with the arm raised."""

    def tilted(self, tilt_deg: float) -> AntennaModel:
        """The same antenna with the end of its arm that points to its azimuth raised."""
        ...


def raise_arm(antenna: AntennaModel, tilt_deg: float) -> AntennaModel:
    """The antenna model with its arm raised by a tilt; itself where the arm lies level.

    A model that knows its response at any tilt gives it; the pattern of any other is turned as a whole, away from the
    raised end, ground and all, which holds for small tilts.

    Raises
    ------
    BadInputError
        Where a pattern would have to be turned by more than 20 degrees.
    """
    if tilt_deg == 0.0:
        return antenna
    if isinstance(antenna, CanTilt):
        return antenna.tilted(tilt_deg)
    if abs(tilt_deg) > LARGEST_TURN_DEG:
        raise BadInputError(
            f"antenna {antenna.name}: tilt_deg",
            f"-{LARGEST_TURN_DEG:g} to {LARGEST_TURN_DEG:g} of a pattern that is turned as a whole (short-dipole takes "
            "any tilt; a file of this arm's own Jones terms needs none)",
            f"{tilt_deg:g}",
        )
    return VariedAntenna(antenna, tilt_deg=tilt_deg, tilt_towards_deg=180.0)
