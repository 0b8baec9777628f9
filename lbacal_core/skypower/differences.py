"""In which shapes, and how much, models of sky and antenna differ: nuisance modes and a term of the error budget."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats
from lbacal_core.instrument import DIPOLES


def model_difference_modes(frequency_mhz: Floats, lst_hours: Floats) -> dict[str, Floats]:
    """Relative changes of P_sky that an exchange of sky or antenna model can make, one prior sigma each.

    Made by scripts/make_model_differences.py for the Superterp: each alternative model counts as one standard
    deviation away from the default. The mean of every mode over LST is zero at each frequency, because A(nu) of the
    chain absorbs it; `model_level_spread` gives its size.

    Parameters
    ----------
    frequency_mhz
        Shape (freq,), MHz, within 30 to 80.
    lst_hours
        Shape (lst,) or (event,), hours.

    Returns
    -------
    For each dipole, shape (mode, lst, freq): d ln P_sky, strongest mode first.
    """
    table = _read_table()
    angle = 2 * np.pi / 24.0 * np.asarray(lst_hours, dtype=float)
    modes = {}
    for dipole in DIPOLES:
        terms = np.array(table[dipole]["real"]) + 1j * np.array(table[dipole]["imaginary"])
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
    outside = (frequency_mhz < nodes[0]) | (frequency_mhz > nodes[-1])
    if np.any(outside):
        raise BadInputError(
            "model differences: frequency_mhz", f"{nodes[0]:g} to {nodes[-1]:g} MHz", f"{frequency_mhz[outside][0]:g}"
        )
    return CubicSpline(nodes, values, axis=-1)(frequency_mhz)


def _read_table() -> dict[str, Any]:
    content: dict[str, Any] = json.loads((files("lbacal_core") / "data/model_differences.json").read_text())
    return content
