"""Causes in the low-noise amplifier and in the gain in front of the receiver."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lbacal_core.causes.cause import FEWEST_KNOWN, SCOPES, TEMPERATURE, YEAR_S, Cause, Conditions, SizeRange, Template
from lbacal_core.grids import Floats
from lbacal_core.instrument.chain import ChainTerms

NO_TEMPERATURE = f"no column {TEMPERATURE} that varies and is known on {FEWEST_KNOWN} events"


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
        return conditions.warmth(template.parameters.get("delay_h", 0.0))


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
        """Whether the dates differ."""
        return bool(template.parameters["date_unix"] != earlier.parameters["date_unix"])


@dataclass(frozen=True)
class LnaNoiseSlope(Cause):
    """N_LNA is not flat in frequency."""

    identifier: str = "lna_noise_slope"
    unit: str = "fraction per 25 MHz"
    meaning: str = "the noise of the LNA has a slope in frequency"
    confirm: str = "measure the noise temperature of an LNA on a dummy load"
    sizes: SizeRange = SizeRange(-1.0, 1.0)

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:  # noqa: ARG002
        """N_LNA with a slope about 55 MHz.

        It is multiplied by 1 + amount (nu - 55 MHz) / 25 MHz.
        """
        return replace(terms, n_lna=terms.n_lna * (1.0 + amount * (conditions.frequency_mhz - 55.0) / 25.0))


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
class LnaNoiseTemperature(TemperatureCause):
    """N_LNA follows temperature."""

    identifier: str = "lna_noise_temperature"
    unit: str = "fraction per 10 K"
    sizes: SizeRange = SizeRange(-0.5, 0.5)
    meaning: str = "the noise of the LNA follows temperature"
    confirm: str = "compare nights of equal LST in summer and winter at the lowest frequencies"
    scopes: Sequence[str] = ("station", "group", "antenna", "path")

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:  # noqa: ARG002
        """N_LNA (1 + a dT / 10 K)."""
        return replace(terms, n_lna=terms.n_lna * (1.0 + amount))


@dataclass(frozen=True)
class GainTemperature(TemperatureCause):
    """The gain in front of N_RCU follows temperature, with a delay."""

    identifier: str = "gain_temperature"
    unit: str = "fraction per 10 K"
    sizes: SizeRange = SizeRange(-0.5, 0.5)
    meaning: str = "the gain in front of the receiver follows temperature"
    confirm: str = "compare the gain by day and by night at equal LST"
    axes: Sequence[str] = ("temperature", "utc", "date")
    scopes: Sequence[str] = ("station", "group", "antenna", "path")

    def templates(self, conditions: Conditions) -> list[Template]:
        """Delays of 0 to 3 h."""
        known = super().templates(conditions)
        return [Template({"delay_h": delay}) for delay in (0.0, 1.0, 2.0, 3.0)] if known else []

    def finer_templates(self, conditions: Conditions, template: Template) -> list[Template]:  # noqa: ARG002
        """Delays by half hours."""
        return [Template({"delay_h": 0.5 * k}) for k in range(7)]

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:  # noqa: ARG002
        """The front gain times (1 + a dT / 10 K)."""
        return replace(terms, front=terms.front * (1.0 + amount))


@dataclass(frozen=True)
class GainStep(StepCause):
    """The gain in front of N_RCU steps at a date."""

    identifier: str = "gain_step"
    unit: str = "fraction"
    sizes: SizeRange = SizeRange(-1.0, 10.0)
    meaning: str = "the gain stepped at a date"
    confirm: str = "look into the maintenance log of that date"

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:  # noqa: ARG002
        """The front gain times (1 + f) from the date on."""
        return replace(terms, front=terms.front * (1.0 + amount))


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

    def time_profile(self, conditions: Conditions, template: Template) -> Floats:  # noqa: ARG002
        """Years since the mean instant of the data, shape (event, 1)."""
        return np.asarray((conditions.time_unix - conditions.time_unix.mean())[:, None] / YEAR_S)

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:  # noqa: ARG002
        """The front gain times 1 + rate x time."""
        return replace(terms, front=terms.front * (1.0 + amount))


def step_template(instant: float) -> Template:
    """The template of a step at an instant."""
    return Template({"date_unix": instant})
