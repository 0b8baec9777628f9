"""Antenna models by name or file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from lbacal_core.antenna.files import read_aera_xml, read_jones_npz, read_jones_text, read_nuradio_pickle, read_uvbeam
from lbacal_core.antenna.ideal import InvertedV, IsotropicAntenna, QuarterWaveDipole, ShortDipole
from lbacal_core.antenna.lofar import ResonanceCircuit, ResonantAntenna, load_hamaker
from lbacal_core.antenna.model import AntennaModel, zenith_gain
from lbacal_core.errors import BadInputError, UnknownNameError
from lbacal_core.foreign import parse_numbers
from lbacal_core.instrument.antennas import ABSOLUTE, RELATIVE

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


def load_antenna(name_or_file: str | AntennaModel) -> AntennaModel:
    """The antenna model of a name, or of a file of Jones terms in any of `READERS`; a model as it is.

    Raises
    ------
    UnknownNameError
        Where it is neither.
    """
    if not isinstance(name_or_file, str):
        return name_or_file
    if name_or_file in ANTENNAS:
        return ANTENNAS[name_or_file]()
    path = Path(name_or_file)
    if path.is_file():
        return READERS.get(path.suffix.lower(), read_jones_text)(path)
    raise UnknownNameError("antenna model", name_or_file, sorted(ANTENNAS))


# G_ant from an antenna model: the power pattern at zenith of a table of voltage per field.


def take_antenna_gain(
    content: Mapping[str, Any],
    place: str,
    antenna: str,
    source: str,
    *,
    is_absolute: bool,
    shape_error: float | None = None,
    scale_error: float | None = None,
) -> dict[str, Any]:
    """The content of an instrument file with G_ant of an antenna model, which it names and says the provenance of.

    Parameters
    ----------
    content
        What an instrument file holds, with or without `antenna_gain`; `place` is its name for messages.
    antenna
        File of Jones terms in V per V/m.
    source
        Who computed or measured the table, and how.
    is_absolute
        Whether the table is in V per V/m at the load; otherwise G_ant is right up to a factor.
    shape_error, scale_error
        One standard deviation of ln G_ant: of its shape over frequency, and of its common factor.
    """
    model = load_antenna(antenna)
    if antenna in ANTENNAS or not getattr(model, "has_level", False):
        raise BadInputError(
            f"antenna {antenna}",
            "a file of voltage per field (.npz or text)",
            "a pattern that does not give the level of G_ant over frequency",
        )
    frequency_mhz = parse_numbers(content.get("frequency_mhz"), f"{place}: frequency_mhz")
    gain = zenith_gain(model, frequency_mhz)
    provenance: dict[str, Any] = {"kind": ABSOLUTE if is_absolute else RELATIVE, "source": source}
    errors = {"shape_error": shape_error, "scale_error": scale_error}
    provenance |= {name: error for name, error in errors.items() if error is not None}
    provenance["antenna_sha256"] = model.digest()
    named = {"antenna": str(Path(antenna).resolve()), "antenna_gain": [float(f"{value:.6g}") for value in gain]}
    return {**content, **named, "antenna_gain_provenance": provenance}
