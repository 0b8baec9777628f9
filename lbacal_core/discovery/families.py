"""Families of templates of a cause, and their spectra as a scan takes them together.

A template is a spectral template times a time profile. Templates that share the first form a family; families of one
cause with the same profiles are scored together. Spectra that are one spectrum times factors along frequency, as those
of interference lines are, cost little more than that one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lbacal_core.causes.cause import Cause, Conditions, Template, spectral_signature
from lbacal_core.discovery.hypothesis import Target
from lbacal_core.discovery.project import LinearModel
from lbacal_core.discovery.view import SMALLEST_EIGENVALUE, SMALLEST_INFORMATION, ChannelTemplates, Seen, View
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


# How alike templates are, and how much of each the data hold, in the view that shows a target best.


def correlate(model: LinearModel, families: Sequence[SpectralFamily], target: Target) -> Floats:
    """Correlations of all templates of families in the view that shows a target best, shape (template, template).

    The means show the station; the deviation of a typical path shows anything narrower. Rows of templates that are free
    are 0: what is left of them is rounding, which is no trial.
    """
    view, spectra = _best_view(model, target, [FamilySpectra.of(model, [one]) for one in families])
    product = view.products([view.see(one.whole) for one in spectra], [family.profiles for family in families])[0]
    information = np.diag(product)
    # profiling out leaves rounding of what a template had, which grows with the data and with the kernel of the algebra
    smallest = max(SMALLEST_INFORMATION, SMALLEST_EIGENVALUE * information.max(initial=0.0))
    size = np.sqrt(np.where(information > smallest, information, np.inf))
    return np.asarray(product / np.outer(size, size))


def overlap(
    model: LinearModel, cause: Cause, template: Template, target: Target, others: Sequence[SpectralFamily]
) -> list[Floats]:
    """Correlations of one template with all templates of each of some families, as in `correlate`.

    They are scores: the one template stands in the place of the residuals.
    """
    conditions = model.station.conditions
    batches = batch_families(conditions, others, model.station.power[0].size)
    (own,) = group_templates(conditions, cause, [template])
    view, (alone, *spectra) = _best_view(model, target, [FamilySpectra.of(model, batch) for batch in ([own], *batches)])
    values = alone.whole[0] * own.profiles[0][:, None]
    dual, everyone = view.weigh_clean(values)[None], np.ones((1, conditions.time_unix.size))
    length = np.sqrt(view.inner(view.see(values[None]), everyone)[0].item())
    found = []
    for batch, one in zip(batches, spectra, strict=True):
        rows = np.arange(one.values.shape[1])
        templates = one.in_view(view, one.values, np.ones((1, rows.size)), rows)
        score = view.score(templates, batch[0].profiles, dual)[:, 0, 0]
        information = view.inner(templates, batch[0].profiles)[0][:, 0, 0, 0]
        found += list(score / (length * np.sqrt(np.maximum(information, SMALLEST_INFORMATION))))
    return found


def see_best(models: Sequence[LinearModel], family: SpectralFamily, target: Target) -> list[Floats]:
    """Information on a size of 1 with each time profile, in the view of each model that shows a target best.

    The models have the same chain.

    Returns
    -------
    Shape (profile,) for each model.
    """
    spectra = [FamilySpectra.of(models[0], [family])]
    found = []
    for model in models:
        view, (one,) = _best_view(model, target, spectra)
        found.append(view.inner(view.see(one.whole), family.profiles)[0][0, 0, 0])
    return found


def _best_view(
    model: LinearModel, target: Target, spectra: Sequence[FamilySpectra]
) -> tuple[View, list[FamilySpectra]]:
    """The view that shows a target best, and the spectral templates in it, their classes the rows of the view."""
    if target.scope == "station":
        return model.common, [replace(one, values=model.mean_of(one.values, target.is_member)) for one in spectra]
    c = int(model.station.class_of[np.flatnonzero(target.is_member)[0]])
    view = model.lost[int(model.polarisation_of[c])]
    return view, [replace(one, values=one.values[:, c : c + 1]) for one in spectra]


# What nuisances take: causes that differences between sky models hide, and what the noise's vectors take of each.
#
# With the amounts of the differences free without limit, no information on such a cause is left. What their prior
# leaves tells how much models differ, and nothing about the instrument. The noise that events share along frequency
# takes a part of the information on every cause, which the report gives.

NEARLY_FREE = 1e-4
"""Inverse variance of differences a hundred times as large as those of real models."""


@dataclass(frozen=True)
class HiddenCause:
    """A cause of the whole station that the differences between models describe.

    Attributes
    ----------
    share
        Share of its information that is left under the prior.
    sigma, plain_sigma
        Standard deviation of its size with the differences profiled out, and with the sky taken as exact.
    """

    cause: Cause
    share: float
    sigma: float
    plain_sigma: float

    @property
    def why(self) -> str:
        """The reason in a report."""
        return (
            "the differences between sky and antenna models describe its signature: "
            f"{self.share:.1%} of its information is left, one standard deviation is {self.sigma:.2g} "
            f"({self.cause.unit}) instead of {self.plain_sigma:.2g}; a sky power at its word shows it"
        )


def list_hidden(
    model: LinearModel, causes: Sequence[Cause], target: Target, smallest_share: float
) -> list[HiddenCause]:
    """Causes of the whole station of which free differences leave less than `smallest_share` of the information.

    The shares are computed for the data at hand; the list is empty where the sky power is taken as exact.
    """
    if model.modes is None:
        return []
    # A cause that smooth waves along LST describe shows beside them where it is larger than these.
    known = replace(model, modes=replace(model.modes, waves=None))
    plain, free = replace(model, modes=None), replace(known, modes=replace(model.modes, waves=None, prior=NEARLY_FREE))
    hidden = []
    for cause in causes:
        if cause.scopes != ("station",) or "lst" not in cause.axes:
            continue
        families = list_families(model.station.conditions, [cause])
        seen = [see_best((plain, free, known), family, target) for family in families]
        whole, bare, left = (np.array([one[m].max() for one in seen]) for m in range(3))
        if not whole.size or whole.min() <= 0:
            continue
        # A wider prior leaves less; where it leaves more, that is rounding.
        if np.all(np.minimum(bare, left) < smallest_share * whole):
            best = int(np.argmax(left / whole))
            sigma, plain_sigma = float(left[best] ** -0.5), float(whole[best] ** -0.5)
            hidden.append(HiddenCause(cause, float(left[best] / whole[best]), sigma, plain_sigma))
    return hidden


def shares_taken(model: LinearModel, causes: Sequence[Cause], target: Target) -> dict[str, float]:
    """Share of the information on each cause of the station that the vectors of the noise take."""
    levels = model.residuals.levels
    nothing, of_paths = np.zeros_like(levels.common_sum), np.zeros_like(levels.path_shared)
    plain = model.with_levels(replace(levels, path_shared=of_paths, common_sum=nothing, common_difference=nothing))
    taken = {}
    for cause in causes:
        families = list_families(model.station.conditions, [cause]) if "station" in cause.scopes else []
        if families:
            typical = families[len(families) // 2]
            left, whole = see_best((model, plain), typical, target)
            best = int(np.argmax(whole))
            if whole[best] > 0:
                taken[cause.identifier] = float(1.0 - left[best] / whole[best])
    return taken
