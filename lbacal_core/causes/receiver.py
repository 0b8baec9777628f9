"""Causes in the cable, the receiver and the digitiser that act from event to event."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lbacal_core.causes.amplifier import NO_TEMPERATURE, step_law
from lbacal_core.causes.terms import SCOPES, ChainTerms, Conditions, Law, read_between


@dataclass(frozen=True)
class CableTemperature:
    """The cable's loss in dB follows temperature."""

    identifier: str = "cable_temperature"
    unit: str = "fraction per 10 K"
    meaning: str = "the loss of the cables (in dB) follows temperature"
    confirm: str = "compare short and long cables by day and by night"
    scopes: Sequence[str] = ("station", "cable")
    step: float = 1e-3

    def laws(self, conditions: Conditions) -> list[Law]:
        """One law, where temperatures are known."""
        return [] if self.why_not(conditions) else [Law()]

    def why_not(self, conditions: Conditions) -> str | None:
        """Needs temperatures."""
        return NO_TEMPERATURE if conditions.warmth() is None else None

    def apply(self, terms: ChainTerms, conditions: Conditions, law: Law, size: float) -> ChainTerms:  # noqa: ARG002
        """L_coax to the power (1 + a dT / 10 K)."""
        warmth = conditions.warmth()
        if warmth is None:
            raise ValueError(NO_TEMPERATURE)
        return replace(terms, front=terms.front * np.exp(size * warmth * conditions.cable_log_loss[:, None, :]))


@dataclass(frozen=True)
class FilterShift:
    """The receiver's filter moves in frequency, with temperature or at a date."""

    identifier: str = "filter_shift"
    unit: str = "fraction at 10 K, or the step"
    meaning: str = "the receiver's filter moves in frequency"
    confirm: str = "measure the pass band of the receiver again"
    scopes: Sequence[str] = ("station", "antenna", "path")
    step: float = 1e-4

    def laws(self, conditions: Conditions) -> list[Law]:
        """Temperature, and steps at dates."""
        laws = [Law({"follows": "temperature"})] if conditions.warmth() is not None else []
        return laws + [step_law(instant) for instant in conditions.step_dates(24)]

    def why_not(self, conditions: Conditions) -> str | None:  # noqa: ARG002
        """A step can always be looked for; what is static is absorbed by A(nu)."""
        return None

    def apply(self, terms: ChainTerms, conditions: Conditions, law: Law, size: float) -> ChainTerms:
        """G_RCU read at nu (1 + s)."""
        if "date_unix" in law.parameters:
            course = conditions.after(law.parameters["date_unix"])
        else:
            warmth = conditions.warmth()
            if warmth is None:
                raise ValueError(NO_TEMPERATURE)
            course = warmth
        frequency, log_gain = conditions.frequency_mhz, np.log(conditions.receiver_gain)
        factor = np.exp(read_between(frequency, log_gain, frequency * (1.0 + size * course)) - log_gain)
        return replace(terms, front=terms.front * factor, receiver_noise=terms.receiver_noise * factor)


@dataclass(frozen=True)
class AdcNoiseStep:
    """N_ADC steps at a date."""

    identifier: str = "adc_noise_step"
    unit: str = "fraction"
    meaning: str = "the noise of the digitiser stepped at a date"
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
        """N_ADC times (1 + f) from the date on."""
        after = conditions.after(law.parameters["date_unix"])
        return replace(terms, adc_noise=terms.adc_noise * (1.0 + size * after))


@dataclass(frozen=True)
class Compression:
    """The gain of a path falls as its total power rises."""

    identifier: str = "compression"
    unit: str = "fraction"
    meaning: str = "the gain falls when the total power rises"
    confirm: str = "insert an attenuator and look whether the ratio of strong to weak sky changes"
    scopes: Sequence[str] = ("station", "antenna", "path")
    step: float = 1e-3

    def laws(self, conditions: Conditions) -> list[Law]:  # noqa: ARG002
        """One law."""
        return [Law()]

    def why_not(self, conditions: Conditions) -> str | None:  # noqa: ARG002
        """The Galaxy's rise and fall shows it."""
        return None

    def apply(self, terms: ChainTerms, conditions: Conditions, law: Law, size: float) -> ChainTerms:  # noqa: ARG002
        """The recorded power times 1 - f (total power / its mean - 1)."""
        total = terms.power().sum(axis=-1, keepdims=True)
        return replace(terms, whole=terms.whole * (1.0 - size * (total / total.mean(axis=1, keepdims=True) - 1.0)))


@dataclass(frozen=True)
class AdcJitter:
    """Jitter of the sampling clock adds white noise that follows the signal's slope."""

    identifier: str = "adc_jitter"
    unit: str = "fraction of the mean power"
    meaning: str = "clock jitter adds white noise that follows the signal"
    confirm: str = "feed a sine of rising frequency and watch the noise floor"
    scopes: Sequence[str] = ("station", "path")
    step: float = 1e-4

    def laws(self, conditions: Conditions) -> list[Law]:  # noqa: ARG002
        """One law."""
        return [Law()]

    def why_not(self, conditions: Conditions) -> str | None:  # noqa: ARG002
        """The Galaxy's rise and fall shows it."""
        return None

    def apply(self, terms: ChainTerms, conditions: Conditions, law: Law, size: float) -> ChainTerms:  # noqa: ARG002
        """N_ADC plus f x mean power x (integral nu^2 P dnu / its mean)."""
        power = terms.power()
        slope_power = (conditions.frequency_mhz**2 * power).sum(axis=-1, keepdims=True)
        course = slope_power / slope_power.mean(axis=1, keepdims=True)
        level = power.mean(axis=(1, 2), keepdims=True)
        return replace(terms, adc_noise=terms.adc_noise + size * level * course)
