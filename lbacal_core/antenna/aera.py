"""Antenna models of the Pierre Auger Observatory's Offline: XML with the vector effective height by direction.

`<frequency>`, `<theta>` and `<phi>` list frequencies and directions, `<EAHTheta_amp idfreq="...">` and its three like
the height towards each direction, amplitude in m and phase in degrees, for one frequency. There is no root element.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from lbacal_core.antenna.arm import grid_rows, turn_to_arm
from lbacal_core.antenna.model import Complexes
from lbacal_core.antenna.table import JonesTable
from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.grids import Floats

TERM = re.compile(r"<(frequency|theta|phi|EAH(?:Theta|Phi)_(?:amp|phase))\b([^>]*)>(.*?)</\1>", re.DOTALL)
IDENTIFIER = re.compile(r"idfreq\s*=\s*[\"']\s*([0-9.eE+-]+)")
COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)


def read_aera_xml(path: Path) -> JonesTable:
    """Read the heights of one dipole."""
    try:
        text = COMMENT.sub("", path.read_text())
    except (OSError, UnicodeDecodeError) as error:
        raise UnreadableFileError(f"{path}: expected text ({error})") from error
    lists: dict[str, Floats] = {}
    of_frequency: dict[tuple[str, float], Floats] = {}
    for name, attributes, values in TERM.findall(text):
        numbers = _numbers(values, f"{path}: {name}")
        named = IDENTIFIER.search(attributes)
        if named is None:
            lists[name] = numbers
        else:
            of_frequency[name, round(float(named[1]), 2)] = numbers
    missing = [name for name in ("frequency", "theta", "phi") if name not in lists]
    if missing:
        expected = "an antenna model of Auger Offline with frequency, theta, phi and EAHTheta_amp"
        raise UnreadableFileError(f"{path}: expected {expected}, found no {', '.join(missing)}")
    frequency_mhz, zenith, phi = (lists[name] for name in ("frequency", "theta", "phi"))
    if zenith.shape != phi.shape:
        raise BadInputError(f"{path}: phi", f"{zenith.size} numbers as theta has", f"{phi.size}")
    heights = [
        np.concatenate([_height(of_frequency, name, nu, zenith.size, path) for nu in frequency_mhz])
        for name in ("EAHTheta", "EAHPhi")
    ]
    rows = (
        np.repeat(frequency_mhz, zenith.size),
        np.tile(zenith, frequency_mhz.size),
        np.tile(phi, frequency_mhz.size),
    )
    axes, grids = grid_rows(str(path), rows, (heights[0], heights[1]))
    return turn_to_arm(path.stem, str(path), axes, grids[0], grids[1], has_level=True)


def _height(
    of_frequency: dict[tuple[str, float], Floats], name: str, nu: float, directions: int, path: Path
) -> Complexes:
    """One component of the height at one frequency, shape (direction,), m."""
    parts = []
    for part in ("amp", "phase"):
        values = of_frequency.get((f"{name}_{part}", round(float(nu), 2)))
        if values is None or values.size != directions:
            found = "none" if values is None else f"{values.size}"
            raise BadInputError(f"{path}: {name}_{part} at {nu:g} MHz", f"{directions} numbers", found)
        parts.append(values)
    return np.asarray(parts[0] * np.exp(1j * np.radians(parts[1])))


def _numbers(text: str, place: str) -> Floats:
    try:
        values = np.array(text.split(), dtype=float)
    except ValueError as error:
        raise BadInputError(place, "numbers", text.strip()[:40]) from error
    if not np.all(np.isfinite(values)):
        raise BadInputError(place, "finite numbers", "another")
    return values
