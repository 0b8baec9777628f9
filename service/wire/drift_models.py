"""What answers about drift and alarms look like, for the OpenAPI document."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from service.wire.answer_models import Answer
from service.wire.calibration_models import Level, PathAnswer


class DriftVersion(Answer):
    """The band mean of C of a version."""

    calibration: str
    dipole: str | None
    since: str
    until: str
    events: int
    c: float
    c_sigma: float


class DriftMonth(Answer):
    """C of a month over that of the first whole year; the line is offset, season and slope, with one sigma."""

    month: str
    c_ratio: float
    low: float
    high: float
    paths: int
    events: int
    calibration: str | None
    tilt: float | None = Field(description="of ln C: coefficient of the Legendre polynomial 1 over the band")
    curvature: float | None = Field(description="of ln C: coefficient of the Legendre polynomial 2")
    line: float | None
    line_low: float | None
    line_high: float | None


class DriftMember(Answer):
    """A path that steps, or with `antenna` null a polarisation of the station."""

    antenna: int | None
    dipole: str
    size: float
    sigma: float
    significance: float


class DriftShape(Answer):
    """A mode of ln C along frequency."""

    value: float
    sigma: float


class DriftStep(PathAnswer):
    """What changed at a date, beside its station or the other stations; several members have no antenna here."""

    date: str
    date_sigma_days: float
    earliest: str = Field(description="with `latest` the interval that holds 95 %")
    latest: str
    size: float = Field(description="change of C, fraction, of the most significant member")
    sigma: float
    shape: dict[str, DriftShape]
    significance: float
    known: bool = Field(description="the instrument says that the hardware changed then")
    members: list[DriftMember]
    calibration: str | None


class DriftFrequency(Answer):
    """The slope in frequency, a year."""

    mhz: list[float]
    slope: list[float]
    sigma: list[float]


class DriftSlope(Answer):
    """Change of ln C a year; with its error, which holds 68.3 %."""

    slope: float
    sigma: float
    limit_95: float | None = Field(description="half the interval that holds 95 %, of a station or the array")
    years: int | None
    scatter: float | None = Field(description="of a year about the line")
    significance: float | None = Field(description="of a path beside its station, gain and shape together")
    season: float = Field(description="amplitude of the annual term")
    shape: dict[str, DriftShape] | None
    frequency: DriftFrequency | None
    beside: str | None = Field(description="what a path is compared with; null where the slope is that of C itself")


class DriftAnswer(PathAnswer):
    """C over time."""

    scope: Level
    versions: list[DriftVersion]
    months: list[DriftMonth]
    steps: list[DriftStep]
    slope: DriftSlope | None
    threshold_sigma: float | None = Field(description="significance from which on a step or a slope is found")


AlarmKind = Literal[
    "step", "slope", "lost_path", "stale_data", "misfit", "named_cause", "cause_stopped_paying", "failed_job"
]


class AcknowledgementAnswer(Answer):
    """Who knows of a problem."""

    by: str
    at: str
    reason: str
    until: str | None = Field(description="null is for good")


class AlarmAnswer(PathAnswer):
    """A problem."""

    alarm: int
    kind: AlarmKind
    state: Literal["open", "acknowledged", "ended"]
    scope: Level
    sentence: str
    since: str | None = Field(description="when it began")
    since_sigma_days: float | None
    raised_at: str
    seen_at: str = Field(description="when it was found last")
    ended_at: str | None
    acknowledgement: AcknowledgementAnswer | None
    content: dict[str, Any]


class AlarmsAnswer(Answer):
    """A page of alarms."""

    alarms: list[AlarmAnswer]
    next: int | None = Field(description="cursor of the next page")


class CutDecision(Answer):
    """What a person decided about a cut."""

    act: Literal["lifted", "restored"]
    at: str
    by: str
    reason: str


class CutAnswer(Answer):
    """A date at which the windows of an antenna are cut, both dipoles alike."""

    cut: int
    station: str
    antenna: int
    date: str = Field(description="when the antenna changed, as the watch found it first")
    date_sigma_days: float
    stands: bool
    refitted: bool = Field(description="false while one version in effect answers on both sides of a cut that stands")
    made_at: str
    ended_at: str | None = Field(description="when the watch no longer found the change")
    decision: CutDecision | None = Field(description="the last one")


class CutsAnswer(Answer):
    """All cuts on record."""

    cuts: list[CutAnswer]
