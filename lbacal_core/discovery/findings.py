"""The findings of a station: causes by which its model grows, and what each of them adds beside the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lbacal_core.discovery.growth import grow
from lbacal_core.discovery.hypothesis import Hypothesis, Target
from lbacal_core.discovery.indistinguishable import find_indistinguishable
from lbacal_core.discovery.open_noise import AveragedSize, average_size
from lbacal_core.discovery.policy import Policy
from lbacal_core.discovery.proposals import StationSearch, chi_squared_of, gain_of
from lbacal_core.discovery.refit import FittedModel, refit
from lbacal_core.discovery.scan import Score
from lbacal_core.grids import Floats


@dataclass(frozen=True)
class Finding:
    """A cause that these data show, with its score, its gain in chi^2 and its gain on held-out events.

    Attributes
    ----------
    indistinguishable
        Causes that fit as well at the size found, with the correlation of their templates.
    calibration_change
        Relative change of C of the target's paths, shape (path, freq).
    over_noise
        Its size averaged over the noise constants that the fit leaves open; None where the data tell them apart.
    """

    hypothesis: Hypothesis
    score: Score
    indistinguishable: list[tuple[str, float]]
    chi2_before: float
    chi2_after: float
    dof: int
    held_out_gain: float
    calibration_change: Floats
    over_noise: AveragedSize | None = None

    @property
    def size(self) -> tuple[float, float]:
        """The size with its standard deviation."""
        if self.over_noise is None:
            return self.hypothesis.size, self.hypothesis.uncertainty
        return self.over_noise.size, self.over_noise.sigma


@dataclass(frozen=True)
class Grown:
    """A model grown as far as held-out events confirm it.

    Attributes
    ----------
    others
        The last model without each of its hypotheses.
    findings
        One a hypothesis beside the adopted ones.
    """

    last: FittedModel
    others: list[FittedModel]
    findings: list[Finding]


def grow_findings(first: FittedModel, search: StationSearch) -> Grown:
    """Grow a model by one cause after the other, and take out again what adds nothing beside those found later.

    The first cause of a large effect may be another one that resembles it, before the right one is found beside it.
    """
    steps = grow(first, search, search.policy.most_findings)
    models = [first, *(step.candidate.model for step in steps)]
    scores = [step.candidate.score for step in steps]
    while True:
        without = [_models_without(models, number, search.adopted) for number in range(len(scores))]
        findings = [
            _finding(without[number][-1], models[-1], search.adopted + number, score, search.policy)
            for number, score in enumerate(scores)
        ]
        idle = None if search.again is not None else _idle(findings, without)
        if idle is None:
            return Grown(models[-1], [others[-1] for others in without], findings)
        models, scores = without[idle], scores[:idle] + scores[idle + 1 :]


def _idle(findings: Sequence[Finding], without: Sequence[Sequence[FittedModel]]) -> int | None:
    """Number of the finding that adds least beside the others, if held-out events say that it adds nothing."""
    number = int(np.argmin([one.held_out_gain for one in findings])) if findings else 0
    if not findings or findings[number].held_out_gain > 0:
        return None
    beside = without[number]
    # A model that could not be fitted stands for the one before it, and lacks more than this finding.
    is_fitted = len(beside[-1].hypotheses) == len(beside[0].hypotheses) + len(beside) - 1
    return number if is_fitted else None


def _finding(without: FittedModel, last: FittedModel, number: int, score: Score, policy: Policy) -> Finding:
    """A finding by the last fitted model and the one without it, so that all its numbers are of one model."""
    hypothesis = last.hypotheses[number]
    chi2_before, chi2_after, dof = chi_squared_of(without, last)
    return Finding(
        hypothesis=hypothesis,
        score=score,
        indistinguishable=find_indistinguishable(without.linear, hypothesis, policy),
        chi2_before=chi2_before,
        chi2_after=chi2_after,
        dof=dof,
        held_out_gain=gain_of(without, hypothesis, score),
        calibration_change=_calibration_change(without, last, hypothesis.target),
        over_noise=average_size(last, number),
    )


def _models_without(models: Sequence[FittedModel], number: int, adopted: int) -> list[FittedModel]:
    """The models that grew, without one hypothesis: the residuals of the last contain the whole effect of that one."""
    kept = list(models[: number + 1])
    for hypothesis in models[-1].hypotheses[adopted + number + 1 :]:
        kept.append(refit(kept[-1], hypothesis, models[-1].noise) or kept[-1])
    return kept


def _calibration_change(before: FittedModel, after: FittedModel, target: Target) -> Floats:
    """Relative change of C of the target's paths, shape (path, freq): C is proportional to slope^(-1/2)."""
    old, new = before.baseline.solution.x[target.is_member], after.baseline.solution.x[target.is_member]
    # A slope that the noise makes negative, in the weakest channels, has no C to change.
    has_c = (old > 0) & (new > 0)
    return np.asarray(np.sqrt(np.divide(old, new, out=np.ones_like(old), where=has_c)) - 1.0)
