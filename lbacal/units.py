"""Numbers with and without a unit, as users give them, in the plain numbers of `lbacal_core`."""

from __future__ import annotations

from typing import Any

import numpy as np
from astropy import units as u
from astropy.coordinates import Angle

from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats


def convert_number(value: Any, unit: u.UnitBase) -> float:
    """A number in a unit, which it is taken in where it has none; an angle as text too, such as ``-35d12m``."""
    try:
        given = Angle(value, u.deg) if isinstance(value, str) and unit == u.deg else value
        return float(u.Quantity(given, unit).value)
    except (u.UnitsError, TypeError, ValueError) as error:
        raise refuse_unit(value, unit) from error


def convert_numbers(value: Any, unit: u.UnitBase) -> Floats:
    """Numbers in a unit, shape (number,)."""
    try:
        return np.atleast_1d(np.asarray(u.Quantity(value, unit).value, dtype=float))
    except (u.UnitsError, TypeError, ValueError) as error:
        raise refuse_unit(value, unit) from error


def refuse_unit(value: Any, unit: u.UnitBase) -> BadInputError:
    """The error of a value that is no number in a unit."""
    return BadInputError("a quantity", f"one in {unit}, or a number, which is taken in it", repr(value))
