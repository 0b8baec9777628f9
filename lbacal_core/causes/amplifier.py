"""Causes in the low-noise amplifier and in the gain in front of the receiver."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np

from lbacal_core.causes.terms import SCOPES, ChainTerms, Conditions, Law
from lbacal_core.grids import Floats

YEAR_S = 365.25 * 86_400.0
NO_TEMPERATURE = "no temperature column, or gaps in it"


@dataclass(frozen=True)
class LnaNoiseSlope:
    """N_LNA is not flat in frequency."""

    identifier: str = "lna_noise_slope"
    unit: str = "fraction per 25 MHz"
    meaning: str = "the noise of the LNA has a slope in frequency"
    confirm: str = "measure the noise temperature of an LNA on a dummy load"
    scopes: Sequence[str] = ("station",)
    step: float = 1e-3

    def laws(self, conditions: Conditions) -> list[Law]:  # noqa: ARG002
        """One law."""
        return [Law()]

    def why_not(self, conditions: Conditions) -> str | None:  # noqa: ARG002
        """Every band can show it."""
        return None

    def apply(self, terms: ChainTerms, conditions: Conditions, law: Law, size: float) -> ChainTerms:  # noqa: ARG002
        """N_LNA with a slope about 55 MHz."""
        return replace(terms, n_lna=terms.n_lna * (1.0 + size * (conditions.frequency_mhz - 55.0) / 25.0))


@dataclass(frozen=True)
class LnaNoiseTemperature:
    """N_LNA follows temperature."""

    identifier: str = "lna_noise_temperature"
    unit: str = "fraction per 10 K"
    meaning: str = "the noise of the LNA follows temperature"
    confirm: str = "compare nights of equal LST in summer and winter at the lowest frequencies"
    scopes: Sequence[str] = ("station", "antenna", "path")
    step: float = 1e-3

    def laws(self, conditions: Conditions) -> list[Law]:
        """One law, where temperatures are known."""
        return [] if self.why_not(conditions) else [Law()]

    def why_not(self, conditions: Conditions) -> str | None:
        """Needs temperatures."""
        return NO_TEMPERATURE if conditions.warmth() is None else None

    def apply(self, terms: ChainTerms, conditions: Conditions, law: Law, size: float) -> ChainTerms:  # noqa: ARG002
        """N_LNA (1 + a dT / 10 K)."""
        return replace(terms, n_lna=terms.n_lna * (1.0 + size * _warmth(conditions)))


@dataclass(frozen=True)
class GainTemperature:
    """The gain in front of N_RCU follows temperature, with a delay."""

    identifier: str = "gain_temperature"
    unit: str = "fraction per 10 K"
    meaning: str = "the gain in front of the receiver follows temperature"
    confirm: str = "compare the gain by day and by night at equal LST"
    scopes: Sequence[str] = ("station", "antenna", "path")
    step: float = 1e-3

    def laws(self, conditions: Conditions) -> list[Law]:
        """Delays of 0 to 3 h."""
        return [] if self.why_not(conditions) else [Law({"delay_h": delay}) for delay in (0.0, 1.0, 2.0, 3.0)]

    def why_not(self, conditions: Conditions) -> str | None:
        """Needs temperatures."""
        return NO_TEMPERATURE if conditions.warmth() is None else None

    def apply(self, terms: ChainTerms, conditions: Conditions, law: Law, size: float) -> ChainTerms:
        """The front gain times (1 + a dT / 10 K)."""
        return replace(terms, front=terms.front * (1.0 + size * _warmth(conditions, law.parameters["delay_h"])))


@dataclass(frozen=True)
class GainStep:
    """The gain in front of N_RCU steps at a date."""

    identifier: str = "gain_step"
    unit: str = "fraction"
    meaning: str = "the gain stepped at a date"
    confirm: str = "look into the maintenance log of that date"
    scopes: Sequence[str] = SCOPES
    step: float = 1e-3

    def laws(self, conditions: Conditions) -> list[Law]:
        """Dates over the data."""
        return [step_law(instant) for instant in conditions.step_dates()]

    def why_not(self, conditions: Conditions) -> str | None:  # noqa: ARG002
        """Any span of time can show it."""
        return None

    def apply(self, terms: ChainTerms, conditions: Conditions, law: Law, size: float) -> ChainTerms:
        """The front gain times (1 + f) from the date on."""
        after = conditions.after(law.parameters["date_unix"])
        return replace(terms, front=terms.front * (1.0 + size * after))


@dataclass(frozen=True)
class GainDrift:
    """The gain in front of N_RCU drifts."""

    identifier: str = "gain_drift"
    unit: str = "fraction per year"
    meaning: str = "the gain drifts"
    confirm: str = "compare with earlier and later years"
    scopes: Sequence[str] = SCOPES
    step: float = 1e-3

    def laws(self, conditions: Conditions) -> list[Law]:  # noqa: ARG002
        """One law."""
        return [Law()]

    def why_not(self, conditions: Conditions) -> str | None:  # noqa: ARG002
        """Any span of time can show it."""
        return None

    def apply(self, terms: ChainTerms, conditions: Conditions, law: Law, size: float) -> ChainTerms:  # noqa: ARG002
        """The front gain times exp(rate x time)."""
        years = (conditions.time_unix - conditions.time_unix.mean()) / YEAR_S
        return replace(terms, front=terms.front * np.exp(size * years[:, None]))


def step_law(instant: float) -> Law:
    """The law of a step at an instant, with the date in words."""
    return Law({"date_unix": instant, "date": f"{datetime.fromtimestamp(instant, UTC):%Y-%m-%dT%H:%MZ}"})


def _warmth(conditions: Conditions, delay_h: float = 0.0) -> Floats:
    warmth = conditions.warmth(delay_h)
    if warmth is None:
        raise ValueError(NO_TEMPERATURE)
    return warmth
