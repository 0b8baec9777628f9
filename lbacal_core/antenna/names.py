"""Antenna models by name or file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from lbacal_core.antenna.aera import read_aera_xml
from lbacal_core.antenna.circuit import ResonanceCircuit, ResonantAntenna
from lbacal_core.antenna.files import read_jones_npz, read_jones_text
from lbacal_core.antenna.hamaker import load_hamaker
from lbacal_core.antenna.ideal import IsotropicAntenna, QuarterWaveDipole, ShortDipole
from lbacal_core.antenna.inverted_v import InvertedV
from lbacal_core.antenna.model import AntennaModel
from lbacal_core.antenna.nuradio import read_nuradio_pickle
from lbacal_core.antenna.uvbeam import read_uvbeam
from lbacal_core.errors import UnknownNameError

DEFAULT_ANTENNA = "hamaker"
ANTENNAS: dict[str, Callable[[], AntennaModel]] = {
    "hamaker": load_hamaker,
    "hamaker-resonant": lambda: ResonantAntenna(load_hamaker(), ResonanceCircuit()),
    "short-dipole": lambda: ShortDipole(height_m=1.5),
    "isotropic": IsotropicAntenna,
    "quarter-wave": QuarterWaveDipole,
    "inverted-v": InvertedV,
    "inverted-v-wet": lambda: InvertedV(droop_deg=40.0, permittivity=30.0, conductivity=0.03, name="inverted-v-wet"),
}


READERS: dict[str, Callable[[Path], AntennaModel]] = {
    ".npz": read_jones_npz,
    ".xml": read_aera_xml,
    ".pkl": read_nuradio_pickle,
    ".fits": read_uvbeam,
    ".beamfits": read_uvbeam,
}
"""By the end of a file's name; any other is text, whose kind its first lines tell."""


def load_antenna(name_or_file: str) -> AntennaModel:
    """The antenna model of a name, or of a file of Jones terms (`antenna.files`, `aera`, `nuradio`, `uvbeam`)."""
    if name_or_file in ANTENNAS:
        return ANTENNAS[name_or_file]()
    path = Path(name_or_file)
    if path.is_file():
        return READERS.get(path.suffix.lower(), read_jones_text)(path)
    raise UnknownNameError("antenna model", name_or_file, sorted(ANTENNAS))
