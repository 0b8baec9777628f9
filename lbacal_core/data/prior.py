"""The one prior of nature: by how much each thing may be other than it is simulated, with its source."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from lbacal_core.data.tables import SHIPPED


@dataclass(frozen=True)
class Departure:
    """One standard deviation of what may be wrong.

    Attributes
    ----------
    sizes
        One number, or one for each order of a series.
    of
        What departs, in words.
    source
        Where the numbers come from.
    at_mhz
        The channels of the numbers, where they are a spectrum.
    """

    sizes: tuple[float, ...]
    of: str
    source: str
    at_mhz: Sequence[float] = ()

    @property
    def size(self) -> float:
        """The one number of `sizes`, which must not be a series."""
        (size,) = self.sizes
        return size


@cache
def read_prior() -> dict[str, Departure]:
    """Read the table of `lbacal_core/data/prior.toml`: every departure by its name."""
    rows = tomllib.loads((SHIPPED / "prior.toml").read_text(encoding="utf-8"))
    return {name: Departure(tuple(np.atleast_1d(row.pop("size")).tolist()), **row) for name, row in rows.items()}
