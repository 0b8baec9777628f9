"""Differences between sky and antenna models: nuisance modes, and a term of the error budget."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from lbacal_core.grids import Floats
from lbacal_core.instrument import DIPOLES


def model_difference_modes(
    frequency_mhz: Floats, lst_hours: Floats, dipole_azimuth_deg: Mapping[str, float] | None = None
) -> dict[str, Floats]:
    """Relative changes of P_sky that an exchange of sky or antenna model can make, one prior sigma each.

    Made by scripts/make_model_differences.py for the Superterp: each alternative model counts as one standard
    deviation away from the default. The mean of every mode over LST is zero at each frequency, because A(nu) of the
    chain describes it; `model_level_spread` gives its size.

    Parameters
    ----------
    frequency_mhz
        Shape (freq,), MHz; beyond 30 to 80 the modes of the nearest of these hold.
    lst_hours
        Shape (lst,) or (event,), hours.
    dipole_azimuth_deg
        Arms of X and Y, as an instrument has them; each dipole gets the modes of the nearest arm (45 or 135
        deg). Without it X is at 45 and Y at 135.

    Returns
    -------
    For each dipole, shape (mode, lst, freq): d ln P_sky, strongest mode first.
    """
    table = _read_table()
    angle = 2 * np.pi / 24.0 * np.asarray(lst_hours, dtype=float)
    modes = {}
    for dipole, arm in (dipole_azimuth_deg or table["dipole_azimuth_deg"]).items():
        nearest = _nearest_arm(table, arm)
        terms = np.array(table[nearest]["real"]) + 1j * np.array(table[nearest]["imaginary"])
        terms = _interpolate(table, terms, frequency_mhz)
        basis = 2.0 * np.exp(1j * np.outer(angle, np.arange(1, terms.shape[1] + 1)))
        modes[dipole] = np.asarray(np.einsum("tm,kmf->ktf", basis, terms).real)
    return modes


def model_level_spread(frequency_mhz: Floats) -> dict[str, Floats]:
    """Spread of the LST mean of ln P_sky between the models, shape (freq,) a dipole: half of it goes into ln C."""
    table = _read_table()
    return {
        dipole: np.asarray(_interpolate(table, np.array(table[dipole]["level"]), frequency_mhz).real)
        for dipole in DIPOLES
    }


def _interpolate(table: dict[str, Any], values: Any, frequency_mhz: Floats) -> Any:
    nodes = np.array(table["frequency_mhz"])
    return CubicSpline(nodes, values, axis=-1)(np.clip(frequency_mhz, nodes[0], nodes[-1]))


def _nearest_arm(table: dict[str, Any], arm_azimuth_deg: float) -> str:
    """The polarisation of the table whose arm is nearest; an arm points both ways."""
    arms: dict[str, float] = table["dipole_azimuth_deg"]
    return min(arms, key=lambda letter: abs((arms[letter] - arm_azimuth_deg + 90.0) % 180.0 - 90.0))


def _read_table() -> dict[str, Any]:
    content: dict[str, Any] = json.loads((files("lbacal_core") / "data/model_differences.json").read_text())
    return content
