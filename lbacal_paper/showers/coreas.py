"""Electric fields of a simulated air shower from CoREAS: its HDF5 file, or its folder of .dat files.

CoREAS counts x to magnetic north, y to the west, z up, in cm, and gives the field in statvolt per cm. CORSIKA's
azimuth is that of the momentum, from x through y. Here axes are east, north, up, in m and V/m; azimuth is where the
shower comes from, north through east. The declination is left out: north is magnetic north, as in the simulation.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.grids import Floats

STATVOLT_PER_CM = 2.99792458e4
"""V/m."""
CM = 0.01


@dataclass(frozen=True)
class Shower:
    """The field of one shower at many places.

    Attributes
    ----------
    zenith_deg, azimuth_deg
        Where it comes from; azimuth north through east.
    energy_ev
        Energy of the primary particle, eV.
    position_m
        Shape (antenna, 3): east, north, up.
    time_s
        Shape (antenna, sample), evenly spaced.
    field
        Shape (antenna, sample, 3): east, north, up, V/m.
    """

    name: str
    zenith_deg: float
    azimuth_deg: float
    energy_ev: float
    position_m: Floats
    time_s: Floats
    field: Floats

    def __post_init__(self) -> None:
        antennas, samples = self.time_s.shape
        if self.field.shape != (antennas, samples, 3) or self.position_m.shape != (antennas, 3) or samples < 2:
            raise BadInputError(self.name, "positions, times and fields of the same antennas", f"{self.field.shape}")
        steps = np.diff(self.time_s, axis=1)
        if not np.all(steps > 0) or np.ptp(steps) > 1e-3 * steps.mean():
            raise BadInputError(f"{self.name}: time", "evenly rising times", "others")
        if not np.all(np.isfinite(self.field)):
            raise BadInputError(f"{self.name}: field", "finite numbers", "another")

    def on_sky(self) -> Floats:
        """E_theta and E_phi, shape (antenna, sample, 2): along increasing zenith angle and azimuth, V/m."""
        return self.field @ sky_basis(self.zenith_deg, self.azimuth_deg).T


def sky_basis(zenith_deg: float, azimuth_deg: float) -> Floats:
    """Unit vectors of increasing zenith angle and azimuth at a direction, shape (2, 3): east, north, up."""
    zenith, azimuth = np.radians([zenith_deg, azimuth_deg])
    return np.array(
        [
            [np.cos(zenith) * np.sin(azimuth), np.cos(zenith) * np.cos(azimuth), -np.sin(zenith)],
            [np.cos(azimuth), -np.sin(azimuth), 0.0],
        ]
    )


def read_coreas(path: Path) -> Shower:
    """Read a CoREAS shower: an HDF5 file, or a .reas file with its .list file and folder of .dat files beside it."""
    return _read_folder(path) if path.suffix == ".reas" else _read_hdf5(path)


def _read_hdf5(path: Path) -> Shower:
    try:
        with h5py.File(path, "r") as file:
            facts = file["CoREAS"].attrs
            observers = file["CoREAS/observers"]
            traces = [np.asarray(observers[name], dtype=float) for name in observers]
            places = [np.asarray(observers[name].attrs["position"], dtype=float) for name in observers]
            zenith, azimuth = float(facts["ShowerZenithAngle"]), float(facts["ShowerAzimuthAngle"])
            energy = float(facts["PrimaryParticleEnergy"])
    except (OSError, KeyError) as error:
        raise UnreadableFileError(f"{path}: expected a CoREAS file with CoREAS/observers ({error})") from error
    return _make_shower(path.name, zenith, azimuth, energy, places, traces)


def _read_folder(path: Path) -> Shower:
    facts = dict(_settings(path))
    names = ("ShowerZenithAngle", "ShowerAzimuthAngle", "PrimaryParticleEnergy")
    missing = [name for name in names if name not in facts]
    if missing:
        raise BadInputError(str(path), f"lines with {', '.join(names)}", f"no {', '.join(missing)}")
    folder = path.with_name(f"{path.stem}_coreas")
    places, traces = [], []
    for words in _antenna_lines(path.with_suffix(".list")):
        places.append(np.array([float(word) for word in words[:3]]))
        file = folder / f"raw_{words[3]}.dat"
        try:
            traces.append(np.loadtxt(file, ndmin=2))
        except (OSError, ValueError) as error:
            raise UnreadableFileError(f"{file}: expected rows of time and three field components ({error})") from error
    angles = [float(facts[name].split()[0]) for name in names]
    return _make_shower(path.name, angles[0], angles[1], angles[2], places, traces)


def _settings(path: Path) -> Iterator[tuple[str, str]]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise UnreadableFileError(f"{path}: expected text ({error})") from error
    for line in lines:
        content = line.split(";")[0]
        if "=" in content:
            name, value = content.split("=", 1)
            yield name.strip(), value.strip()


def _antenna_lines(path: Path) -> list[list[str]]:
    found = [value.split() for name, value in _settings(path) if name == "AntennaPosition"]
    if not found or any(len(words) < 4 for words in found):
        raise BadInputError(str(path), "lines AntennaPosition = x y z name", f"{len(found)} such lines")
    return found


def _make_shower(
    name: str, zenith: float, azimuth: float, energy: float, places: list[Floats], traces: list[Floats]
) -> Shower:
    if not traces or any(trace.ndim != 2 or trace.shape[1] != 4 for trace in traces):
        raise BadInputError(name, "antennas with four columns each", f"{len(traces)} antennas")
    samples = min(trace.shape[0] for trace in traces)
    stacked = np.array([trace[:samples] for trace in traces])
    x, y, z = np.moveaxis(stacked[:, :, 1:], 2, 0) * STATVOLT_PER_CM
    position = np.array(places) * CM
    return Shower(
        name,
        zenith,
        # the momentum's azimuth, x (north) through y (west), turned about: north through east of the origin
        (180.0 - azimuth) % 360.0,
        energy,
        np.stack([-position[:, 1], position[:, 0], position[:, 2]], axis=1),
        stacked[:, :, 0],
        np.stack([-y, x, z], axis=2),
    )
