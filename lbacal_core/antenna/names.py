"""Antenna models by name."""

from __future__ import annotations

from collections.abc import Callable

from lbacal_core.antenna.hamaker import load_hamaker
from lbacal_core.antenna.ideal import IsotropicAntenna
from lbacal_core.antenna.model import AntennaModel
from lbacal_core.errors import UnknownNameError

DEFAULT_ANTENNA = "hamaker"
ANTENNAS: dict[str, Callable[[], AntennaModel]] = {"hamaker": load_hamaker, "isotropic": IsotropicAntenna}


def load_antenna(name_or_file: str) -> AntennaModel:
    """The antenna model of a name."""
    if name_or_file in ANTENNAS:
        return ANTENNAS[name_or_file]()
    raise UnknownNameError("antenna model", name_or_file, sorted(ANTENNAS))
