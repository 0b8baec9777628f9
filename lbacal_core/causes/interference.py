"""Causes from outside that are not the sky: radio-frequency interference left in the spectra."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lbacal_core.causes.cause import Cause, Conditions, SizeRange, Template
from lbacal_core.chain.model import ChainTerms
from lbacal_core.grids import Floats

CLEAR_MHZ = 4.0
"""Distance below which two lines are one disturbance, whose spectrum is not that of a line."""
WINDOWS = ((0, 24), *((begin, (begin + hours) % 24) for hours in (12, 6) for begin in range(24)))
"""UTC hours of the templates: the whole day, and halves and quarters of it from every hour."""


@dataclass(frozen=True)
class InterferenceCause(Cause):
    """Power from outside at some hours of the day."""

    needs: str = "the events do not cover all hours of the day"
    axes: Sequence[str] = ("utc",)

    def time_profile(self, conditions: Conditions, template: Template) -> Floats:
        """1 within the hours."""
        return conditions.in_hours(*template.parameters["utc_h"])

    def finer_templates(self, conditions: Conditions, template: Template) -> list[Template]:  # noqa: ARG002
        """Hours that begin and end some earlier or later, or all others: power cannot be missing."""
        return [
            Template({**what, "utc_h": list(window)})
            for what in self.what_about(template)
            for window in _windows_about(*template.parameters["utc_h"])
        ]

    def what_about(self, template: Template) -> list[dict[str, float]]:
        """Frequencies, widths or indices about those of a template."""
        raise NotImplementedError


@dataclass(frozen=True)
class RfiLine(InterferenceCause):
    """A narrow line left in one channel or a few at some hours."""

    identifier: str = "rfi_line"
    unit: str = "fraction of the mean power in its strongest channel"
    sizes: SizeRange = SizeRange(0.0, 1e3)
    meaning: str = "a narrow line of interference is left"
    confirm: str = "look at the unbinned spectra of those hours"
    scopes: Sequence[str] = ("station", "antenna")
    spectral_parameters: Sequence[str] = ("frequency_mhz", "width_mhz")

    def templates(self, conditions: Conditions) -> list[Template]:
        """Every channel, one channel or some three wide, at halves and quarters of the day."""
        if not conditions.has_all_hours:
            return []
        return [
            Template({"frequency_mhz": float(centre), "width_mhz": width, "utc_h": list(window)})
            for centre in conditions.frequency_mhz
            for width in (0.5, 2.0)
            for window in WINDOWS
        ]

    def is_another(self, template: Template, earlier: Template) -> bool:
        """Another line, clear of the first."""
        distance = abs(template.parameters["frequency_mhz"] - earlier.parameters["frequency_mhz"])
        return bool(distance > CLEAR_MHZ)

    def factor(self, conditions: Conditions, template: Template) -> Floats:
        """The form of the line, 1 in its strongest channel."""
        distance = conditions.frequency_mhz - template.parameters["frequency_mhz"]
        line = np.exp(-4 * np.log(2.0) * (distance / template.parameters["width_mhz"]) ** 2)
        return np.asarray(line / line.max())

    def flat(self, template: Template) -> Template:
        """A line without end."""
        return Template({**template.parameters, "width_mhz": np.inf})

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:
        """Power added about a frequency, a Gaussian of the template's full width at half maximum."""
        mean = terms.power().mean(axis=1, keepdims=True)
        return replace(terms, adc_noise=terms.adc_noise + amount * self.factor(conditions, template) * mean)

    def what_about(self, template: Template) -> list[dict[str, float]]:
        """Between the channels, and other widths."""
        centre = template.parameters["frequency_mhz"]
        moved = [centre + 0.25 * k for k in range(-2, 3)]
        return [{"frequency_mhz": at, "width_mhz": width} for at in moved for width in (0.5, 1.0, 1.5, 2.0)]


@dataclass(frozen=True)
class RfiBroadband(InterferenceCause):
    """Broad-band interference at some hours, with a power law in frequency."""

    identifier: str = "rfi_broadband"
    unit: str = "fraction of the mean sky power at 55 MHz"
    sizes: SizeRange = SizeRange(0.0, 1e2)
    meaning: str = "broad-band interference is left"
    confirm: str = "look for its direction by correlating antennas at those hours"
    spectral_parameters: Sequence[str] = ("spectral_index",)

    def templates(self, conditions: Conditions) -> list[Template]:
        """Spectral indices 0 to -4 at halves and quarters of the day."""
        if not conditions.has_all_hours:
            return []
        indices = (0.0, -1.0, -2.0, -3.0, -4.0)
        return [Template({"spectral_index": index, "utc_h": list(window)}) for index in indices for window in WINDOWS]

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:
        """Power in front of the antenna's amplifier, as a fraction of the mean sky power at 55 MHz."""
        ratio = conditions.frequency_mhz / 55.0
        added = conditions.sky_at_55[:, None, None] * ratio ** template.parameters["spectral_index"]
        return replace(terms, sky=terms.sky + amount * added)

    def what_about(self, template: Template) -> list[dict[str, float]]:  # noqa: ARG002
        """All indices, by halves."""
        return [{"spectral_index": -0.5 * k} for k in range(9)]


def _windows_about(begin: int, end: int) -> list[tuple[int, int]]:
    """Windows that begin and last up to three hours more or less, and the rest of the day."""
    if (begin, end) == (0, 24):
        return [(0, 24)]
    near = {
        ((begin + b) % 24, (begin + b + hours) % 24)
        for b in range(-3, 4)
        for hours in range((end - begin) % 24 - 3, (end - begin) % 24 + 4)
    }
    return sorted(near | {(last, first) for first, last in near})
