"""The page, for humans: the same use cases as the API, filled into templates."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import groupby
from typing import Any

import numpy as np
from fastapi import APIRouter, Depends, Request, Response, status
from fastapi.responses import HTMLResponse, RedirectResponse

from lbacal.instants import format_instant, parse_instant
from lbacal_core.causes.model import follows_date
from lbacal_core.curves.curves import list_numbers
from lbacal_core.curves.validity import Scope
from service.handlers.request import (
    FORM_COOKIE,
    IMMUTABLE,
    KEY_COOKIE,
    TAKES_TURN,
    InPath,
    UseCases,
    answer,
    require_read,
)
from service.page.render import find_asset, format_day, name_scope, render_page, render_part
from service.storage.alarms import ACKNOWLEDGED, ENDED, OPEN, AlarmsAsked
from service.storage.versions import MeanC, Version
from service.usecases.calibrations import select_paths
from service.usecases.drift import DriftSeries, Story
from service.usecases.models import list_stopped
from service.usecases.status import look_over
from service.wire.answers import FORMATS

router = APIRouter(
    include_in_schema=False, dependencies=[Depends(require_read), TAKES_TURN], default_response_class=HTMLResponse
)
assets = APIRouter(include_in_schema=False, default_response_class=Response)
HTML = "text/html; charset=utf-8"
STEPS_SHOWN = 25
ALARMS_SHOWN, ENDED_SHOWN = 500, 50


def _page(request: Request, use: UseCases, name: str, here: str, **content: Any) -> Response:
    word = request.cookies.get(FORM_COOKIE) if KEY_COOKIE in request.cookies else None
    told = {"instrument": use.instrument.name, "frequency_mhz": use.instrument.frequency_mhz}
    body = render_page(name, here=here, leave=word, **told, **content)
    return answer(request, body, media_type=HTML)


@assets.get("/static/{digest}/{name}")
def get_asset(request: Request, digest: str, name: str) -> Response:
    asset = find_asset(digest, name)
    return answer(request, asset.content, media_type=asset.media_type, cache=IMMUTABLE)


@router.get("/")
def show_overview(request: Request, use: UseCases) -> Response:
    overview = look_over(use.database, use.instrument, use.clock)
    steps = use.drift.steps(5)
    news, state = use.investigations.news(), use.status.look()
    told = {"news": news, "stopped": list_stopped(use.models.history()), "alarms": state.alarms}
    return _page(request, use, "overview.html", "/", overview=overview, steps=steps, **told)


@router.get("/jobs")
def show_jobs(request: Request, use: UseCases) -> Response:
    jobs = use.jobs.newest(limit=200)
    is_open = any(job.state in ("queued", "running") for job in jobs)
    state, nightly = use.status.look(), use.settings.nightly_utc
    return _page(request, use, "jobs.html", "/jobs", jobs=jobs, is_open=is_open, nightly=nightly, state=state)


@router.get("/drift")
def show_drift(request: Request, use: UseCases) -> Response:
    main = use.drift.shown.get(use.drift.state(), lambda: _tell_drift(use))
    changes = [one for one in use.changes.list_all() if one.ended is None]
    return _page(request, use, "drift.html", "/drift", main=main, changes=changes)


def _tell_drift(use: UseCases) -> str:
    """The part of the page that is the same for everybody until the next night."""
    whole, stations = use.drift.overall()
    series = [*stations, *([whole] if len(stations) > 1 else [])]
    stories = use.drift.stories(series)
    rows = [_version_rows(one, stories) for one in series]
    plot = {"series": [_plot_of_series(one, of_one) for one, of_one in zip(series, rows, strict=True)]}
    return render_part(
        "drift_main.html", plot=plot, steps=whole.steps[:STEPS_SHOWN], rows=[row for of_one in rows for row in of_one],
        trends=[(name_scope(one.scope), one.slope) for one in series if one.slope is not None],
        threshold=whole.threshold_sigma, frequency_mhz=use.instrument.frequency_mhz,
    )  # fmt: skip


@router.get("/alarms")
def show_alarms(request: Request, use: UseCases) -> Response:
    lasting = use.alarms.newest(AlarmsAsked((OPEN, ACKNOWLEDGED), ALARMS_SHOWN))
    ended = use.alarms.newest(AlarmsAsked((ENDED,), ENDED_SHOWN))
    content = {"lasting": lasting, "ended": ended, "now": use.clock(), "counts": use.status.look().alarms}
    return _page(request, use, "alarms.html", "/alarms", **content)


@router.get("/stations/{station}")
def show_station(request: Request, use: UseCases, station: InPath) -> Response:
    select_paths(use.instrument, station, None, None)
    series = use.drift.series(Scope(station))
    told = {"means": use.drift.means_of_paths(station), "slopes": use.drift.slopes_of_paths(station)}
    steps, years = series.steps[:STEPS_SHOWN], use.drift.matrix(station)
    return _page(request, use, "station.html", "/", station=station, years=years, steps=steps, **told)


@router.get("/stations/{station}/{antenna}/{dipole}/{month}")
def show_version_of_month(use: UseCases, station: InPath, antenna: int, dipole: InPath, month: InPath) -> Response:
    (path,) = select_paths(use.instrument, station, antenna, dipole)
    version = use.drift.version_at(path, parse_instant("month", f"{month}-15"))
    return RedirectResponse(f"/calibrations/{version}", status.HTTP_303_SEE_OTHER)


@router.get("/calibrations/{version_id}")
def show_calibration(request: Request, use: UseCases, version_id: InPath) -> Response:
    version, promotions, confirmed = use.calibrations.get_with_promotions(version_id)
    curves = [
        {"name": c.name, **{k: list_numbers(getattr(c, k)) for k in ("frequency_mhz", "c", "c_sigma_stat")}}
        for c in version.curves
        if c.c is not None
    ]
    return _page(
        request, use, "calibration.html", "/", version=version, promotions=promotions, plot={"curves": curves},
        chains=_rows_of_chains(version), confirmed=confirmed,
        downloads=[name for name in FORMATS if name != "nuradio" or version.scope.antenna is not None],
    )  # fmt: skip


@router.get("/models")
def show_models(request: Request, use: UseCases) -> Response:
    return _page(request, use, "models.html", "/models", models=use.models.history())


@router.get("/investigations/{name}")
def show_investigation(request: Request, use: UseCases, name: InPath) -> Response:
    found = use.investigations.get(name)
    # reports of before there were models have neither
    adopted = found.report.get("adopted", [])
    findings = enumerate(found.report["findings"])
    dated = [number for number, one in findings if follows_date(one["cause"], one["parameters"])]
    return _page(
        request, use, "investigation.html", "/", found=found, report=found.report, adopted=adopted, dated=dated
    )


def _rows_of_chains(version: Version) -> list[dict[str, Any]]:
    """Departures of single paths from their mean, by cable, at the median channel."""
    rows = []
    for dipole, chain in version.chains.items() if version.scope.antenna is None else ():
        spreads = {} if chain.spreads is None else {**chain.spreads.by_cable, "all": chain.spreads.all_paths}
        of_chain = {"dipole": dipole, "members": len(chain.members)}
        rows += [
            {
                **of_chain,
                "cable": cable,
                "paths": one.paths,
                "offset": float(np.median(one.offset)),
                "spread": float(np.median(one.spread)),
            }
            for cable, one in spreads.items()
        ] or [{**of_chain, "cable": "", "paths": 0, "offset": None, "spread": None}]
    return rows


def _version_rows(series: DriftSeries, stories: Mapping[tuple[str, str], Story]) -> list[dict[str, Any]]:
    """Versions of a scope in order of dipole and time, each against the first of its dipole."""
    rows = []
    ordered = sorted(series.versions, key=lambda version: (version.dipole, version.since, version.calibration))
    for dipole, of_dipole in groupby(ordered, key=lambda version: version.dipole):
        versions = list(of_dipole)
        rows += [
            {
                "name": name_scope(series.scope),
                "dipole": dipole,
                "calibration": version.calibration,
                "window": f"{format_day(version.since)} to {format_day(version.until)}",
                "middle": format_instant((version.since + version.until) // 2)[:10],
                "c": version.c,
                "c_sigma": version.c_sigma,
                "change": stories[version.calibration, dipole].change,
                "change_sigma": _sigma_of_change(version, versions[0], stories[version.calibration, dipole].change),
                "why": stories[version.calibration, dipole].words,
                "url": f"/calibrations/{version.calibration}",
            }
            for version in versions
        ]
    return rows


def _sigma_of_change(version: MeanC, first: MeanC, change: float) -> float:
    """Error of the change from the first; 0 of the first itself."""
    if version.calibration == first.calibration:
        return 0.0
    return (1.0 + change) * math.hypot(version.c_sigma / version.c, first.c_sigma / first.c)


def _plot_of_series(series: DriftSeries, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Months as rows of numbers: with ten years the names of their fields were most of the page."""
    number = {row["calibration"]: k for k, row in enumerate(rows)}
    return {
        "name": name_scope(series.scope),
        "url": f"/stations/{series.scope.station}" if series.scope.station else "/",
        "months": [
            [
                format_instant(p.month)[:7], p.c_ratio, p.low, p.high, p.paths, p.events, p.line,
                None if p.calibration is None else number[p.calibration],
            ]
            for p in series.months
        ],
        "versions": [
            {
                "middle": row["middle"], "window": row["window"], "dipole": row["dipole"], "url": row["url"],
                "ratio": 1.0 + row["change"], "sigma": row["c_sigma"] / row["c"],
            }
            for row in rows
        ],
    }  # fmt: skip
