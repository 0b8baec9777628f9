"""The letters of dipoles: any short name, such as X, Y or EW; an instrument says which arms they are."""

from __future__ import annotations

import re
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_+-]{0,7}", re.ASCII)
EXPECTED = "a letter or name of up to 8 letters and digits"
RESERVED = frozenset({"sky", "antenna", "dipoles", "hashes", "versions"})
"""Fields of a sky power file that would be names of dipoles."""


def is_dipole_name(name: str) -> bool:
    """Whether a dipole may bear this name."""
    return bool(_NAME.fullmatch(name)) and name not in RESERVED


def are_dipole_names(names: NDArray[np.str_]) -> NDArray[np.bool_]:
    """Whether dipoles may bear these names, shape as given."""
    found, at = np.unique(names, return_inverse=True)
    return np.asarray(np.array([is_dipole_name(str(name)) for name in found], dtype=bool)[at])


def look_like_radians(azimuth_deg: Collection[float]) -> bool:
    """Whether arms of different azimuths all lie within 2 pi: nobody builds dipoles a few degrees apart."""
    return len(set(azimuth_deg)) > 1 and max(abs(azimuth) for azimuth in azimuth_deg) <= 2.0 * np.pi
