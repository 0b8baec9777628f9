"""Drift of C with time."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Depends, Request, Response

from lbacal_core.errors import BadInputError
from lbacal_core.validity import Scope
from service.handlers.problems import document
from service.handlers.request import AntennaQuery, UseCases, answer, require_read
from service.usecases.calibrations import select_paths
from service.usecases.drift import DriftSeries
from service.wire.answers import describe_scope
from service.wire.calibration_models import DriftAnswer
from service.wire.instants import format_instant

router = APIRouter(tags=["drift"])


@router.get(
    "/v1/drift",
    response_model=DriftAnswer,
    summary="C over time, against the first year",
    description="For the array, a station, or one path: the band mean of C of every version, C of every month over "
    "that of the path's first whole year (for many paths the median and the middle 68 %), and the best step of "
    "each path against its station's median, the most significant first.",
    responses=document(401, 422, 503),
    dependencies=[Depends(require_read)],
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
            }
            for point in series.months
        ],
        "steps": [
            {
                **describe_scope(step.path),
                "date": format_instant(step.date)[:10],
                "size": step.size,
                "sigma": step.sigma,
                "significance": step.significance,
                "calibration": step.calibration,
            }
            for step in series.steps
        ],
    }
