"""Causes in the antenna: its dipoles and its resonance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lbacal_core.causes.terms import ChainTerms, Conditions, Law, read_between
from lbacal_core.grids import Floats


@dataclass(frozen=True)
class DipoleSwap:
    """Each dipole records a share of the other's sky; a share of 1 is an exchange."""

    identifier: str = "dipole_swap"
    unit: str = "share, 1 = exchanged"
    meaning: str = "the dipoles X and Y are mixed or exchanged"
    confirm: str = "unplug one dipole, or look at the polarisation of a bright source"
    scopes: Sequence[str] = ("station", "antenna")
    step: float = 1e-3

    def laws(self, conditions: Conditions) -> list[Law]:  # noqa: ARG002
        """One law."""
        return [Law()]

    def why_not(self, conditions: Conditions) -> str | None:  # noqa: ARG002
        """Dipoles of different azimuth see a different sky at any site."""
        return None

    def apply(self, terms: ChainTerms, conditions: Conditions, law: Law, size: float) -> ChainTerms:  # noqa: ARG002
        """P_X -> (1 - f) P_X + f P_Y."""
        return replace(terms, sky=(1.0 - size) * terms.sky + size * conditions.other_sky)


def follow_conditions(conditions: Conditions) -> list[Law]:
    """What a mechanical or chemical property can follow: temperature, season, wetness."""
    laws = [Law({"follows": "temperature"})] if conditions.warmth() is not None else []
    if np.ptp(conditions.time_unix) > 250 * 86_400.0:
        laws += [Law({"follows": "season", "phase_deg": phase}) for phase in (0.0, 45.0, 90.0, 135.0)]
    laws += [
        Law({"follows": "wetness", "law": law})
        for law in ("flag", "linear", "saturating")
        if conditions.wetness(law) is not None
    ]
    return laws


def followed(conditions: Conditions, law: Law) -> Floats:
    """The course of what a law follows, shape (event, 1)."""
    kind = law.parameters["follows"]
    if kind == "season":
        year = 2 * np.pi * conditions.time_unix / (365.25 * 86_400.0)
        return np.asarray(np.cos(year - np.radians(law.parameters["phase_deg"]))[:, None])
    course = conditions.warmth() if kind == "temperature" else conditions.wetness(law.parameters["law"])
    if course is None:
        raise ValueError(f"no {kind} in these data")
    return course


@dataclass(frozen=True)
class ResonanceShift:
    """The resonance moves with the weather."""

    identifier: str = "resonance_shift"
    unit: str = "MHz per 10 K, or at full season or wetness"
    meaning: str = "the antenna's resonance moves with temperature, season or wetness"
    confirm: str = "measure the antenna's impedance warm and cold, dry and wet"
    scopes: Sequence[str] = ("station", "antenna")
    step: float = 0.01

    def laws(self, conditions: Conditions) -> list[Law]:
        """Temperature, season, wetness."""
        return follow_conditions(conditions)

    def why_not(self, conditions: Conditions) -> str | None:
        """A static shift is absorbed by A(nu)."""
        return None if self.laws(conditions) else "no temperature, rain or season in these data; what is static is in A"

    def apply(self, terms: ChainTerms, conditions: Conditions, law: Law, size: float) -> ChainTerms:
        """G_ant read at nu - shift."""
        frequency, log_gain = conditions.frequency_mhz, np.log(conditions.antenna_gain)
        moved = read_between(frequency, log_gain, frequency - size * followed(conditions, law))
        return replace(terms, front=terms.front * np.exp(moved - log_gain))


@dataclass(frozen=True)
class ResonanceWidth:
    """The resonance widens with the weather."""

    identifier: str = "resonance_width"
    unit: str = "fraction per 10 K, or at full season or wetness"
    meaning: str = "the antenna's resonance widens with temperature, season or wetness"
    confirm: str = "measure the antenna's impedance warm and cold, dry and wet"
    scopes: Sequence[str] = ("station", "antenna")
    step: float = 0.002

    def laws(self, conditions: Conditions) -> list[Law]:
        """Temperature, season, wetness."""
        return follow_conditions(conditions)

    def why_not(self, conditions: Conditions) -> str | None:
        """A static width is absorbed by A(nu)."""
        return None if self.laws(conditions) else "no temperature, rain or season in these data; what is static is in A"

    def apply(self, terms: ChainTerms, conditions: Conditions, law: Law, size: float) -> ChainTerms:
        """G_ant read closer to its resonance: the peak keeps its height and widens."""
        frequency, log_gain = conditions.frequency_mhz, np.log(conditions.antenna_gain)
        centre = frequency[np.argmax(conditions.antenna_gain)]
        moved = read_between(
            frequency, log_gain, centre + (frequency - centre) * np.exp(-size * followed(conditions, law))
        )
        return replace(terms, front=terms.front * np.exp(moved - log_gain))
