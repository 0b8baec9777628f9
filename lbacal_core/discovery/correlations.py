"""How alike templates are, and how much of each the data hold, in the view that shows a target best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lbacal_core.causes.cause import Cause, Template
from lbacal_core.discovery.families import FamilySpectra, SpectralFamily, batch_families, group_templates
from lbacal_core.discovery.hypothesis import Target
from lbacal_core.discovery.project import LinearModel
from lbacal_core.discovery.view import SMALLEST_EIGENVALUE, SMALLEST_INFORMATION, View
from lbacal_core.grids import Floats


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
