"""Causes in the sky and on its way to the antenna."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lbacal_core.causes.cause import Cause, SizeRange, Template
from lbacal_core.causes.conditions import Conditions
from lbacal_core.causes.directions import SOURCE_KEYS
from lbacal_core.chain.terms import ChainTerms
from lbacal_core.grids import Floats

NO_DIRECTIONS = "the own sky and antenna model do not cover these channels"
NO_SUN = "the Sun is always up, or always down, in these data, or no antenna model covers these channels"


@dataclass(frozen=True)
class LstOffset(Cause):
    """Sidereal time of the data or of the simulation is off."""

    identifier: str = "lst_offset"
    unit: str = "h"
    meaning: str = "the sidereal time of data or simulation is off"
    confirm: str = (
        "ask whether lst_h is the edge or the centre of a bin; compare the transit of a bright source in "
        "interferometric data with its right ascension"
    )
    step: float = 0.005
    sizes: SizeRange = SizeRange(-3.0, 3.0)

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:  # noqa: ARG002
        """P_sky at a later LST."""
        return replace(terms, sky=conditions.later(terms.sky, np.ravel(amount)))


@dataclass(frozen=True)
class SkyChange(Cause):
    """A change of P_sky that needs directions, taken from the package's own sky and antenna as a ratio."""

    needs: str = NO_DIRECTIONS
    acts_by_ratio: bool = True

    def templates(self, conditions: Conditions) -> list[Template]:
        """One, where the own sky could be computed for these channels."""
        return [Template()] if self.identifier in conditions.sky_ratio else []

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:  # noqa: ARG002
        """P_sky times own(with)/own(without)."""
        return replace(terms, sky=terms.sky * conditions.sky_ratio[self.identifier](amount))


@dataclass(frozen=True)
class DipoleAzimuth(SkyChange):
    """The arms stand at another azimuth."""

    identifier: str = "dipole_azimuth"
    unit: str = "deg"
    meaning: str = "the arms of the dipoles stand at another azimuth"
    confirm: str = "survey the antennas"
    scopes: Sequence[str] = ("station", "antenna")
    step: float = 0.02
    sizes: SizeRange = SizeRange(-45.0, 45.0, starts=(5.0, -5.0))

    def far_templates(self, conditions: Conditions) -> list[Template]:
        """Across to what is on record, which exchanges X and Y."""
        return [Template({"near": "90 deg"}) for _ in self.templates(conditions)]

    def sizes_of(self, template: Template) -> SizeRange:
        """About no turn, or about a right angle."""
        return SizeRange(45.0, 135.0, starts=(90.0,)) if template.parameters else self.sizes

    def kinds(self, template: Template) -> frozenset[str]:
        """A right angle is an exchange of X and Y too."""
        return frozenset({self.identifier, "dipole_swap"} if template.parameters else {self.identifier})


@dataclass(frozen=True)
class PointSource(Cause):
    """A named source that the sky model lacks or has too strong."""

    identifier: str = "point_source"
    unit: str = "fraction of its flux"
    meaning: str = "a named source is wrong in the sky model"
    confirm: str = "look whether the excess follows the source through its transit at each frequency"
    needs: str = NO_DIRECTIONS
    spectral_parameters: Sequence[str] = ("source",)
    acts_by_ratio: bool = True
    sizes: SizeRange = SizeRange(-1.5, 5.0)

    def templates(self, conditions: Conditions) -> list[Template]:
        """One a source."""
        return [Template({"source": name}) for name in SOURCE_KEYS if name in conditions.sky_ratio]

    def is_another(self, template: Template, earlier: Template) -> bool:
        """Another source."""
        return bool(template.parameters["source"] != earlier.parameters["source"])

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:
        """P_sky plus a fraction of the source's flux through D."""
        return replace(terms, sky=terms.sky * conditions.sky_ratio[template.parameters["source"]](amount))


@dataclass(frozen=True)
class IsotropicLevel(Cause):
    """Power added at each frequency in proportion to the mean sky power there."""

    identifier: str = "isotropic_level"
    unit: str = "fraction of the mean sky power"
    meaning: str = "the isotropic part of the sky is wrong"
    confirm: str = "compare with an absolute measurement of the sky minimum, or with the noise levels of a laboratory"
    sizes: SizeRange = SizeRange(-0.5, 10.0)

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:  # noqa: ARG002
        """P_sky plus a constant in LST."""
        return replace(terms, sky=terms.sky + amount * conditions.mean_sky[:, None, :])


@dataclass(frozen=True)
class SolarEmission(Cause):
    """The quiet Sun, P proportional to nu^1..2 times D towards it."""

    identifier: str = "solar_emission"
    unit: str = "fraction of the mean sky power at 55 MHz, Sun overhead"
    sizes: SizeRange = SizeRange(0.0, 3.0)
    meaning: str = "the Sun adds power by day"
    confirm: str = "compare with solar monitoring, and days of high activity with quiet ones"
    needs: str = NO_SUN
    axes: Sequence[str] = ("utc", "date")
    spectral_parameters: Sequence[str] = ("spectral_index",)

    def templates(self, conditions: Conditions) -> list[Template]:
        """Spectral indices of the power between 1 and 2, where the Sun rises and sets in the data."""
        if conditions.sun_response is None or not conditions.has_day_and_night:
            return []
        return [Template({"spectral_index": index}) for index in (1.0, 1.5, 2.0)]

    def finer_templates(self, conditions: Conditions, template: Template) -> list[Template]:  # noqa: ARG002
        """All of them."""
        return self.templates(conditions)

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:
        """P_sky plus the Sun through D."""
        ratio = conditions.frequency_mhz / 55.0
        flux = conditions.sky_at_55[:, None, None] * ratio ** template.parameters["spectral_index"]
        return replace(terms, sky=terms.sky + amount * flux * conditions.sun_response)


@dataclass(frozen=True)
class IonosphericAbsorption(Cause):
    """Absorption in the sunlit lower ionosphere, tau = tau_30 (30 MHz / nu)^2 (cos chi)^n."""

    identifier: str = "ionospheric_absorption"
    unit: str = "tau at 30 MHz, Sun overhead"
    sizes: SizeRange = SizeRange(0.0, 3.0)
    meaning: str = "the daytime ionosphere absorbs"
    confirm: str = "compare with a riometer or with absorption maps from ionosondes"
    needs: str = NO_SUN
    axes: Sequence[str] = ("utc", "date")

    def templates(self, conditions: Conditions) -> list[Template]:
        """Exponents between 0.5 and 1, where the Sun rises and sets in the data."""
        return [Template({"exponent": n}) for n in (0.5, 0.75, 1.0)] if conditions.has_day_and_night else []

    def finer_templates(self, conditions: Conditions, template: Template) -> list[Template]:  # noqa: ARG002
        """All of them."""
        return self.templates(conditions)

    def time_profile(self, conditions: Conditions, template: Template) -> Floats:
        """(cos chi)^n by day, 0 by night."""
        cos_chi = np.maximum(np.sin(conditions.sun_altitude), 0.0)
        return np.asarray((cos_chi ** template.parameters["exponent"])[:, None])

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:  # noqa: ARG002
        """P_sky dimmed."""
        return replace(terms, sky=terms.sky * np.exp(-amount * (30.0 / conditions.frequency_mhz) ** 2))
