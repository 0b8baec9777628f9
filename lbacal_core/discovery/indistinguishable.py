"""Causes that the data cannot tell apart from one that was found, at its size and by what they show."""

from __future__ import annotations

import numpy as np

from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.discovery.correlations import overlap
from lbacal_core.discovery.families import group_templates, list_families
from lbacal_core.discovery.hypothesis import Hypothesis
from lbacal_core.discovery.policy import Policy
from lbacal_core.discovery.project import LinearModel
from lbacal_core.discovery.scan import score_families

HALF_ALIKE = 0.5
"""Correlation below which a template does not stand for another: it would need twice the other's score."""


def find_indistinguishable(model: LinearModel, hypothesis: Hypothesis, policy: Policy) -> list[tuple[str, float]]:
    """Causes with a template that the data cannot distinguish from the one found, with the largest such correlation.

    Beside such a template the one found adds little to chi^2, (z - r z_other)^2 / (1 - r^2). If the one found is the
    truth, this is SNR^2 (1 - r^2) on average; if the other is the truth, the data alone show it: both are asked.

    Parameters
    ----------
    model
        The residuals with everything fitted but the one found.
    """
    conditions, own, target = model.station.conditions, hypothesis.cause, hypothesis.target
    others = [cause for cause in CAUSES if cause is not own and target.scope in cause.scopes]
    known = model.on_events(own.known_events(conditions, hypothesis.template))
    families = list_families(conditions, others)
    correlations = overlap(known, own, hypothesis.template, target, families)
    snr = abs(hypothesis.size / hypothesis.sigma)
    found: dict[str, float] = {}

    def add(name: str, correlation: float) -> None:
        found[name] = max(found.get(name, 0.0), correlation)

    for one, correlation in zip(families, correlations, strict=True):
        largest = float(np.abs(correlation).max())
        if snr**2 * (1 - min(largest, 1.0) ** 2) < policy.indistinguishable:
            add(one.cause.identifier, largest)
    alike = [k for k, r in enumerate(correlations) if np.abs(r).max() > HALF_ALIKE]
    ((_, z, _),) = score_families(known, group_templates(conditions, own, [hypothesis.template]), [target])
    scores = [z for _, batch, _ in score_families(known, [families[k] for k in alike], [target]) for z in batch[:, 0]]
    for k, z_other in zip(alike, scores, strict=True):
        r = np.clip(correlations[k], -1.0, 1.0)
        added = (z.item() - r * z_other) ** 2
        stands_for_it = (np.abs(r) > HALF_ALIKE) & (added < policy.indistinguishable * (1.0 - r**2))
        if np.any(stands_for_it):
            add(families[k].cause.identifier, float(np.abs(r[stands_for_it]).max()))
    return sorted(found.items(), key=lambda item: -item[1])
