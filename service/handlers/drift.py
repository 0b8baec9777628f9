"""Drift of C with time."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from fastapi import APIRouter, Depends, Request, Response

from lbacal_core.curves.validity import Scope
from lbacal_core.errors import BadInputError
from service.handlers.problems import document
from service.handlers.request import TAKES_TURN, AntennaQuery, UseCases, answer, require_read
from service.usecases.calibrations import select_paths
from service.usecases.drift import SECOND_US, DriftSeries, Step
from service.wire.answer_models import DriftAnswer
from service.wire.answers import describe_scope
from service.wire.instants import format_instant

router = APIRouter(tags=["drift"])


@router.get(
    "/v1/drift",
    response_model=DriftAnswer,
    summary="C over time, against the first year",
    description="For the array, a station, or one path: the band mean of C of every version, C of every month over "
    "that of the path's first whole year (for many paths the median and the middle 68 %) with what offset, season and "
    "slope make of it, the changes beside the station or the other stations, the most significant first, and the slope "
    "with its error.",
    responses=document(401, 422, 503),
    dependencies=[Depends(require_read), TAKES_TURN],
)
def get_drift(
    request: Request,
    use: UseCases,
    station: str | None = None,
    antenna: AntennaQuery = None,
    dipole: str | None = None,
) -> Response:
    select_paths(use.drift.instrument, station, antenna, dipole)
    if (antenna is None) != (dipole is None):
        raise BadInputError("query", "antenna and dipole together, or neither", "one of them")
    return answer(request, describe_series(use.drift.series(Scope(station, antenna, dipole))))


def describe_series(series: DriftSeries) -> dict[str, Any]:
    """Drift as JSON values."""
    return {
        "scope": series.scope.level,
        **describe_scope(series.scope),
        "versions": [
            {
                "calibration": version.calibration,
                "dipole": version.dipole or None,
                "since": format_instant(version.since),
                "until": format_instant(version.until),
                "events": version.events,
                "c": version.c,
                "c_sigma": version.c_sigma,
            }
            for version in series.versions
        ],
        "months": [
            {
                "month": format_instant(point.month)[:7],
                "c_ratio": point.c_ratio,
                "low": point.low,
                "high": point.high,
                "paths": point.paths,
                "events": point.events,
                "calibration": point.calibration,
                "tilt": point.shape and point.shape[0],
                "curvature": point.shape and point.shape[1],
                **dict(zip(("line", "line_low", "line_high"), point.line or (None, None, None), strict=True)),
            }
            for point in series.months
        ],
        "steps": [describe_step(step) for step in series.steps],
        "slope": None if series.slope is None else describe_slope(series.slope),
        "threshold_sigma": series.threshold_sigma,
    }


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
