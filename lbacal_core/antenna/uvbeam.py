"""Antenna models of pyuvdata: E-field beams in BeamFITS files (UVBeam), by azimuth and zenith angle."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from lbacal_core.antenna.arm import turn_to_arm
from lbacal_core.antenna.table import JonesTable
from lbacal_core.errors import BadInputError, MissingExtraError, UnreadableFileError


def read_uvbeam(path: Path) -> JonesTable:
    """Read the first feed of a beam.

    Azimuth of a UVBeam runs from east through north; of its two components the first is along azimuth, the second along
    the zenith angle. Levels of beams come from a transmitter of unknown input and say nothing of G_ant.
    """
    try:
        from pyuvdata import UVBeam
    except ImportError as error:
        raise MissingExtraError(f"{path}, a beam of pyuvdata,", "import") from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            beam = UVBeam.from_file(str(path))
    except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
        raise UnreadableFileError(f"{path}: expected a BeamFITS file ({error})") from error
    found = f"a {beam.beam_type} beam on {beam.pixel_coordinate_system}"
    if beam.beam_type != "efield" or beam.pixel_coordinate_system != "az_za":
        raise BadInputError(str(path), "an E-field beam by azimuth and zenith angle (efield, az_za)", found)
    zenith, phi = np.degrees(beam.axis2_array), np.degrees(beam.axis1_array)
    basis = beam.basis_vector_array
    if not np.allclose(basis[0, 0], 1.0) or not np.allclose(basis[1, 1], 1.0):
        raise BadInputError(f"{path}: basis_vector_array", "components along azimuth and zenith angle", "others")
    # axes of the data are component, feed, freq, zenith, azimuth
    along_phi, along_theta = beam.data_array[0, 0], beam.data_array[1, 0]
    if np.isclose(phi[-1] - phi[0], 360.0):
        phi, along_phi, along_theta = phi[:-1], along_phi[..., :-1], along_theta[..., :-1]
    axes = [np.asarray(beam.freq_array, dtype=float) / 1e6, np.round(zenith, 9), phi]
    return turn_to_arm(path.stem, str(path), axes, along_theta, along_phi, has_level=False)
