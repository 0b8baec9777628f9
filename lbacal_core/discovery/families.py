"""Families of templates of a cause, and their spectra as a scan takes them together.

A template is a spectral template times a time profile. Templates that share the first form a family; families of one
cause with the same profiles are scored together. Spectra that are one spectrum times factors along frequency, as those
of interference lines are, cost little more than that one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lbacal_core.causes.cause import Cause, Template, spectral_signature
from lbacal_core.causes.conditions import Conditions
from lbacal_core.discovery.project import LinearModel
from lbacal_core.discovery.view import ChannelTemplates, Seen, View
from lbacal_core.grids import Floats

BATCH_SIZE = 200_000
"""Values of the templates that are scored together: 1.6 MB stay in a fast memory."""
MOST_FACTORS = 256
"""Factors along frequency that are scored together."""


@dataclass(frozen=True)
class SpectralFamily:
    """Templates of a cause that share their spectral template and differ in their time profile alone."""

    cause: Cause
    templates: Sequence[Template]
    profiles: Floats

    def known_events(self, conditions: Conditions) -> NDArray[np.bool_]:
        """Events on which the covariates of these templates are known, shape (event,)."""
        return self.cause.known_events(conditions, self.templates[0])


def group_templates(conditions: Conditions, cause: Cause, templates: Sequence[Template]) -> list[SpectralFamily]:
    """Group templates of a cause by spectral template and covariates; families with equal profiles share them."""
    groups: dict[tuple[object, ...], list[Template]] = {}
    for template in templates:
        alike = (*cause.spectral_key(template), cause.known_events(conditions, template).tobytes())
        groups.setdefault(alike, []).append(template)
    families, known = [], dict[str, Floats]()
    for members in groups.values():
        when = [{k: v for k, v in one.parameters.items() if k not in cause.spectral_parameters} for one in members]
        key = str(when)
        if key not in known:
            known[key] = np.stack([cause.time_profile(conditions, one)[:, 0] for one in members])
        families.append(SpectralFamily(cause, members, known[key]))
    return families


def list_families(conditions: Conditions, causes: Sequence[Cause]) -> list[SpectralFamily]:
    """All templates of causes on these data."""
    return [family for cause in causes for family in group_templates(conditions, cause, cause.templates(conditions))]


def batch_families(conditions: Conditions, families: Sequence[SpectralFamily], size: int) -> list[list[SpectralFamily]]:
    """Families of one cause with the same time profiles together, as many as fit into a fast memory.

    Factors along frequency need little of it.
    """
    batches: list[list[SpectralFamily]] = []
    for family in families:
        last = batches[-1] if batches else []
        has_factor = family.cause.factor(conditions, family.templates[0]) is not None
        most = MOST_FACTORS if has_factor else max(1, BATCH_SIZE // size)
        if last and last[0].cause is family.cause and last[0].profiles is family.profiles and len(last) < most:
            last.append(family)
        else:
            batches.append([family])
    return batches


@dataclass(frozen=True)
class FamilySpectra:
    """The spectral templates of families of one cause: each by itself, or as one spectrum times factors.

    Attributes
    ----------
    values
        Shape (family, class, event, freq), or 1 for family where there are factors.
    factors
        Shape (family, freq), or None.
    """

    values: Floats
    factors: Floats | None

    @classmethod
    def of(cls, model: LinearModel, batch: Sequence[SpectralFamily]) -> FamilySpectra:
        """The spectral templates of a batch."""
        cause, conditions = batch[0].cause, model.station.conditions
        first = [one.templates[0] for one in batch]
        factors = [factor for one in first if (factor := cause.factor(conditions, one)) is not None]
        shown = [cause.flat(first[0])] if factors else first
        values = np.stack([spectral_signature(cause, model.terms, conditions, one) for one in shown])
        return cls(values, np.stack(factors) if factors else None)

    @property
    def whole(self) -> Floats:
        """Every spectral template, shape (family, class, event, freq)."""
        return self.values if self.factors is None else np.asarray(self.values * self.factors[:, None, None])

    def in_view(self, view: View, values: Floats, shares: Floats, row_of: NDArray[np.int64]) -> Seen | ChannelTemplates:
        """The templates as a view sees them, shape (family, part).

        Parameters
        ----------
        values
            Spectra in rows of the view, shape (family, k, event, freq).
        shares
            Parts in which they act together, shape (part, k).
        row_of
            Row of each, shape (k,).
        """
        if self.factors is not None:
            return ChannelTemplates(values[0], row_of, shares, self.factors)
        alone = np.zeros((len(values), len(shares), *view.slope.shape))
        for k, share in enumerate(shares.T):
            alone[:, :, row_of[k]] += share[:, None, None] * values[:, None, k]
        return view.see(alone)
