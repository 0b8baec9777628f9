"""What answers look like, for the OpenAPI document; tests hold the answers against them."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, Field, create_model

INSTANT = "an instant, which values of the service hold in microseconds"
Moment = Annotated[str, INSTANT]
MomentOrNone = Annotated[str | None, INSTANT]


class Answer(BaseModel, strict=True, extra="forbid"):
    """Base of all answers: nothing that is not told."""


def _page(noun: str, of: type[Answer], cursor: type[int | str], field: str = "") -> type[Answer]:
    """A page of a list of answers, with the cursor of the next one."""
    following: Any = (cursor | None, Field(description="cursor of the next page"))
    items: dict[str, Any] = {field or noun: (list[of], ...)}  # type: ignore[valid-type] # an argument
    name, told = f"{noun.capitalize()}Answer", f"A page of {noun}."
    return create_model(name, __base__=Answer, __doc__=told, **items, next=following)


class ReceiptAnswer(Answer):
    """The result of storing a batch of spectra."""

    received: int
    stored: int
    duplicates: int = Field(description="there already, with the same content")
    warnings: list[str] | None = Field(
        None,
        description="paths whose level is far from what is stored; in no fit before the night. Covariates that differ "
        "from what is stored, which stays. Absent where none is",
    )
    covariates: int | None = Field(None, description="how many became known of events that were there; absent where 0")


class ReceiptsAnswer(Answer):
    """Bodies whose spectra are all stored."""

    stored: list[str] = Field(description="SHA-256 of their bytes")
    warnings: list[str] = Field(description="what was said of them when they were stored")


class EventAnswer(Answer):
    """An air shower and what is stored of it."""

    event_id: str
    time_utc: str
    spectra: int
    stations: list[str]
    waiting: int = Field(description="spectra whose level is far from what was stored: in no fit until it lasts")
    flag: str | None = Field(description="why it is left out of fits")
    env: dict[str, float | None] = Field(description="covariates by name")


EventsAnswer = _page("events", EventAnswer, int)


class RefitAnswer(Answer):
    """The job that was enqueued."""

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
    created_at: Moment


JobsAnswer = _page("jobs", JobAnswer, int)
# What answers about calibrations, drift and the state of the service look like, for the OpenAPI document.

Level = Literal["array", "station", "antenna"]


class AliveAnswer(Answer):
    """The process lives."""

    status: Literal["alive"]


class ReadyAnswer(Answer):
    """The service can do its work."""

    status: Literal["ready"]
    instrument: str


class ProcessAnswer(Answer):
    """A process of the service."""

    name: str
    kind: Literal["api", "scheduler", "worker"]
    alive: bool
    silent_s: float = Field(description="time since it said that it lives, s")
    started_at: Moment


class FailureAnswer(Answer):
    """A job that failed and that nothing made up for."""

    job: int
    kind: str
    request: dict[str, Any]
    error: str
    tries: int
    again_after: str | None = Field(description="when it is tried again; null where nobody will unless asked")


class InvestigationLine(Answer):
    """An investigation without its report."""

    id: str
    station: str
    since: Moment
    until: Moment
    verdict: str = Field(description="consistent, explained or unexplained")
    findings: list[str] = Field(description="causes found, most significant first")
    made_at: Moment
    made_by: str
    reason: str


class NewsAnswer(InvestigationLine):
    """The newest investigation of a station, against the one before."""

    before: str | None = Field(description="id of the one before; null where there is none")
    new: list[str] = Field(description="findings that the one before did not have")
    stronger: list[str] = Field(description="findings whose significance rose by 2 standard deviations or more")
    gone: list[str] = Field(description="findings that only the one before has")


class AlarmCountsAnswer(Answer):
    """Alarms that last, by kind."""

    line: str = Field(description="all of it in one line")
    open: dict[str, int]
    acknowledged: dict[str, int]
    new: int = Field(description="raised within a day")


class StatusAnswer(Answer):
    """The status for an operator."""

    ready: bool
    problem: str | None
    processes: list[ProcessAnswer]
    parts: dict[str, int] = Field(description="parts of jobs by state; ended ones of the last 30 days")
    stuck: list[str]
    events: int
    newest_event: MomentOrNone
    gated: int = Field(description="versions that the gate kept back and nobody promoted")
    alarms: AlarmCountsAnswer
    investigations: list[NewsAnswer] = Field(description="the newest of every station")
    not_refitted: list[str] = Field(description="changes that were found while C in effect is the mean over them")
    stopped_paying: list[str] = Field(description="adopted causes that gain less on new events than they should")
    failures: list[FailureAnswer]


class PathAnswer(Answer):
    """A path, a station (antenna and dipole null) or the array (all null)."""

    station: str | None
    antenna: int | None
    dipole: str | None


class Fitted(Answer):
    """A number and its standard deviation."""

    value: float
    sigma: float


class CurveAnswer(PathAnswer, extra="allow"):
    """A curve as in fit.json (docs/formats/fit-report.md), which may hold more fields than these."""

    status: str
    events: int
    frequency_mhz: list[float]
    c: list[float | None] | None = Field(description="C(nu), V per ADC unit")
    c_sigma_stat: list[float | None] | None
    c_sigma_sys: list[float | None] | None
    chi2_per_dof: float | None
    lst_coverage: float
    parameters: dict[str, Fitted]


class Stretch(Answer, populate_by_name=True):
    """A half-open interval; null is open."""

    start: MomentOrNone = Field(alias="from")
    end: MomentOrNone = Field(alias="to")


class Validity(Stretch):
    """A half-open interval; `to` null is open."""

    start: Moment = Field(alias="from")


class ReferenceAnswer(Answer):
    """The reference chain from which the curve of a wider scope was converted."""

    paths: int = Field(description="how many paths it is the mean of")
    cable: str | None = Field(description="of the path")
    cables: str = Field(description="hash of the cable table")
    spreads: str | None = Field(description="hash of the departures of single paths")
    jensen: list[float] | None


class TraceAnswer(Answer):
    """A promotion on the way from the narrowest scope to the one that answered."""

    scope: Level
    promotion: int
    calibration: str | None
    at: Moment


class EpochAnswer(Stretch):
    """A time in which nothing changed that is in force, or in the records of the antenna."""

    because: int | None = Field(description="the change that began it; null where a record did")


class CurveInEffectAnswer(CurveAnswer):
    """The curve that answers for a path, through the path's own cable."""

    calibration: str
    answered_by: Level
    factor: list[float] = Field(description="C told over C of the stored curve")
    factor_sigma: float = Field(description="standard deviation of what follows ramps and seasons in it, a fraction")
    flag: list[Literal["ok", "uncertain", "interference", "outside"]]
    flag_reason: str | None
    reference: ReferenceAnswer | None
    valid: Validity
    held: bool
    trace: list[TraceAnswer]
    epoch: EpochAnswer
    why: str = Field(description="why it is this version, in a sentence")


class BudgetTermAnswer(Answer):
    """One source of systematic error."""

    name: str
    source: str
    is_of_gain: bool = Field(description="an error of G_ant, which cancels in C/|H|")
    vectors: dict[str, list[list[float]]] = Field(description="by polarisation: d ln C, one standard deviation each")


class BudgetAnswer(Answer):
    """The systematic terms that curves share."""

    frequency_mhz: list[float]
    terms: list[BudgetTermAnswer]


class InEffectAnswer(Answer, extra="allow"):
    """The calibration in effect at an instant."""

    at: Moment
    as_of: str | None = Field(description="as it was asked")
    curves: list[CurveInEffectAnswer]
    budgets: dict[str, BudgetAnswer] = Field(description="by hash, those that the curves name")
    missing: list[PathAnswer] = Field(description="paths for which nothing is in effect")


class EventNoiseAnswer(Answer):
    """How the power of single events scatters, as a fraction of the expectation."""

    shared: list[list[float]] = Field(description="what channels share, one standard deviation each, independent")
    own: list[float] = Field(description="variance of each channel by itself")
    common: float = Field(description="share of the first vector's variance that all paths of a station have in common")
    source: str


class PredictionAnswer(Answer):
    """The expected power of a path at an instant, on the channels in which C is known."""

    at: Moment
    calibration: str
    answered_by: str
    station: str
    antenna: int
    dipole: str
    lst_h: float
    frequency_mhz: list[float]
    power: list[float] = Field(description="expected")
    power_unit: str
    covariance: list[list[float]] = Field(description="how well the expected power is known, without noise of events")
    contributions: dict[str, dict[str, list[float] | None]] = Field(description="by source: kelvin, and fraction")
    adc: dict[str, float | list[float]] | None = Field(description="r.m.s. of the samples by the channels' power")
    sefd_jy: list[float] = Field(description="flux of an unpolarised zenith source that doubles the power, Jy")
    sefd_sigma: list[float]
    noise: EventNoiseAnswer
    notes: list[str] = Field(description="what is not in it")


class StationEdges(Answer):
    """A station and where its answers change; null is the array's reference chain."""

    station: str | None
    antennas: list[int]
    dipoles: list[str]
    edges: list[str]


class EdgesAnswer(Answer):
    """Where answers change."""

    as_of: Moment
    stations: list[StationEdges]


class VersionAnswer(PathAnswer, extra="allow"):
    """A version without its curves."""

    id: str
    scope: Level
    since: Moment
    until: Moment
    status: str
    events: int
    model: str | None = Field(description="id of the model, where causes were adopted into it")
    gate: str | None = Field(description="why it was not promoted by itself")
    made_at: Moment
    made_by: str
    reason: str
    payload_sha256: str
    inputs: dict[str, Any]


VersionsAnswer = _page("versions", VersionAnswer, str, "calibrations")


class WholeVersionAnswer(VersionAnswer):
    """A version with its curves."""

    curves: list[CurveAnswer]
    reference: dict[str, Any] | None = Field(description="reference chains by dipole")


class DiffCurve(Answer):
    """The change of C at one dipole."""

    dipole: str | None
    frequency_mhz: list[float]
    fraction: list[float | None]
    sigma: list[float | None]
    max_fraction: float
    max_sigma: float


class DiffAnswer(Answer):
    """How the second version differs from the first."""

    first: str
    second: str
    curves: list[DiffCurve]
    inputs: dict[str, Any]


class ChangeAnswer(Validity, PathAnswer):
    """The change by a promotion for a path over an interval."""

    before: str | None
    after: str | None
    max_fraction: float | None
    max_sigma: float | None
    mean_c: list[float] | None = Field(description="mean of C over the band before and after, V per ADC unit")


class ChangesAnswer(Answer):
    """The changes by a promotion."""

    changes: list[ChangeAnswer]


class PromotionLine(PathAnswer):
    """One line of the ledger."""

    promotion: int
    scope: Level
    valid_from: Moment
    valid_to: MomentOrNone
    calibration: str | None
    at: Moment
    by: str
    reason: str


class PromotionAnswer(ChangesAnswer, PromotionLine, extra="allow"):
    """A promotion and what it changes."""


class PromotionsAnswer(ChangesAnswer):
    """Promotions made as one act, none for a dry run, and what they change."""

    promotions: list[PromotionLine]
    left_out: dict[str, str] = Field(description="versions that are not promoted, and their status")


class TagAnswer(Answer):
    """A name under which the ledger is frozen."""

    name: str
    as_of: Moment
    at: Moment = Field(description="when it was made")
    by: str
    reason: str


TagsAnswer = _page("tags", TagAnswer, str)
InvestigationsAnswer = _page("investigations", InvestigationLine, str)


class InvestigationAnswer(InvestigationLine):
    """An investigation as it was made."""

    inputs: dict[str, Any] = Field(description="what it was made from; the id is their hash")
    report: dict[str, Any] = Field(description="the report, as `lbacal investigate` writes it")


# What answers about drift and alarms look like, for the OpenAPI document.


class DriftVersion(Answer):
    """The band mean of C of a version."""

    calibration: str
    dipole: str | None
    since: Moment
    until: Moment
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
    shape: dict[str, Fitted] = Field(default={}, description="modes of ln C along frequency")
    significance: float


class DriftStep(PathAnswer):
    """A step at a date, relative to the station or the other stations; several members have no antenna here."""

    date: Moment
    date_sigma_days: float
    earliest: str = Field(description="with `latest` the interval that holds 95 %")
    latest: str
    size: float = Field(description="change of C, fraction, of the most significant member")
    sigma: float
    shape: dict[str, Fitted] = Field(description="modes of ln C along frequency")
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
    shape: dict[str, Fitted] | None
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
    "step",
    "slope",
    "lost_path",
    "left_out",
    "lost_c",
    "retracted",
    "stale_data",
    "misfit",
    "named_cause",
    "cause_stopped_paying",
    "failed_job",
]


class AcknowledgementAnswer(Answer):
    """The person who acknowledged a problem."""

    by: str
    at: Moment
    reason: str
    until: MomentOrNone = Field(description="null is for good")


class AlarmAnswer(PathAnswer):
    """A problem."""

    alarm: int
    kind: AlarmKind
    state: Literal["open", "acknowledged", "ended"]
    scope: Level
    sentence: str
    since: MomentOrNone = Field(description="when it began")
    since_sigma_days: float | None
    raised_at: Moment
    seen_at: Moment = Field(description="when it was found last")
    ended_at: MomentOrNone
    acknowledgement: AcknowledgementAnswer | None
    content: dict[str, Any]


AlarmsAnswer = _page("alarms", AlarmAnswer, int)


class DatedAnswer(Answer):
    """An instant with its standard deviation."""

    value: Moment
    sigma_days: float


class SizeAnswer(Fitted):
    """A change of C."""

    unit: Literal["fraction of C"] = "fraction of C"


class EvidenceAnswer(Answer, populate_by_name=True):
    """The source of a change."""

    source: Literal["drift", "investigation", "record", "person"] = Field(alias="from")
    ref: str = Field(description="id of the investigation and number of the finding, or who entered it")
    significance_sigma: float | None
    made_at: Moment
    ended_at: MomentOrNone = Field(description="when the source no longer said so, or said another date or size")
    at: DatedAnswer | None = Field(description="date of the change since then; null where it kept the one that it had")
    size: SizeAnswer | None = Field(description="size since then; null where it kept the one that it had")


class OwnSizeAnswer(SizeAnswer):
    """A change of C of one path."""

    antenna: int
    dipole: str


class PathChangeAnswer(Answer):
    """A change with its date, origin and decision: one row whoever found it."""

    id: int
    paths: list[PathAnswer] | None = Field(description="null for a whole station or the array")
    station: str | None
    array: bool
    at: DatedAnswer = Field(description="as found first, or moved since by more than its error")
    kind: Literal["step", "ramp", "season", "course"]
    size: SizeAnswer | None = Field(description="of a ramp, in a year; of a season, its amplitude")
    own_sizes: list[OwnSizeAnswer] = Field(description="of paths that changed by another amount")
    shape: list[float] | None = Field(description="the same along frequency")
    in_words: str = Field(description="by how much C changed, along frequency where that is plain")
    evidence: list[EvidenceAnswer]
    decision: Literal["proposed", "in_force", "dismissed"]
    by: str
    reason: str
    refitted: bool = Field(description="false while one version in effect answers on both sides of it")
    cuts_windows: bool = Field(
        description="whether windows are cut there: a step in force whose date is known to 90 days"
    )
    doubts: list[str] = Field(description="what spectra, or other changes on record, say against it")
    made_at: Moment
    ended_at: MomentOrNone = Field(description="when the last source no longer said so")


class PathChangesAnswer(Answer):
    """Changes on record."""

    changes: list[PathChangeAnswer]


class DecidedAnswer(PathChangeAnswer):
    """A change as it is decided, and the curves that its paths would be served by fits of its year."""

    changes: list[ChangeAnswer]
    left_out: dict[str, str] = Field(description="versions that the gate will keep back, and why")


# What answers about the models of stations look like, for the OpenAPI document.


class GainAnswer(Answer):
    """The gain of a cause on the events of a window that its adoption had not used, sizes as adopted."""

    since: Moment
    until: Moment
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
    since: MomentOrNone
    until: MomentOrNone
    sentence: str
    gains: list[GainAnswer] = Field(description="on later events, by window")


class ModelLine(Answer):
    """The model of a station from an adoption or a withdrawal on."""

    id: str
    station: str
    act: Literal["adopted", "withdrawn"]
    before: str
    in_effect: bool = Field(description="whether the station has it now")
    changed: str = Field(description="the cause that was adopted or withdrawn, in one sentence")
    investigation: str | None
    finding: int | None = Field(description="its number in the report; null where it is structure without a name")
    promise: list[float] | None = Field(description="gain in log-likelihood that the finding promised, and its error")
    at: Moment
    by: str
    reason: str
    causes: list[AdoptedCauseAnswer]


ModelsAnswer = _page("models", ModelLine, int)


class AdoptionAnswer(Answer):
    """The model that a station has from now on, and the jobs of the refits."""

    model: str
    jobs: list[int]


class AdoptionPlanAnswer(ChangesAnswer):
    """The model that a station would have, and what its fits of the investigated year change."""

    model: str
    cause: str = Field(description="what would be adopted, in one sentence")
    promise: list[float] = Field(description="gain in log-likelihood on as many events again, and its error")


class FactorAnswer(Answer):
    """C that follows ramps and seasons over C of its version, mean over the band, and its standard deviation."""

    at: Moment
    value: float
    sigma: float


class InEffectStretch(Stretch):
    """Which version answered when."""

    calibration: str
    factor: list[FactorAnswer] | None = Field(description="every 30 days; null where C stands still")


class BadPathAnswer(Answer):
    """A path that is not to be used, and one reason."""

    station: str
    antenna: int
    dipole: str
    kind: Literal["silent", "insensitive", "weak"]
    since: Moment
    reason: str
    source: str = Field(description="where that stands")


class BadAntennasAnswer(Answer):
    """Paths not to be used at an instant, one line a reason; none where nothing is known against any."""

    at: Moment
    bad: list[BadPathAnswer]
    calibrated: int = Field(description="paths with C in effect then; where there are none, nothing is known of any")


class LifeAnswer(Answer):
    """All that is known of a path, a station or the array, each in order of time."""

    epochs: list[EpochAnswer]
    in_effect: list[InEffectStretch]
    withdrawals: list[PromotionLine] = Field(description="of its own versions and of wider scopes', as they were made")
    versions: list[VersionAnswer]
    changes: list[PathChangeAnswer]
    causes: list[ModelLine]
    alarms: list[AlarmAnswer]
    investigations: list[InvestigationLine]
