"""Drift of C with time, the alarms that it raises, and what changed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from operator import attrgetter
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request, Response

from lbacal.instants import DAY_US, SECOND_US, format_instant, parse_instant
from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.errors import BadInputError
from service.factory import Factory
from service.handlers.jobs import RUN
from service.handlers.ledger import PROMOTE, Promoter, describe_changes
from service.handlers.request import (
    AntennaQuery,
    JobNumber,
    JsonBody,
    Limit,
    StationQuery,
    UseCases,
    Whole,
    answer,
    caller_with,
)
from service.handlers.routes import Order, acts, ordered, page_of, reads
from service.page.charts import Span
from service.storage.alarms import ACKNOWLEDGED, OPEN, STATES, Alarm, AlarmsAsked
from service.storage.changes import Change, Evidence, KeptChange, concerns
from service.usecases.calibrations import select_paths
from service.usecases.drift import DriftSeries, MonthPoint, Step
from service.usecases.gate import tell_size
from service.usecases.keys import Caller
from service.wire import answer_models as wire
from service.wire.answers import describe_scope, fill_answer
from service.wire.bodies import AcknowledgementBody, ChangeBody, DecisionBody, parse_body

router = APIRouter(tags=["drift"])
OF_C = {"unit": "fraction of C"}


@reads(router, "/v1/drift", wire.DriftAnswer, takes_turn=True)
def get_drift(
    request: Request, use: UseCases, station: str | None = None, antenna: AntennaQuery = None, dipole: str | None = None
) -> Response:
    """Show C over time, relative to the first year.

    For the array, a station, or one path: the band mean of C of every version, C of every month over that of the
    path's first whole year (for many paths the median and the middle 68 %) with what offset, season and slope make
    of it, the changes beside the station or the other stations, the most significant first, and the slope with its
    error.
    """
    select_paths(use.full_instrument, station, antenna, dipole)
    if (antenna is None) != (dipole is None):
        raise BadInputError("query", "antenna and dipole together, or neither", "one of them")
    return answer(request, describe_series(use.drift.series(Scope(station, antenna, dipole))))


def describe_series(series: DriftSeries) -> dict[str, Any]:
    """Drift of a path as JSON values of `DriftAnswer`."""
    return fill_answer(
        wire.DriftAnswer, series,
        versions=[fill_answer(wire.DriftVersion, one, dipole=one.dipole or None) for one in series.versions],
        months=[describe_month(point) for point in series.months],
        steps=[describe_step(step) for step in series.steps],
        slope=None if series.slope is None else describe_slope(series.slope),
    )  # fmt: skip


def describe_month(point: MonthPoint) -> dict[str, Any]:
    """Describe a month as JSON values of `DriftMonth`."""
    shape = dict(zip(("tilt", "curvature"), point.shape, strict=True))
    line = dict(zip(("line", "line_low", "line_high"), point.line or (None, None, None), strict=True))
    return fill_answer(wire.DriftMonth, point, month=format_instant(point.month)[:7], **shape, **line)


def describe_step(step: Step) -> dict[str, Any]:
    """A change and the version in effect then, as JSON values of `DriftStep`."""
    told = step.change
    first, last = (format_instant(round(told[f"{end}_unix"] * SECOND_US)) for end in ("earliest", "latest"))
    date = format_instant(step.date)[:10]
    return fill_answer(wire.DriftStep, step, told, **describe_scope(step.path), date=date, earliest=first, latest=last)


def describe_slope(slope: Mapping[str, Any]) -> dict[str, Any]:
    """A slope as JSON values of `DriftSlope`: that of a path beside its station, or that of C itself."""
    is_own = "significance" in slope
    return {
        **{name: slope.get(name) for name in wire.DriftSlope.model_fields},
        "season": slope["season"] if is_own else math.hypot(*slope["season"][:2]),
        "beside": "the median of its station and polarisation" if is_own else None,
    }


alarms = APIRouter(tags=["alarms"])
Operator = Annotated[Caller, caller_with(RUN)]
State = Literal["open", "acknowledged", "ended", "lasting", "all"]
CHOICES = {"lasting": (OPEN, ACKNOWLEDGED), "all": STATES}


@reads(alarms, "/v1/alarms", wire.AlarmsAnswer)
def list_alarms(
    request: Request,
    use: UseCases,
    station: StationQuery,
    state: State = "lasting",
    kind: wire.AlarmKind | None = None,
    cursor: Annotated[Whole | None, Query(ge=0, le=2**63 - 1)] = None,
    limit: Limit = 100,
) -> Response:
    """List alarms.

    Newest first. `state`: `open` are those that nobody acknowledged, or whose acknowledgement has run out;
    `lasting` (the default) are these and the acknowledged ones; `ended` are over. A problem is one alarm since
    the run that found it. `next` is the cursor of the next page.
    """
    states = CHOICES.get(state, (state,))
    found = use.alarms.newest(AlarmsAsked(states, limit, kind, station, cursor))
    describe = partial(describe_alarm, now=use.clock())
    return answer(request, page_of("alarms", found, limit, describe, attrgetter("number")))


@acts(alarms, "/v1/alarms/{number}/acknowledgement", AcknowledgementBody, wire.AlarmAnswer, 404)
def acknowledge_alarm(request: Request, use: UseCases, number: JobNumber, caller: Operator, body: JsonBody) -> Response:
    """Say that a problem is known.

    It is not told again, until `until` where that is given: then it is open again if it still lasts. The last
    acknowledgement counts.
    """
    known = use.alarms.acknowledge(number, parse_body(AcknowledgementBody, body), caller.name)
    return answer(request, describe_alarm(known, use.clock()), status=201)


def describe_alarm(alarm: Alarm, now: Instant) -> dict[str, Any]:
    """Describe an alarm as JSON values of `AlarmAnswer`; `now` decides on its state."""
    news, known = alarm.news, alarm.acknowledgement
    return fill_answer(
        wire.AlarmAnswer, alarm, news, alarm=alarm.number, state=alarm.state_at(now),
        since_sigma_days=None if news.since is None else news.since_error / DAY_US,
        acknowledgement=None if known is None else fill_answer(wire.AcknowledgementAnswer, known),
    )  # fmt: skip


# Changes: what changed in paths, who says so, and what people decide about it.

changes = APIRouter(tags=["changes"])


@reads(changes, "/v1/changes", wire.PathChangesAnswer)
def list_changes(
    request: Request,
    use: UseCases,
    station: StationQuery,
    antenna: AntennaQuery = None,
    dipole: str | None = None,
    since: str | None = None,
    until: str | None = None,
    decision: Literal["proposed", "in_force", "dismissed"] | None = None,
) -> Response:
    """List changes with their dates.

    In order of station and date: what drift found beyond the threshold of an alarm, what is on record or a person
    entered is in force at once, what an investigation alone found is proposed. Windows are cut where a step is in
    force, until it has ended or is dismissed.
    """
    select_paths(use.full_instrument, station, None if station is None else antenna, dipole)
    ends = (None if one is None else parse_instant(name, one) for name, one in (("since", since), ("until", until)))
    span = Span(*ends)
    found = [
        one for one in use.changes.list_doubted(station)
        if concerns(one, antenna, dipole) and span.has(one.change.date) and decision in (None, one.decision)
    ]  # fmt: skip
    return answer(request, {"changes": [describe_change(one, use) for one in found]})


@acts(changes, "/v1/changes", ChangeBody, wire.PathChangeAnswer, 409)
def enter_change(
    request: Request, use: UseCases, order: Annotated[Order[ChangeBody], ordered(ChangeBody, PROMOTE)]
) -> Response:
    """Enter what is known to have changed.

    It is in force at once, and the next look for due work fits the windows that it cuts. One that was found already
    gets the person as one more source.
    """
    done = order.once("change", lambda: describe_change(use.changes.enter(order.wanted, order.caller), use))
    return answer(request, done, status=201)


@acts(
    changes, "/v1/changes/{number}/decision", DecisionBody, wire.DecidedAnswer, 404, 409, otherwise=wire.DecidedAnswer
)
def decide_change(
    request: Request, use: UseCases, number: JobNumber, caller: Promoter, body: JsonBody, dry_run: bool = False
) -> Response:
    """Put a change in force, or dismiss it.

    Whatever its sources say; the next look for due work fits the windows again. `changes` are those of the curves that
    its paths would be served, by fits of the year; of a ramp or season the largest while each is in effect. A change
    that has ended, or of which this is decided already, is 409. `dry_run=true` answers 200 and writes nothing.
    """
    wanted = parse_body(DecisionBody, body)
    foreseen, of_c, left_out = use.changes.foresee(number, wanted, caller.name)
    decided = foreseen if dry_run else use.changes.decide(number, wanted, caller.name)
    content = {**describe_change(decided, use), "changes": describe_changes(of_c), "left_out": left_out}
    return answer(request, content, status=200 if dry_run else 201)


def _describe_evidence(one: Evidence) -> dict[str, Any]:
    return fill_answer(wire.EvidenceAnswer, one, significance_sigma=one.significance, **_describe_estimate(one))


def _describe_estimate(of: Change | Evidence) -> dict[str, Any]:
    """The date and the size."""
    size = None if of.size is None else {"value": of.size, "sigma": of.size_sigma or 0.0, **OF_C}
    at = None if of.date is None else {"value": format_instant(of.date), "sigma_days": (of.sigma or 0) / DAY_US}
    return {"at": at, "size": size}


def describe_change(kept: KeptChange, use: Factory) -> dict[str, Any]:
    """Describe a change as JSON values of `PathChangeAnswer`."""
    change, said, first = kept.change, kept.said, kept.evidence[0]
    paths = [{"station": change.station, "antenna": antenna, "dipole": dipole} for antenna, dipole in change.paths]
    own = [
        {"antenna": one.antenna, "dipole": one.dipole, "value": one.size, "sigma": one.size_sigma, **OF_C}
        for one in change.own
    ]
    return fill_answer(
        wire.PathChangeAnswer, kept, change, id=kept.number, paths=paths or None, array=change.station is None,
        **_describe_estimate(change), own_sizes=own, shape=change.shape(use.instrument.frequency_mhz),
        evidence=[_describe_evidence(one) for one in kept.evidence],
        by=first.source if said is None else said.by,
        reason=f"found by {first.source}" if said is None else said.reason,
        in_words=tell_size(change, use.instrument.frequency_mhz),
        cuts_windows=bool(kept.cuts),
    )  # fmt: skip
