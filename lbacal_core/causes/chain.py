"""Causes in amplifier, cable, receiver and digitiser: what they do to the chain, and when."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lbacal_core.causes.cause import (
    FEWEST_KNOWN,
    OF_HARDWARE,
    SCOPES,
    TEMPERATURE,
    Act,
    Cause,
    Conditions,
    SizeRange,
    Template,
    read_between,
)
from lbacal_core.grids import YEAR_S, Floats
from lbacal_core.instrument.chain import ChainTerms

NO_TEMPERATURE = f"no column {TEMPERATURE} that varies and is known on {FEWEST_KNOWN} events"


# What an amount does to the chain, shape (event, 1) or scalar.


def scale_gain(terms: ChainTerms, _: Conditions, amount: Floats) -> ChainTerms:
    """The gain in front of N_RCU times 1 + amount."""
    return replace(terms, front=terms.front * (1.0 + amount))


def scale_lna_noise(terms: ChainTerms, _: Conditions, amount: Floats) -> ChainTerms:
    """N_LNA times 1 + amount."""
    return replace(terms, n_lna=terms.n_lna * (1.0 + amount))


def tilt_lna_noise(terms: ChainTerms, conditions: Conditions, amount: Floats) -> ChainTerms:
    """N_LNA times 1 + amount x (nu - 55 MHz) / 25 MHz."""
    return replace(terms, n_lna=terms.n_lna * (1.0 + amount * (conditions.frequency_mhz - 55.0) / 25.0))


def scale_loss(terms: ChainTerms, conditions: Conditions, amount: Floats) -> ChainTerms:
    """L_coax to the power 1 + amount."""
    return replace(terms, front=terms.front * np.exp(amount * conditions.cable_log_loss[:, None, :]))


def scale_adc_noise(terms: ChainTerms, _: Conditions, amount: Floats) -> ChainTerms:
    """N_ADC times 1 + amount."""
    return replace(terms, adc_noise=terms.adc_noise * (1.0 + amount))


def compress(terms: ChainTerms, _: Conditions, amount: Floats) -> ChainTerms:
    """The gain in front of the converter times 1 - amount x (total power there / its mean - 1)."""
    total = np.sum((terms.sky + terms.n_lna) * terms.front + terms.receiver_noise, axis=-1, keepdims=True)
    factor = 1.0 - amount * (total / total.mean(axis=1, keepdims=True) - 1.0)
    return replace(terms, front=terms.front * factor, receiver_noise=terms.receiver_noise * factor)


def add_jitter(terms: ChainTerms, conditions: Conditions, amount: Floats) -> ChainTerms:
    """N_ADC plus amount x mean power x (integral nu^2 P dnu / its mean)."""
    power = terms.power()
    slope_power = (conditions.frequency_mhz**2 * power).sum(axis=-1, keepdims=True)
    relative = slope_power / slope_power.mean(axis=1, keepdims=True)
    level = power.mean(axis=(1, 2), keepdims=True)
    return replace(terms, adc_noise=terms.adc_noise + amount * level * relative)


# Causes by when they act: those of the catalogue are made of them and of the acts above.


@dataclass(frozen=True)
class TemperatureCause(Cause):
    """A cause that follows temperature without delay."""

    needs: str = NO_TEMPERATURE
    axes: Sequence[str] = ("temperature",)

    def templates(self, conditions: Conditions) -> list[Template]:
        """One, where temperatures are known."""
        return [] if conditions.covariate(TEMPERATURE) is None else [Template()]

    def covariates(self, template: Template) -> Sequence[str]:  # noqa: ARG002
        """Temperature."""
        return (TEMPERATURE,)

    def time_profile(self, conditions: Conditions, template: Template) -> Floats:
        """Temperature about its mean, per 10 K, shape (event, 1)."""
        own = template.parameters
        return conditions.warmth(own.get("delay_h", 0.0), own.get("memory_h", 0.0))


@dataclass(frozen=True)
class StepCause(Cause):
    """A cause that steps at a date."""

    axes: Sequence[str] = ("date",)
    scopes: Sequence[str] = SCOPES

    def templates(self, conditions: Conditions) -> list[Template]:
        """Dates over the data."""
        return [step_template(instant) for instant in conditions.step_dates()]

    def time_profile(self, conditions: Conditions, template: Template) -> Floats:
        """0 before the date and 1 from it on, shape (event, 1)."""
        return conditions.after(template.parameters["date_unix"])

    def finer_templates(self, conditions: Conditions, template: Template) -> list[Template]:
        """The dates of single events."""
        return [step_template(instant) for instant in conditions.dates_about(template.parameters["date_unix"])]

    def is_another(self, template: Template, earlier: Template) -> bool:
        """Whether the dates differ, or one follows temperature alone."""
        return bool(template.parameters.get("date_unix") != earlier.parameters.get("date_unix"))


@dataclass(frozen=True)
class MissingNoise(Cause):
    """Noise beyond the known noise of the baseline."""

    identifier: str = "missing_noise"
    unit: str = "W/MHz, in the unit of P_sky"
    meaning: str = "a stage of electronic noise is missing"
    confirm: str = (
        "measure the noise with a dummy load, or fit event spectra, where noise has another slope in frequency"
    )
    needs: str = (
        "the noise of the fitted model is free: all three stages in event spectra, and the noise share in an LST curve "
        "of an instrument whose noise is not published"
    )

    def templates(self, conditions: Conditions) -> list[Template]:
        """One, where the noise of the baseline is known beforehand."""
        return [] if conditions.known_noise is None else [Template({"known_noise": conditions.known_noise})]

    def label(self, template: Template) -> str:  # noqa: ARG002
        """Its identifier."""
        return self.identifier

    def sizes_of(self, template: Template) -> SizeRange:
        """Noise is never negative: no less than all of the known noise, which `templates` note, is taken away."""
        return SizeRange(-float(template.parameters["known_noise"]), 10.0)

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:  # noqa: ARG002
        """N_LNA plus noise that is flat in frequency.

        The amount is in the unit of P_sky.
        """
        return replace(terms, n_lna=terms.n_lna + amount)

    def scale(self, terms: ChainTerms) -> float:
        """The mean sky power of the band."""
        sky = terms.sky.mean(axis=1)
        return float(np.average(sky, weights=np.broadcast_to(terms.front.mean(axis=1), sky.shape)))

    def kinds(self, template: Template) -> frozenset[str]:  # noqa: ARG002
        """The kind of an isotropic level, which does the same to the power of a band."""
        return frozenset({"isotropic_level"})


@dataclass(frozen=True)
class GainTemperature(TemperatureCause):
    """The gain in front of N_RCU follows temperature, with a delay."""

    identifier: str = "gain_temperature"
    unit: str = "fraction per 10 K"
    sizes: SizeRange = SizeRange(-0.5, 0.5)
    meaning: str = "the gain in front of the receiver follows temperature"
    confirm: str = "compare the gain by day and by night at equal LST"
    axes: Sequence[str] = ("temperature", "utc", "date")
    scopes: Sequence[str] = OF_HARDWARE
    does: Act | None = scale_gain

    def templates(self, conditions: Conditions) -> list[Template]:
        """Delays of 0 to 3 h."""
        known = super().templates(conditions)
        return [Template({"delay_h": delay}) for delay in (0.0, 1.0, 2.0, 3.0)] if known else []

    def finer_templates(self, conditions: Conditions, template: Template) -> list[Template]:  # noqa: ARG002
        """Delays by half hours, and a memory in which a diurnal wave is half of itself.

        In a longer one it hardly shows: what is left is the season, which two steps of a gain in a year are as well.
        """
        return [*(Template({"delay_h": 0.5 * k}) for k in range(7)), Template({"memory_h": 6.0})]


@dataclass(frozen=True)
class GainDrift(Cause):
    """The gain in front of N_RCU drifts."""

    identifier: str = "gain_drift"
    unit: str = "fraction per year"
    sizes: SizeRange = SizeRange(-1.0, 1.0)
    meaning: str = "the gain drifts"
    confirm: str = "compare with earlier and later years"
    axes: Sequence[str] = ("date",)
    scopes: Sequence[str] = SCOPES
    does: Act | None = scale_gain

    def time_profile(self, conditions: Conditions, template: Template) -> Floats:  # noqa: ARG002
        """Years since the mean instant of the data, shape (event, 1)."""
        return np.asarray((conditions.time_unix - conditions.time_unix.mean())[:, None] / YEAR_S)


@dataclass(frozen=True)
class FilterShift(StepCause):
    """The receiver's filter moves in frequency, with temperature or at a date."""

    identifier: str = "filter_shift"
    unit: str = "fraction at 10 K, or the step"
    sizes: SizeRange = SizeRange(-0.1, 0.1)
    meaning: str = "the receiver's filter moves in frequency"
    confirm: str = "measure the pass band of the receiver again"
    axes: Sequence[str] = ("date", "temperature")
    scopes: Sequence[str] = OF_HARDWARE
    step: float = 1e-4

    def templates(self, conditions: Conditions) -> list[Template]:
        """Temperature, and steps at dates."""
        steps = super().templates(conditions)
        return steps if conditions.covariate(TEMPERATURE) is None else [Template({"follows": "temperature"}), *steps]

    def covariates(self, template: Template) -> Sequence[str]:
        """Temperature, where that is followed."""
        return () if "date_unix" in template.parameters else (TEMPERATURE,)

    def time_profile(self, conditions: Conditions, template: Template) -> Floats:
        """Temperature about its mean, per 10 K, or 1 from the date on where the template has one, shape (event, 1)."""
        if "date_unix" in template.parameters:
            return super().time_profile(conditions, template)
        return conditions.warmth()

    def finer_templates(self, conditions: Conditions, template: Template) -> list[Template]:
        """The dates of single events."""
        return super().finer_templates(conditions, template) if "date_unix" in template.parameters else [template]

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:  # noqa: ARG002
        """G_RCU read at nu (1 + s), s the amount."""
        frequency, log_gain = conditions.frequency_mhz, np.log(conditions.receiver_gain)
        factor = np.exp(read_between(frequency, log_gain, frequency * (1.0 + amount)) - log_gain)
        return replace(terms, front=terms.front * factor, receiver_noise=terms.receiver_noise * factor)


def step_template(instant: float) -> Template:
    """The template of a step at an instant."""
    return Template({"date_unix": instant})
