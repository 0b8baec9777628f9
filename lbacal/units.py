"""Numbers as users give them, with and without a unit, in the plain numbers of `lbacal_core`."""

from __future__ import annotations

from typing import Any

import numpy as np
from astropy import units as u
from astropy.coordinates import Angle
from numpy.typing import NDArray

from lbacal_core.errors import BadInputError


def convert_number(value: Any, unit: u.UnitBase, place: str = "a quantity") -> float:
    """A number in a unit, which it is taken in where it has none; an angle as text too, such as ``-35d12m``."""
    try:
        given = Angle(value, u.deg) if isinstance(value, str) and unit == u.deg else value
        given = given if isinstance(given, u.Quantity) else u.Quantity(given, unit)
        return float(given.to_value(unit, u.temperature()))
    except (u.UnitsError, TypeError, ValueError) as error:
        raise _refuse_unit(value, unit, place) from error


def convert_numbers(value: Any, unit: u.UnitBase, kind: type = float) -> NDArray[Any]:
    """Numbers in a unit, shape (number,), real or complex."""
    try:
        return np.atleast_1d(np.asarray(u.Quantity(value, unit).value, dtype=kind))
    except (u.UnitsError, TypeError, ValueError) as error:
        raise _refuse_unit(value, unit) from error


def convert_band(band: Any) -> tuple[float, float]:
    """The lowest and the highest channel, MHz, of two numbers or Quantities."""
    if not isinstance(band, tuple | list | np.ndarray) or len(band) != 2:
        raise BadInputError("band", "two numbers, the lowest and the highest channel", repr(band))
    return convert_number(band[0], u.MHz), convert_number(band[1], u.MHz)


def make_rng(seed: Any) -> np.random.Generator:
    """A generator of random numbers from its seed."""
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise BadInputError("seed", "a whole number, 0 or more", repr(seed))
    return np.random.default_rng(int(seed))


def _refuse_unit(value: Any, unit: u.UnitBase, place: str = "a quantity") -> BadInputError:
    """The error of a value that is no number in a unit."""
    return BadInputError(place, f"one in {unit}, or a number, which is taken in it", repr(value))
