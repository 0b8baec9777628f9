"""Causes in the cable, the receiver and the digitiser that act from event to event."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lbacal_core.causes.amplifier import StepCause, TemperatureCause, step_template
from lbacal_core.causes.cause import TEMPERATURE, Cause, Conditions, SizeRange, Template, read_between
from lbacal_core.grids import Floats
from lbacal_core.instrument.chain import ChainTerms


@dataclass(frozen=True)
class CableTemperature(TemperatureCause):
    """The cable's loss in dB follows temperature."""

    identifier: str = "cable_temperature"
    unit: str = "fraction per 10 K"
    sizes: SizeRange = SizeRange(-1.0, 1.0)
    meaning: str = "the loss of the cables (in dB) follows temperature"
    confirm: str = "compare short and long cables by day and by night"
    scopes: Sequence[str] = ("station", "cable", "group", "antenna")

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:  # noqa: ARG002
        """L_coax to the power (1 + a dT / 10 K)."""
        return replace(terms, front=terms.front * np.exp(amount * conditions.cable_log_loss[:, None, :]))


@dataclass(frozen=True)
class FilterShift(Cause):
    """The receiver's filter moves in frequency, with temperature or at a date."""

    identifier: str = "filter_shift"
    unit: str = "fraction at 10 K, or the step"
    sizes: SizeRange = SizeRange(-0.1, 0.1)
    meaning: str = "the receiver's filter moves in frequency"
    confirm: str = "measure the pass band of the receiver again"
    axes: Sequence[str] = ("date", "temperature")
    scopes: Sequence[str] = ("station", "group", "antenna", "path")
    step: float = 1e-4

    def templates(self, conditions: Conditions) -> list[Template]:
        """Temperature, and steps at dates."""
        steps = [step_template(instant) for instant in conditions.step_dates()]
        return steps if conditions.covariate(TEMPERATURE) is None else [Template({"follows": "temperature"}), *steps]

    def covariates(self, template: Template) -> Sequence[str]:
        """Temperature, where that is followed."""
        return () if "date_unix" in template.parameters else (TEMPERATURE,)

    def time_profile(self, conditions: Conditions, template: Template) -> Floats:
        """Temperature about its mean, per 10 K, or 1 from the date on where the template has one, shape (event, 1)."""
        if "date_unix" in template.parameters:
            return conditions.after(template.parameters["date_unix"])
        return conditions.warmth()

    def finer_templates(self, conditions: Conditions, template: Template) -> list[Template]:
        """The dates of single events."""
        if "date_unix" not in template.parameters:
            return [template]
        return [step_template(instant) for instant in conditions.dates_about(template.parameters["date_unix"])]

    def is_another(self, template: Template, earlier: Template) -> bool:
        """Whether the dates differ, or one follows temperature alone."""
        return bool(template.parameters.get("date_unix") != earlier.parameters.get("date_unix"))

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:  # noqa: ARG002
        """G_RCU read at nu (1 + s), s the amount."""
        frequency, log_gain = conditions.frequency_mhz, np.log(conditions.receiver_gain)
        factor = np.exp(read_between(frequency, log_gain, frequency * (1.0 + amount)) - log_gain)
        return replace(terms, front=terms.front * factor, receiver_noise=terms.receiver_noise * factor)


@dataclass(frozen=True)
class AdcNoiseStep(StepCause):
    """N_ADC steps at a date."""

    identifier: str = "adc_noise_step"
    unit: str = "fraction"
    sizes: SizeRange = SizeRange(-1.0, 100.0)
    meaning: str = "the noise of the digitiser stepped at a date"
    confirm: str = "look into the maintenance log of that date"

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:  # noqa: ARG002
        """N_ADC times (1 + f) from the date on."""
        return replace(terms, adc_noise=terms.adc_noise * (1.0 + amount))


@dataclass(frozen=True)
class Compression(Cause):
    """The gain of a path falls as its total power rises."""

    identifier: str = "compression"
    unit: str = "fraction"
    meaning: str = "the gain falls when the total power rises"
    confirm: str = "insert an attenuator and look whether the ratio of strong to weak sky changes"
    scopes: Sequence[str] = ("station", "group", "antenna", "path")
    sizes: SizeRange = SizeRange(0.0, 1.0)

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:  # noqa: ARG002
        """The gain in front of the converter times 1 - f (total power there / its mean - 1)."""
        total = np.sum((terms.sky + terms.n_lna) * terms.front + terms.receiver_noise, axis=-1, keepdims=True)
        factor = 1.0 - amount * (total / total.mean(axis=1, keepdims=True) - 1.0)
        return replace(terms, front=terms.front * factor, receiver_noise=terms.receiver_noise * factor)


@dataclass(frozen=True)
class AdcJitter(Cause):
    """Jitter of the sampling clock adds white noise that follows the signal's slope."""

    identifier: str = "adc_jitter"
    unit: str = "fraction of the mean power"
    sizes: SizeRange = SizeRange(0.0, 1.0)
    meaning: str = "clock jitter adds white noise that follows the signal"
    confirm: str = "feed a sine of rising frequency and watch the noise floor"
    scopes: Sequence[str] = ("station", "group", "antenna", "path")
    step: float = 1e-4

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:  # noqa: ARG002
        """N_ADC plus f x mean power x (integral nu^2 P dnu / its mean)."""
        power = terms.power()
        slope_power = (conditions.frequency_mhz**2 * power).sum(axis=-1, keepdims=True)
        relative = slope_power / slope_power.mean(axis=1, keepdims=True)
        level = power.mean(axis=(1, 2), keepdims=True)
        return replace(terms, adc_noise=terms.adc_noise + amount * level * relative)
