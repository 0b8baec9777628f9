"""Drift of C with time, the alarms that it raises, and the dates at which it cuts windows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from operator import attrgetter
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request, Response

from lbacal.instants import DAY_US, format_instant
from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.errors import BadInputError
from service.handlers.request import AntennaQuery, JobNumber, JsonBody, Limit, UseCases, Whole, answer, caller_with
from service.handlers.routes import acts, page_of, reads
from service.storage.alarms import ACKNOWLEDGED, OPEN, STATES, Alarm, AlarmsAsked
from service.storage.drift import KeptCut
from service.usecases.calibrations import select_paths
from service.usecases.drift import SECOND_US, DriftSeries, MonthPoint, Step
from service.usecases.keys import Caller
from service.wire import answer_models as wire
from service.wire.answers import describe_scope, fill_answer
from service.wire.bodies import AcknowledgementBody, ReasonBody, parse_body

router = APIRouter(tags=["drift"])


@reads(router, "/v1/drift", wire.DriftAnswer, takes_turn=True)
def get_drift(
    request: Request,
    use: UseCases,
    station: str | None = None,
    antenna: AntennaQuery = None,
    dipole: str | None = None,
) -> Response:
    """C over time, against the first year.

    For the array, a station, or one path: the band mean of C of every version, C of every month over that of the
    path's first whole year (for many paths the median and the middle 68 %) with what offset, season and slope make
    of it, the changes beside the station or the other stations, the most significant first, and the slope with its
    error.
    """
    select_paths(use.drift.instrument, station, antenna, dipole)
    if (antenna is None) != (dipole is None):
        raise BadInputError("query", "antenna and dipole together, or neither", "one of them")
    return answer(request, describe_series(use.drift.series(Scope(station, antenna, dipole))))


def describe_series(series: DriftSeries) -> dict[str, Any]:
    """Drift as JSON values."""
    return fill_answer(
        wire.DriftAnswer, series,
        versions=[fill_answer(wire.DriftVersion, one, dipole=one.dipole or None) for one in series.versions],
        months=[describe_month(point) for point in series.months],
        steps=[describe_step(step) for step in series.steps],
        slope=None if series.slope is None else describe_slope(series.slope),
    )  # fmt: skip


def describe_month(point: MonthPoint) -> dict[str, Any]:
    """A month as JSON values."""
    shape = dict(zip(("tilt", "curvature"), point.shape, strict=True))
    line = dict(zip(("line", "line_low", "line_high"), point.line or (None, None, None), strict=True))
    return fill_answer(wire.DriftMonth, point, month=format_instant(point.month)[:7], **shape, **line)


def describe_step(step: Step) -> dict[str, Any]:
    """A change and the version in effect then, as JSON values."""
    told = step.change
    copied = ("date_sigma_days", "size", "sigma", "shape", "significance", "members")
    return {
        **describe_scope(step.path),
        "date": format_instant(step.date)[:10],
        "earliest": format_instant(round(told["earliest_unix"] * SECOND_US)),
        "latest": format_instant(round(told["latest_unix"] * SECOND_US)),
        **{name: told[name] for name in copied},
        "known": told["is_known"],
        "calibration": step.calibration,
    }


def describe_slope(slope: Mapping[str, Any]) -> dict[str, Any]:
    """A slope as JSON values: that of a path beside its station, or that of C itself."""
    optional = ("limit_95", "years", "scatter", "significance", "shape", "frequency")
    is_own = "significance" in slope
    season = slope["season"] if is_own else math.hypot(*slope["season"][:2])
    return {
        **{name: slope[name] for name in ("slope", "sigma")},
        **{name: slope.get(name) for name in optional},
        "season": season,
        "beside": "the median of its station and polarisation" if is_own else None,
    }


alarms = APIRouter(tags=["alarms"])
Operator = Annotated[Caller, caller_with("refits:run")]
State = Literal["open", "acknowledged", "ended", "lasting", "all"]
CHOICES = {"lasting": (OPEN, ACKNOWLEDGED), "all": STATES}


@reads(alarms, "/v1/alarms", wire.AlarmsAnswer)
def list_alarms(
    request: Request,
    use: UseCases,
    state: State = "lasting",
    kind: wire.AlarmKind | None = None,
    station: str | None = None,
    cursor: Annotated[Whole | None, Query(ge=0, le=2**63 - 1)] = None,
    limit: Limit = 100,
) -> Response:
    """What is wrong.

    Newest first. `state`: `open` are those that nobody acknowledged, or whose acknowledgement has run out;
    `lasting` (the default) are these and the acknowledged ones; `ended` are over. A problem is one alarm from the
    night on which it was found. `next` is the cursor of the next page.
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
    """An alarm as JSON values."""
    news, known = alarm.news, alarm.acknowledgement
    return fill_answer(
        wire.AlarmAnswer, alarm, news, alarm=alarm.number, state=alarm.state_at(now),
        since_sigma_days=None if news.since is None else news.since_error_us / DAY_US,
        acknowledgement=None if known is None else fill_answer(wire.AcknowledgementAnswer, known),
    )  # fmt: skip


# Cuts: dates at which the watch cuts the windows of antennas, and what people decide about them.

cuts = APIRouter(tags=["cuts"])
Promoter = Annotated[Caller, caller_with("calibrations:promote")]


@reads(cuts, "/v1/cuts", wire.CutsAnswer)
def list_cuts(request: Request, use: UseCases, station: str | None = None) -> Response:
    """Where windows are cut.

    Dates at which the watch found that an antenna changed, in order of antenna and date: the windows of its refits
    are cut there while the cut stands.
    """
    return answer(request, {"cuts": [describe_cut(one) for one in use.cuts.list_all(station)]})


@acts(cuts, "/v1/cuts/{number}/lift", ReasonBody, wire.CutAnswer, 404, 409)
def lift_cut(request: Request, use: UseCases, number: JobNumber, caller: Promoter, body: JsonBody) -> Response:
    """Leave windows whole at a date.

    Although the watch finds a change there; the next look for due work fits the windows again. A cut that is lifted
    already, or that has ended, is 409.
    """
    lifted = use.cuts.lift(number, parse_body(ReasonBody, body), caller.name)
    return answer(request, describe_cut(lifted), status=201)


@acts(cuts, "/v1/cuts/{number}/restoration", ReasonBody, wire.CutAnswer, 404, 409)
def restore_cut(request: Request, use: UseCases, number: JobNumber, caller: Promoter, body: JsonBody) -> Response:
    """Cut windows again where the cut was lifted.

    The next look for due work fits the windows again. A cut that stands, or that has ended, is 409.
    """
    restored = use.cuts.restore(number, parse_body(ReasonBody, body), caller.name)
    return answer(request, describe_cut(restored), status=201)


def describe_cut(kept: KeptCut) -> dict[str, Any]:
    """A cut as JSON values."""
    decision = None if kept.decision is None else fill_answer(wire.CutDecision, kept.decision)
    of_cut = {"cut": kept.number, "date_sigma_days": kept.cut.sigma_days, "refitted": kept.is_refitted}
    return fill_answer(wire.CutAnswer, kept, kept.cut, decision=decision, **of_cut)
