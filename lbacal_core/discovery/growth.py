"""How a fitted model of spectra or of an LST curve grows: one cause at a time, if the held-out gain is positive."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

Model = TypeVar("Model")
Candidate = TypeVar("Candidate")


class Search(Protocol[Model, Candidate]):
    """The functions that a search needs for one kind of data: spectra, or an LST curve."""

    def propose(self, before: Model) -> Iterable[Candidate]:
        """Fitted models with one more significant cause, best first."""

    def model_of(self, candidate: Candidate) -> Model:
        """The fitted model of a candidate."""

    def held_out_gain(self, before: Model, candidate: Candidate) -> float:
        """Gain in log-likelihood on held-out data."""


@dataclass(frozen=True)
class Step(Generic[Candidate]):
    """An accepted candidate, with its gain on held-out data."""

    candidate: Candidate
    held_out_gain: float


def grow(first: Model, search: Search[Model, Candidate], most: int) -> list[Step[Candidate]]:
    """Add causes one by one, up to `most`, as long as a proposed one has a positive gain on held-out data."""
    model, steps = first, list[Step[Candidate]]()
    while len(steps) < most:
        tried = (Step(one, search.held_out_gain(model, one)) for one in search.propose(model))
        accepted = next((step for step in tried if step.held_out_gain > 0), None)
        if accepted is None:
            break
        steps.append(accepted)
        model = search.model_of(accepted.candidate)
    return steps
