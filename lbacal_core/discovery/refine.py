"""The law of a cause more closely than the scan tries them, and how sure a size is where the law is not.

A scan tries hours, dates and indices on a grid. About the law that it finds, all laws that the cause knows are scored,
and the best is taken. Laws that fit nearly as well have other sizes: their scatter, weighed with their likelihoods,
belongs to the uncertainty of the size.
"""

from __future__ import annotations

import numpy as np

from lbacal_core.causes.terms import Law
from lbacal_core.discovery.evidence import Evidence
from lbacal_core.discovery.scan import INDISTINGUISHABLE, Score, group_laws, score_shapes


def refine_law(evidence: Evidence, score: Score) -> tuple[Law, float]:
    """The best law about one that was found, and the scatter of the size among those left open, a fraction of it."""
    conditions, cause = evidence.data.conditions, score.cause
    laws = cause.finer_laws(conditions, score.law)
    if len(laws) == 1:
        return laws[0], 0.0
    found, z, effect = [], [], []
    for batch, of_batch, size in score_shapes(evidence, group_laws(conditions, cause, laws), [score.target]):
        # Sizes under other laws compare by what they do on average where they act.
        course = batch[0].courses.values
        strength = np.abs(course).sum(axis=1) / np.maximum((course != 0).sum(axis=1), 1)
        found += [law for shape in batch for law in shape.laws]
        z.append(of_batch[:, 0].ravel())
        effect.append((size[:, 0] * strength).ravel())
    gain, change = np.concatenate(z) ** 2, np.concatenate(effect)
    # What is there at some hours is not missing at the others.
    is_positive = change > 0
    if np.any(is_positive) and gain[is_positive].max() > gain.max() - INDISTINGUISHABLE:
        gain = np.where(is_positive, gain, 0.0)
    best = int(np.argmax(gain))
    weight = np.exp(0.5 * (gain - gain[best])) * (np.sign(change) == np.sign(change[best]))
    scatter = np.sqrt(weight @ (change / change[best] - 1.0) ** 2 / weight.sum())
    return found[best], float(scatter)
