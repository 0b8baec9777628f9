"""A cause: a physical mechanism with a place in the chain, a family of templates and a signature in the data.

A cause is part of the model, not a patch on residuals: it takes `ChainTerms` and returns changed ones, and the recorded
power follows from eq. full_chain as before. It acts by an amount at each event: its size times the time profile of its
template (a temperature, an hour, a date).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lbacal_core.causes.conditions import Conditions
from lbacal_core.chain.terms import ChainTerms
from lbacal_core.grids import Floats

EDGE = 1e-3
"""Share of a range that counts as its end."""
BEYOND_SIGMA = 3.0
"""Standard deviations by which an error may carry a size beyond a physical end of its range."""
SCOPES = ("path", "antenna", "group", "cable", "station")
"""Kinds of targets: one path, the two paths of an antenna, paths that share hardware, paths of a cable name, the whole
station."""


@dataclass(frozen=True)
class Template:
    """One member of a cause's family: its parameters (a date, a delay, a line) by name."""

    parameters: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class SizeRange:
    """Sizes that a fit far from linear may take.

    Attributes
    ----------
    starts
        Sizes from which it starts.
    physical_end
        An end of the range that is physical, such as 0 for a power, rather than an end of the plausible range.
    """

    lowest: float = -np.inf
    highest: float = np.inf
    starts: Sequence[float] = (0.02,)
    physical_end: float | None = None

    def allows(self, size: float, sigma: float) -> bool:
        """Whether a size found without limits is possible; beyond a physical end the error may have carried it."""
        below, above = (
            BEYOND_SIGMA * sigma if end == self.physical_end else 0.0 for end in (self.lowest, self.highest)
        )
        return self.lowest - below < size < self.highest + above

    def is_at_edge(self, size: float) -> bool:
        """Whether a size has run to the end of the plausible range: the cause then does not describe the data."""
        reach = EDGE * (self.highest - self.lowest)
        if self.physical_end is not None and abs(size - self.physical_end) < reach:
            return False
        return min(size - self.lowest, self.highest - size) < reach


@dataclass(frozen=True)
class Description:
    """The texts about a cause that a reader of reports sees; `docs/causes.md` is written from them.

    Attributes
    ----------
    identifier
        Name in a report.
    unit
        Unit of its size.
    meaning
        What it is, in one clause.
    confirm
        How other means could confirm it.
    needs
        What data must have to show it: the reason in a report where they have not.
    axes
        Axes of the data along which it acts (`lbacal_core.causes.axes`).
    scopes
        Kinds of targets that it can affect, a subset of `SCOPES`.
    """

    identifier: str
    unit: str
    meaning: str
    confirm: str
    needs: str = ""
    axes: Sequence[str] = ("lst",)
    scopes: Sequence[str] = ("station",)


@dataclass(frozen=True)
class Cause(Description):
    """A cause that acts on the chain from event to event.

    Attributes
    ----------
    spectral_parameters
        Names of the parameters that make its spectral template; all others make its time profile.
    step
        A small size, for the derivative of the model.
    largest_step
        Largest change of the size in one step of a fit; infinite where the model is close to linear.
    acts_by_ratio
        Whether it multiplies P_sky by own(with)/own(without), from the package's own sky and antenna.
    sizes
        Sizes that a fit far from linear may take, in units of `scale`.
    whole_array_size, whole_array_meaning
        The one size that it has where it acts on a whole array, and what it then is; None where any size is possible.
    """

    spectral_parameters: Sequence[str] = ()
    step: float = 1e-3
    largest_step: float = np.inf
    acts_by_ratio: bool = False
    sizes: SizeRange = SizeRange()
    whole_array_size: float | None = None
    whole_array_meaning: str = ""

    def templates(self, conditions: Conditions) -> list[Template]:  # noqa: ARG002 - most have one whatever the data
        """The templates of the family that a scan of these data tries; empty where the data cannot show the cause."""
        return [Template()]

    def far_templates(self, conditions: Conditions) -> list[Template]:  # noqa: ARG002
        """Templates whose sizes are far from 0, where the cause does what another does: alternatives, never named."""
        return []

    def sizes_of(self, template: Template) -> SizeRange:  # noqa: ARG002
        """Sizes that a template may take."""
        return self.sizes

    def scale(self, terms: ChainTerms) -> float:  # noqa: ARG002
        """What 1 of its range is in its unit."""
        return 1.0

    def label(self, template: Template) -> str:
        """Identifier, with the parameters of a template."""
        return " ".join([self.identifier, *(str(value) for value in template.parameters.values())])

    def kinds(self, template: Template) -> frozenset[str]:
        """What it does to the power of a band: templates that share a kind are never fitted together."""
        return frozenset({self.label(template)})

    def covariates(self, template: Template) -> Sequence[str]:  # noqa: ARG002
        """Covariates that the template needs: events without them are left out."""
        return ()

    def time_profile(self, conditions: Conditions, template: Template) -> Floats:  # noqa: ARG002
        """When it acts: the factor on its size at each event, shape (event, 1)."""
        return np.ones((conditions.time_unix.size, 1))

    def act(self, terms: ChainTerms, conditions: Conditions, template: Template, amount: Floats) -> ChainTerms:
        """The chain with this cause acting by an amount, shape (event, 1) or scalar; an amount of 0 changes nothing."""
        raise NotImplementedError

    def apply(self, terms: ChainTerms, conditions: Conditions, template: Template, size: float) -> ChainTerms:
        """The chain with this cause at a size."""
        return self.act(terms, conditions, template, size * self.time_profile(conditions, template))

    def finer_templates(self, conditions: Conditions, template: Template) -> list[Template]:  # noqa: ARG002
        """Templates about one that was found, on a finer grid than that of `templates`."""
        return [template]

    def is_another(self, template: Template, earlier: Template) -> bool:  # noqa: ARG002
        """Whether both templates can be present in one target, as two dates, two lines or two sources can."""
        return False

    def spectral_key(self, template: Template) -> tuple[Any, ...]:
        """Key of the spectral template; templates with the same key differ in their time profile alone."""
        return tuple(template.parameters.get(name) for name in self.spectral_parameters)

    def factor(self, conditions: Conditions, template: Template) -> Floats | None:  # noqa: ARG002
        """The spectral template over that of `flat`, shape (freq,); None where it is not a factor along frequency."""
        return None

    def flat(self, template: Template) -> Template:
        """The template with the factor 1 in every channel."""
        return template

    def known_events(self, conditions: Conditions, template: Template) -> NDArray[np.bool_]:
        """Events on which every covariate of the template is known, shape (event,)."""
        return conditions.known_events(*self.covariates(template))


def signature(cause: Cause, terms: ChainTerms, conditions: Conditions, template: Template, size: float = 0.0) -> Floats:
    """Relative change of the recorded power per unit of size, shape (class, event, freq): a central difference."""
    above = cause.apply(terms, conditions, template, size + cause.step).power()
    below = cause.apply(terms, conditions, template, size - cause.step).power()
    return np.asarray((above - below) / (cause.step * (above + below)))


def spectral_signature(cause: Cause, terms: ChainTerms, conditions: Conditions, template: Template) -> Floats:
    """Relative change of the recorded power per unit of amount; times the time profile it is `signature` at 0."""
    above = cause.act(terms, conditions, template, np.array(cause.step)).power()
    below = cause.act(terms, conditions, template, np.array(-cause.step)).power()
    return np.asarray((above - below) / (cause.step * (above + below)))
