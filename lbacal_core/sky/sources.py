"""The four brightest sources of the northern sky: an optional layer on top of a sky model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lbacal_core.errors import BadInputError
from lbacal_core.grids import Floats


@dataclass(frozen=True)
class PointSource:
    """A source with log10 S/Jy = sum_i coefficients_i (log10 nu/MHz)^i at `epoch`, fading by `decline` a year.

    Attributes
    ----------
    right_ascension_deg, declination_deg
        ICRS, degrees.
    """

    name: str
    right_ascension_deg: float
    declination_deg: float
    coefficients: tuple[float, ...]
    epoch: float = 1965.0
    decline: float = 0.0

    def flux_jy(self, frequency_mhz: Floats, year: float) -> Floats:
        """Flux density in a year, shape (freq,), Jy."""
        logarithm = np.polynomial.polynomial.polyval(np.log10(frequency_mhz), self.coefficients)
        return np.asarray(10.0**logarithm * (1.0 - self.decline) ** (year - self.epoch))


SOURCES = {
    source.name: source
    for source in (
        # Spectra: Baars et al. 1977 (A&A 61, 99, table 5), valid from 20 MHz for Cas A and Cyg A; those of Tau A
        # and Vir A are extrapolated from above 400 MHz, good to some 10 % at 50 MHz. The decline of Cas A at 38-80
        # MHz is 0.7-0.8 % a year (Helmboldt & Kassim 2009, AJ 138, 838), slower than Baars et al. had it.
        PointSource("cas-a", 350.8664, 58.8117, (5.625, -0.634, -0.023), decline=0.0077),
        PointSource("cyg-a", 299.8682, 40.7339, (4.695, 0.085, -0.178)),
        PointSource("tau-a", 83.6331, 22.0145, (3.915, -0.299)),
        PointSource("vir-a", 187.7059, 12.3911, (5.023, -0.856)),
    )
}


def find_sources(names: Sequence[str]) -> list[PointSource]:
    """The sources of some names."""
    unknown = [name for name in names if name not in SOURCES]
    if unknown:
        raise BadInputError("point source", f"one of {', '.join(sorted(SOURCES))}", repr(unknown[0]))
    return [SOURCES[name] for name in names]
