"""What answers look like, for the OpenAPI document; tests hold the answers against them."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field


class Answer(BaseModel):
    """Base of all answers: nothing that is not told."""

    model_config = ConfigDict(strict=True, extra="forbid")


class ReceiptAnswer(Answer):
    """What became of a batch of spectra."""

    received: int
    stored: int
    duplicates: int = Field(description="there already, with the same content")


class ReceiptsAnswer(Answer):
    """Bodies whose spectra are all stored."""

    stored: list[str] = Field(description="SHA-256 of their bytes")


class EventAnswer(Answer):
    """An air shower and what is stored of it."""

    event_id: str
    time_utc: str
    spectra: int
    stations: list[str]
    flag: str | None = Field(description="why it is left out of fits")
    env: dict[str, float | None] = Field(description="covariates by name")


class EventsAnswer(Answer):
    """A page of events."""

    events: list[EventAnswer]
    next: int | None = Field(description="cursor of the next page")


class RefitAnswer(Answer):
    """What was enqueued."""

    job: int


class JobAnswer(Answer):
    """A job and how far it is."""

    job: int
    kind: str
    state: Literal["queued", "running", "done", "failed", "cancelled"]
    progress: float = Field(ge=0, le=1, description="fraction of its parts that were worked on to their end")
    calibrations: list[str] = Field(description="ids of the versions made, or found made before")
    promoted: list[str] = Field(description="ids of those put into effect")
    gated: dict[str, str] = Field(description="why the others wait, by id")
    examined: int = Field(description="fits that moved C too little to be kept")
    results: list[str]
    error: str | None
    request: dict[str, Any]
    reason: str
    by: str
    created_at: str


class JobsAnswer(Answer):
    """A page of jobs."""

    jobs: list[JobAnswer]
    next: int | None = Field(description="cursor of the next page")
