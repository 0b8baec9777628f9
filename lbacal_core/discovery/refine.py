"""The law of a cause more closely than the scan tries them, and how sure a size is where the law is not.

A scan tries hours, dates and indices on a grid. About the law that it finds, all laws that the cause knows are scored,
and the best is taken. Laws that fit nearly as well have other sizes: their scatter, weighed with their likelihoods,
belongs to the uncertainty of the size.
"""

from __future__ import annotations

import numpy as np

from lbacal_core.discovery.evidence import Evidence
from lbacal_core.discovery.extend import Effect
from lbacal_core.discovery.scan import INDISTINGUISHABLE, Score, group_laws, score_shapes


def refine(evidence: Evidence, score: Score) -> Effect:
    """The effect that a scan found, under the best of the laws about the one tried, at the size to first order."""
    conditions, cause = evidence.data.conditions, score.cause
    laws = cause.finer_laws(conditions, score.law)
    if len(laws) == 1:
        return Effect(cause, laws[0], score.target, score.size)
    found, scores, sizes, strengths = [], [], [], []
    for batch, z, size in score_shapes(evidence, group_laws(conditions, cause, laws), [score.target]):
        course = batch[0].courses.values
        strength = np.abs(course).sum(axis=1) / np.maximum((course != 0).sum(axis=1), 1)
        found += [law for shape in batch for law in shape.laws]
        scores.append(z[:, 0].ravel())
        sizes.append(size[:, 0].ravel())
        strengths.append(np.tile(strength, len(batch)))
    gain, size = np.concatenate(scores) ** 2, np.concatenate(sizes)
    # What is there at some hours is not missing at the others.
    if np.any(size > 0) and gain[size > 0].max() > gain.max() - INDISTINGUISHABLE:
        gain = np.where(size > 0, gain, 0.0)
    best = int(np.argmax(gain))
    # Sizes under other laws compare by what they do on average where they act.
    change = size * np.concatenate(strengths)
    weight = np.exp(0.5 * (gain - gain[best])) * (np.sign(change) == np.sign(change[best]))
    scatter = np.sqrt(weight @ (change / change[best] - 1.0) ** 2 / weight.sum())
    return Effect(cause, found[best], score.target, float(size[best]), law_sigma=float(scatter))
