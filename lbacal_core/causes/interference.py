"""Causes from outside that are not the sky: radio-frequency interference left in the spectra."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lbacal_core.causes.terms import ChainTerms, Conditions, Law

WINDOWS = tuple((begin, (begin + 12) % 24) for begin in range(0, 24, 2)) + tuple(
    (begin, (begin + 6) % 24) for begin in range(0, 24, 3)
)
"""UTC hours that are tried: halves and quarters of the day."""


def has_all_hours(conditions: Conditions) -> bool:
    """Whether the events cover day and night, so that hours can be told apart."""
    return bool(np.histogram(conditions.utc_hours, bins=8, range=(0, 24))[0].min() > 3)


@dataclass(frozen=True)
class RfiLine:
    """A narrow line left in one channel or two at some hours."""

    identifier: str = "rfi_line"
    unit: str = "fraction of the mean power there"
    meaning: str = "a narrow line of interference is left at some hours"
    confirm: str = "look at the unbinned spectra of those hours"
    scopes: Sequence[str] = ("station", "antenna")
    step: float = 1e-3

    def laws(self, conditions: Conditions) -> list[Law]:
        """Every channel, one or two channels wide, at halves and quarters of the day."""
        if self.why_not(conditions):
            return []
        frequency = conditions.frequency_mhz
        return [
            Law({"frequency_mhz": float(centre), "utc_h": [begin, end]})
            for centre in frequency
            for begin, end in WINDOWS
        ]

    def why_not(self, conditions: Conditions) -> str | None:
        """A line that never stops is absorbed by A(nu) and the noise constants."""
        return None if has_all_hours(conditions) else "the events do not cover day and night"

    def apply(self, terms: ChainTerms, conditions: Conditions, law: Law, size: float) -> ChainTerms:
        """Power added to a channel within the hours."""
        channel = (np.abs(conditions.frequency_mhz - law.parameters["frequency_mhz"]) < 1e-6).astype(float)
        inside = conditions.in_hours(*law.parameters["utc_h"])
        mean = terms.power().mean(axis=1, keepdims=True)
        return replace(terms, adc_noise=terms.adc_noise + size * inside * channel * mean)


@dataclass(frozen=True)
class RfiBroadband:
    """Broad-band interference at some hours, with a power law in frequency."""

    identifier: str = "rfi_broadband"
    unit: str = "fraction of the mean power at 55 MHz"
    meaning: str = "broad-band interference is left at some hours"
    confirm: str = "look for its direction by correlating antennas at those hours"
    scopes: Sequence[str] = ("station",)
    step: float = 1e-3

    def laws(self, conditions: Conditions) -> list[Law]:
        """Spectral indices 0 to -4 at halves and quarters of the day."""
        if self.why_not(conditions):
            return []
        return [
            Law({"spectral_index": index, "utc_h": [begin, end]})
            for index in (0.0, -1.0, -2.0, -3.0, -4.0)
            for begin, end in WINDOWS
        ]

    def why_not(self, conditions: Conditions) -> str | None:
        """Needs day and night."""
        return None if has_all_hours(conditions) else "the events do not cover day and night"

    def apply(self, terms: ChainTerms, conditions: Conditions, law: Law, size: float) -> ChainTerms:
        """Power in front of the antenna's amplifier, as a fraction of the mean sky power at 55 MHz."""
        inside = conditions.in_hours(*law.parameters["utc_h"])
        ratio = conditions.frequency_mhz / 55.0
        at_55 = np.array([np.interp(55.0, conditions.frequency_mhz, sky) for sky in conditions.mean_sky])
        added = at_55[:, None, None] * ratio ** law.parameters["spectral_index"] * inside
        return replace(terms, sky=terms.sky + size * added)
