"""Causes in the sky and on its way to the antenna."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lbacal_core.causes.terms import ChainTerms, Conditions, Law

STATION = ("station",)
NAMED_SOURCES = ("Cas A", "Cyg A", "Tau A", "Vir A")


@dataclass(frozen=True)
class LstOffset:
    """Sidereal time of the data or of the simulation is off."""

    identifier: str = "lst_offset"
    unit: str = "h"
    meaning: str = "the sidereal time of data or simulation is off"
    confirm: str = "compare the transit of a bright source in interferometric data with its right ascension"
    scopes: Sequence[str] = STATION
    step: float = 0.005

    def laws(self, conditions: Conditions) -> list[Law]:  # noqa: ARG002 - one law whatever the data
        """One law."""
        return [Law()]

    def why_not(self, conditions: Conditions) -> str | None:  # noqa: ARG002
        """Every LST coverage can show it."""
        return None

    def apply(self, terms: ChainTerms, conditions: Conditions, law: Law, size: float) -> ChainTerms:  # noqa: ARG002
        """P_sky at a shifted LST, relative to that at the nominal one."""
        moved = conditions.sky_at(conditions.lst_hours + size) / conditions.sky_at(conditions.lst_hours)
        return replace(terms, sky=terms.sky * moved)


@dataclass(frozen=True)
class SkyChange:
    """A change of P_sky that needs directions, taken from the package's own sky and antenna as a ratio."""

    identifier: str
    unit: str
    meaning: str
    confirm: str
    key: str
    scopes: Sequence[str] = STATION
    step: float = 1e-3

    def laws(self, conditions: Conditions) -> list[Law]:
        """One law, where the own sky could be computed for these channels."""
        return [Law()] if self.key in conditions.sky_change else []

    def why_not(self, conditions: Conditions) -> str | None:
        """Without a sky and antenna model of these channels there are no directions."""
        return (
            None if self.key in conditions.sky_change else "the own sky and antenna model do not cover these channels"
        )

    def apply(self, terms: ChainTerms, conditions: Conditions, law: Law, size: float) -> ChainTerms:  # noqa: ARG002
        """P_sky times its relative change, exponential so that it stays positive."""
        return replace(terms, sky=terms.sky * np.exp(size * conditions.sky_change[self.key]))


@dataclass(frozen=True)
class PointSource:
    """A named source that the sky model lacks or has too strong."""

    identifier: str = "point_source"
    unit: str = "fraction of its flux"
    meaning: str = "a named source is wrong in the sky model"
    confirm: str = "look whether the excess follows the source through its transit at each frequency"
    scopes: Sequence[str] = STATION
    step: float = 1e-3

    def laws(self, conditions: Conditions) -> list[Law]:
        """One law a source."""
        return [Law({"source": name}) for name in NAMED_SOURCES if name in conditions.sky_change]

    def why_not(self, conditions: Conditions) -> str | None:
        """Without a sky and antenna model of these channels there are no directions."""
        if any(name in conditions.sky_change for name in NAMED_SOURCES):
            return None
        return "the own sky and antenna model do not cover these channels"

    def apply(self, terms: ChainTerms, conditions: Conditions, law: Law, size: float) -> ChainTerms:
        """P_sky plus a fraction of the source's flux through D."""
        return replace(terms, sky=terms.sky * (1.0 + size * conditions.sky_change[law.parameters["source"]]))


@dataclass(frozen=True)
class IsotropicLevel:
    """Power added at each frequency in proportion to the mean sky power there."""

    identifier: str = "isotropic_level"
    unit: str = "fraction of the mean sky power"
    meaning: str = "the isotropic part of the sky is wrong"
    confirm: str = "compare with an absolute measurement of the sky minimum, or with the noise levels of a laboratory"
    scopes: Sequence[str] = STATION
    step: float = 1e-3

    def laws(self, conditions: Conditions) -> list[Law]:  # noqa: ARG002
        """One law."""
        return [Law()]

    def why_not(self, conditions: Conditions) -> str | None:  # noqa: ARG002
        """Every sky can show it."""
        return None

    def apply(self, terms: ChainTerms, conditions: Conditions, law: Law, size: float) -> ChainTerms:  # noqa: ARG002
        """P_sky plus a constant in LST."""
        return replace(terms, sky=terms.sky + size * conditions.mean_sky[:, None, :])


@dataclass(frozen=True)
class SolarEmission:
    """The quiet Sun, P proportional to nu^1..2 times D towards it."""

    identifier: str = "solar_emission"
    unit: str = "fraction of the mean sky power at 55 MHz, Sun overhead"
    meaning: str = "the Sun adds power by day"
    confirm: str = "compare with solar monitoring, and days of high activity with quiet ones"
    scopes: Sequence[str] = STATION
    step: float = 1e-3

    def laws(self, conditions: Conditions) -> list[Law]:
        """Spectral indices of the power between 1 and 2."""
        if self.why_not(conditions):
            return []
        return [Law({"spectral_index": index}) for index in (1.0, 1.5, 2.0)]

    def why_not(self, conditions: Conditions) -> str | None:
        """The Sun must rise and set in the data."""
        if conditions.sun_response is None:
            return "the own antenna model does not cover these channels"
        is_up = conditions.sun_altitude > 0
        return None if 0.02 < is_up.mean() < 0.98 else "the Sun is always up, or always down, in these data"

    def apply(self, terms: ChainTerms, conditions: Conditions, law: Law, size: float) -> ChainTerms:
        """P_sky plus the Sun through D."""
        ratio = conditions.frequency_mhz / 55.0
        at_55 = np.array([np.interp(55.0, conditions.frequency_mhz, sky) for sky in conditions.mean_sky])
        flux = at_55[:, None, None] * ratio ** law.parameters["spectral_index"]
        return replace(terms, sky=terms.sky + size * flux * conditions.sun_response)


@dataclass(frozen=True)
class IonosphericAbsorption:
    """Absorption in the sunlit lower ionosphere, tau = tau_30 (30 MHz / nu)^2 (cos chi)^n."""

    identifier: str = "ionospheric_absorption"
    unit: str = "tau at 30 MHz, Sun overhead"
    meaning: str = "the daytime ionosphere absorbs"
    confirm: str = "compare with a riometer or with absorption maps from ionosondes"
    scopes: Sequence[str] = STATION
    step: float = 1e-3

    def laws(self, conditions: Conditions) -> list[Law]:
        """Exponents between 0.5 and 1."""
        return [] if self.why_not(conditions) else [Law({"exponent": n}) for n in (0.5, 0.75, 1.0)]

    def why_not(self, conditions: Conditions) -> str | None:
        """The Sun must rise and set in the data."""
        is_up = conditions.sun_altitude > 0
        return None if 0.02 < is_up.mean() < 0.98 else "the Sun is always up, or always down, in these data"

    def apply(self, terms: ChainTerms, conditions: Conditions, law: Law, size: float) -> ChainTerms:
        """P_sky dimmed by day."""
        cos_chi = np.maximum(np.sin(conditions.sun_altitude), 0.0)
        depth = np.outer(cos_chi ** law.parameters["exponent"] * (cos_chi > 0), (30.0 / conditions.frequency_mhz) ** 2)
        return replace(terms, sky=terms.sky * np.exp(-size * depth))
