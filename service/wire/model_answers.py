"""What answers about the models of stations look like, for the OpenAPI document."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from service.wire.answer_models import Answer
from service.wire.calibration_models import ChangesAnswer


class GainAnswer(Answer):
    """What a cause gained on the events of a window that its adoption had not seen, sizes as adopted."""

    since: str
    until: str
    events: int
    log_likelihood_gain: float
    expected: float
    expected_sigma: float


class AdoptedCauseAnswer(Answer):
    """A cause that is part of a model."""

    cause: str
    target: str
    parameters: dict[str, Any]
    size: float = Field(description="as adopted, in `unit`")
    sigma: float
    unit: str
    is_free: bool = Field(description="whether fits fit the size again")
    since: str | None
    until: str | None
    sentence: str
    gains: list[GainAnswer] = Field(description="on later events, by window")


class ModelLine(Answer):
    """What a station had from an adoption or a withdrawal on."""

    id: str
    station: str
    act: Literal["adopted", "withdrawn"]
    before: str
    in_effect: bool = Field(description="whether the station has it now")
    changed: str = Field(description="the cause that was adopted or withdrawn, in one sentence")
    investigation: str | None
    finding: int | None = Field(description="its number in the report; null where it is structure without a name")
    promise: list[float] | None = Field(description="gain in log-likelihood that the finding promised, and its error")
    at: str
    by: str
    reason: str
    causes: list[AdoptedCauseAnswer]


class ModelsAnswer(Answer):
    """A page of models."""

    models: list[ModelLine]
    next: int | None = Field(description="cursor of the next page")


class AdoptionAnswer(Answer):
    """The model that a station has from now on, and the jobs of the refits."""

    model: str
    jobs: list[int]


class AdoptionPlanAnswer(ChangesAnswer):
    """The model that a station would have, and what its fits of the investigated year change."""

    model: str
    cause: str = Field(description="what would be adopted, in one sentence")
    promise: list[float] = Field(description="gain in log-likelihood on as many events again, and its error")
