"""How a fitted model grows, from spectra and from LST curves: one cause at a time, if data that were not used agree."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

Model = TypeVar("Model")
Candidate = TypeVar("Candidate")


class Search(Protocol[Model, Candidate]):
    """What one kind of data must give."""

    def propose(self, before: Model) -> Iterable[Candidate]:
        """Models with one cause more that chance does not explain, fitted, best first."""

    def model_of(self, candidate: Candidate) -> Model:
        """The fitted model of a candidate."""

    def held_out_gain(self, before: Model, candidate: Candidate) -> float:
        """Gain in log-likelihood on data that were not used."""


@dataclass(frozen=True)
class Step(Generic[Candidate]):
    """A candidate that was accepted, with its gain on held-out data."""

    candidate: Candidate
    held_out_gain: float


def grow(first: Model, search: Search[Model, Candidate], most: int) -> list[Step[Candidate]]:
    """Take one cause more as long as there is one that held-out data confirm, `most` at the most."""
    model, steps = first, list[Step[Candidate]]()
    while len(steps) < most:
        tried = (Step(one, search.held_out_gain(model, one)) for one in search.propose(model))
        accepted = next((step for step in tried if step.held_out_gain > 0), None)
        if accepted is None:
            break
        steps.append(accepted)
        model = search.model_of(accepted.candidate)
    return steps
