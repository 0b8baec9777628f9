"""The page, for humans: the same use cases as the API, filled into templates. Every page obeys `?since=&until=`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Depends, Query, Request, Response, status
from fastapi.responses import HTMLResponse, RedirectResponse

from lbacal.instants import SECOND_US, format_instant, parse_instant
from lbacal.pages.chart import Chart
from lbacal.pages.curves import (
    C_LABEL,
    draw_curves,
    draw_difference,
    draw_noise,
    draw_residuals,
    draw_terms,
    limit_residuals,
    published_curve,
    values_of,
)
from lbacal_core.causes.model import follows_date
from lbacal_core.curves.covariance import parse_budget
from lbacal_core.curves.curves import CalibrationCurve
from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.data.lofar import SUPERTERP
from lbacal_core.errors import BadInputError, name_path
from service.errors import NotInEffectError
from service.factory import Factory
from service.handlers.request import (
    FORM_COOKIE,
    IMMUTABLE,
    MAY_READ,
    REVALIDATE,
    SESSION_COOKIE,
    TAKES_TURN,
    AntennaQuery,
    InPath,
    JobNumber,
    UseCases,
    answer,
)
from service.page import charts
from service.page.charts import Span
from service.page.render import Figure, find_asset, name_scope, render_page, render_part
from service.storage.alarms import ACKNOWLEDGED, ENDED, OPEN, AlarmsAsked
from service.storage.changes import PROPOSED, KeptChange
from service.storage.models import Investigation
from service.storage.versions import Version
from service.usecases.calibrations import CurveInEffect, select_paths
from service.usecases.drift import DriftSeries
from service.usecases.life import Life
from service.usecases.status import State, look_over, tell_problems
from service.wire.answers import FORMATS

LOG = "log"


def require_scale(scale: str = "") -> None:
    """Refuse what is no scale of C along its axis; `_page` draws on it."""
    if scale not in ("", LOG):
        raise BadInputError("scale", f"{LOG} or nothing", scale[:60])


router = APIRouter(
    include_in_schema=False, dependencies=[MAY_READ, TAKES_TURN, Depends(require_scale)],
    default_response_class=HTMLResponse,
)  # fmt: skip
assets = APIRouter(include_in_schema=False, default_response_class=Response)
HTML, CSV = "text/html; charset=utf-8", "text/csv; charset=utf-8"
STEPS_SHOWN, CHANGES_SHOWN, CURVES_SHOWN = 25, 8, 6
ALARMS_SHOWN, ENDED_SHOWN = 500, 50


def read_span(since: str = "", until: str = "") -> Span:
    """The time range of an address; an end that is absent or empty is open."""
    ends = [parse_instant(name, text) if text else None for name, text in (("since", since), ("until", until))]
    return Span(*ends)


InSpan = Annotated[Span, Depends(read_span)]
CsvQuery = Annotated[str, Query(max_length=60, description="name of a figure, whose numbers are answered as CSV")]


def _page(
    request: Request, use: Factory, span: Span, name: str, here: str, figures: Mapping[str, Chart | None] | None = None,
    csv: str = "", **content: Any,
) -> Response:  # fmt: skip
    drawn = {key: chart for key, chart in (figures or {}).items() if chart is not None}
    if csv:
        if csv not in drawn:
            raise BadInputError("csv", f"one of {', '.join(drawn) or 'no figures'}", csv)
        return answer(request, drawn[csv].csv().encode(), media_type=CSV)
    word = request.cookies.get(FORM_COOKIE) if SESSION_COOKIE in request.cookies else None
    kept = {name: value for name, value in request.query_params.items() if name not in ("since", "until", "csv")}
    told = {"instrument": use.instrument.name, "frequency_mhz": use.instrument.frequency_mhz, "kept": kept}
    told["address_here"] = f"{request.url.path}{span.with_more(**kept)}"
    shown = {key: _show(key, chart, span, kept) for key, chart in drawn.items()}
    body = render_page(name, here=here, leave=word, span=span, q=span.query, figures=shown, **told, **content)
    return answer(
        request,
        body,
        media_type=HTML,
        cache=f"private, {REVALIDATE}" if word and use.settings.open_reads else REVALIDATE,
    )


def _show(key: str, chart: Chart, span: Span, kept: Mapping[str, str]) -> Figure:
    """A chart with the address of its numbers; C itself on the scale that is asked for, with that of the other one."""
    numbers = span.with_more(**kept, csv=key)
    if not chart.y_label.startswith(C_LABEL.partition("{")[0]):
        return Figure(chart, numbers)
    if kept.get("scale") != LOG:
        return Figure(chart, numbers, span.with_more(**{**kept, "scale": LOG}), LOG)
    other = span.with_more(**{name: value for name, value in kept.items() if name != "scale"}) or "?"
    return Figure(replace(chart, scales=("linear", "log"), y_limits=None), numbers, other, "linear")


@assets.get("/static/{digest}/{name}")
def get_asset(request: Request, digest: str, name: str) -> Response:
    asset = find_asset(digest, name)
    return answer(request, asset.content, media_type=asset.media_type, cache=IMMUTABLE)


# The first screen: five questions.


@router.get("/")
def show_overview(request: Request, use: UseCases, span: InSpan, csv: CsvQuery = "") -> Response:
    overview, state = look_over(use.database, use.instrument, use.clock), use.status.look()
    news, stopped = use.investigations.news(), [one.sentence for one in use.models.stopped()]
    lasting = [one for one in use.changes.list_all() if one.ended is None]
    changes = sorted((one for one in lasting if span.has(one.change.date)), key=_significance, reverse=True)
    at = span.until - 1 if span.until is not None else overview.last
    in_effect = [] if at is None else _find_stations(use, at)
    figures = {
        "coverage": charts.draw_coverage(overview.stations, span),
        "changes": charts.draw_changes(changes, span, (overview.first, overview.last)) if changes else None,
        **{f"c-{name}": draw_curves(f"C of {name}", curves) for name, curves in list(in_effect)[:CURVES_SHOWN]},
        "terms": _draw_terms(use, [curve for _, curves in in_effect for curve in curves]),
        "waiting": charts.draw_counts(_count_waiting(state, lasting, [one.newest for one in news], span)),
    }
    return _page(
        request, use, span, "overview.html", "/", figures, csv, overview=overview, state=state, news=news, at=at,
        problems=tell_problems(state, overview, stopped), changes=changes[:CHANGES_SHOWN], more=len(changes),
        in_effect=[name for name, _ in in_effect], dipoles=use.instrument.dipoles,
        proposed=[one for one in lasting if one.decision == PROPOSED],
    )  # fmt: skip


def _significance(one: KeptChange) -> float:
    """Size over error, in the mean or along frequency; without a size, how significant its sources found it."""
    size, sigma = one.change.size, one.change.size_sigma
    if size is not None and sigma:
        return max(map(abs, (size, one.change.tilt or 0.0, one.change.curvature or 0.0))) / sigma
    return max((by.significance or 0.0 for by in one.evidence), default=0.0)


def _find_stations(use: Factory, at: Instant) -> list[tuple[str, list[CalibrationCurve]]]:
    """The curves of every station of which a version of its own is in effect."""
    stations = sorted({record.station for record in use.instrument.antennas})
    try:
        found = use.calibrations.in_effect(at, [Scope(station) for station in stations])
    except NotInEffectError:
        return []
    own = (curve for curve in found.curves if curve.promotion.scope.station is not None)
    curves = [(curve.path.station or "", curve.served.curve) for curve in own]
    return [(name, [curve for _, curve in of]) for name, of in groupby(curves, key=lambda pair: pair[0])]


def _draw_terms(use: Factory, curves: Sequence[CalibrationCurve]) -> Chart | None:
    """The terms of the error of the first curve that has a budget."""
    for curve in curves:
        digest = None if curve.covariance is None else curve.covariance.budget
        if digest is not None and curve.c is not None:
            c, stat, _ = values_of(curve)
            with use.database.read() as stores:
                return draw_terms(parse_budget(stores.budgets.get(digest)), stat / c)
    return None


def _count_waiting(
    state: State, changes: Sequence[KeptChange], newest: Sequence[Investigation], span: Span
) -> dict[str, tuple[int, str]]:
    findings = [finding for one in newest for finding in one.report["findings"]]
    causes = [one for one in findings if not follows_date(one["cause"], one["parameters"])]
    found = next((one.id for one in newest if one.report["findings"]), None)
    return {
        "proposed changes": (sum(one.decision == PROPOSED for one in changes), f"/drift{span.query}#changes"),
        "changes not yet refitted": (sum(not one.is_refitted for one in changes), f"/drift{span.query}#changes"),
        "causes found": (len(causes), f"/investigations/{found}{span.query}" if found else f"/models{span.query}"),
        "held versions": (state.gated, f"/jobs{span.query}"),
        "failed jobs": (len(state.failures), f"/jobs{span.query}"),
        "open alarms": (sum(state.alarms.open.values()), f"/alarms{span.query}"),
    }


@router.get("/jobs")
def show_jobs(request: Request, use: UseCases, span: InSpan) -> Response:
    jobs = [job for job in use.database.look(lambda stores: stores.jobs.newest(limit=200)) if span.has(job.created)]
    is_open = any(job.state in ("queued", "running") for job in jobs)
    state, nightly = use.status.look(), use.settings.nightly_utc
    return _page(
        request, use, span, "jobs.html", "/jobs", jobs=jobs, is_open=is_open, nightly=nightly, state=state,
        now=use.clock(), stations=sorted({one.station for one in use.instrument.antennas}),
        dipoles=use.instrument.dipoles,
    )  # fmt: skip


@router.get("/jobs/{number}")
def show_job(request: Request, use: UseCases, number: JobNumber, span: InSpan) -> Response:
    job, records = use.database.look(lambda stores: (stores.jobs.get(number), stores.jobs.records(number)))
    is_open = job.state in ("queued", "running")
    return _page(request, use, span, "job.html", "/jobs", job=job, records=records, is_open=is_open, now=use.clock())


@router.get("/drift")
def show_drift(request: Request, use: UseCases, span: InSpan, csv: CsvQuery = "") -> Response:
    chart, main = use.drift.shown.get(f"{use.drift.state()} {span.query}", lambda: _tell_drift(use, span))
    changes = [one for one in use.changes.list_all() if one.ended is None and span.has(one.change.date)]
    life = use.lives.of(None)
    figures = {"drift": chart, **_draw_life(use, life, use.drift.series(Scope()), span)}
    return _page(request, use, span, "drift.html", "/drift", figures, csv, main=main, changes=changes, life=life)


def _tell_drift(use: Factory, span: Span) -> tuple[Chart, str]:
    """The part of the page that is the same for everybody until the next daily run."""
    whole, stations = use.drift.overall()
    series = [*stations, *([whole] if len(stations) > 1 else [])]
    points = [use.drift.points(one) for one in series]
    chart = charts.draw_drift(series, points, span)
    return chart, render_part(
        "drift_main.html", steps=[one for one in whole.steps if span.has(one.date)][:STEPS_SHOWN], q=span.query,
        figure=Figure(chart, span.with_more(csv="drift")),
        points=[one for of_scope in points for one in of_scope if span.has(one.mean.since)],
        trends=[(name_scope(one.scope), one.slope) for one in series if one.slope is not None],
        threshold=whole.threshold_sigma, frequency_mhz=use.instrument.frequency_mhz,
    )  # fmt: skip


@router.get("/alarms")
def show_alarms(request: Request, use: UseCases, span: InSpan) -> Response:
    lasting = use.alarms.newest(AlarmsAsked((OPEN, ACKNOWLEDGED), ALARMS_SHOWN))
    ended = [one for one in use.alarms.newest(AlarmsAsked((ENDED,), ENDED_SHOWN)) if span.has(one.raised)]
    lasting = [one for one in lasting if span.until is None or one.raised < span.until]
    now, counts = use.clock(), use.status.look().alarms
    return _page(request, use, span, "alarms.html", "/alarms", lasting=lasting, ended=ended, now=now, counts=counts)


@router.get("/models")
def show_models(request: Request, use: UseCases, span: InSpan) -> Response:
    models = [one for one in use.models.history() if span.has(one.change.at)]
    return _page(request, use, span, "models.html", "/models", models=models)


# The life of a station and of a path.


@router.get("/stations/{station}")
def show_station(request: Request, use: UseCases, station: InPath, span: InSpan, csv: CsvQuery = "") -> Response:
    select_paths(use.full_instrument, station, None, None)
    series, life = use.drift.series(Scope(station)), use.lives.of(station)
    years = [str(year.matrix) for year in use.database.look(lambda stores: stores.drift.years([station]))]
    at = _last_shown(use, span)
    in_effect = dict([] if at is None else _find_stations(use, at)).get(station, [])
    figures = {
        "curve": draw_curves(f"C of {station}, the mean of its paths", in_effect, _published(use))
        if in_effect
        else None,
        "terms": _draw_terms(use, in_effect),
        "time": charts.draw_path(life, series, use.drift.points(series), span, None, ""),
        **_draw_life(use, life, series, span),
        "matrix": charts.draw_matrix(station, years, span),
    }
    return _page(
        request, use, span, "station.html", "/", figures, csv, station=station, life=life, at=at,
        means=use.drift.means_of_paths(station), slopes=use.drift.slopes_of_paths(station),
        steps=[one for one in series.steps if span.has(one.date)][:STEPS_SHOWN],
    )  # fmt: skip


def _draw_life(use: Factory, life: Life, series: DriftSeries, span: Span) -> dict[str, Chart]:
    """What happened, and what was recorded beside it, on one axis of time."""
    days = charts.find_days(life, series, span)
    since, until = (round(SECOND_US * at) for at in days)
    environment = use.database.look(lambda stores: stores.spectra.covariates_by_month(since, until))
    return {"life": charts.draw_life(life, days, span, use.clock()), **charts.draw_environment(environment, days)}


def _last_shown(use: Factory, span: Span) -> Instant | None:
    """The last instant of the span; where that is open, the last event."""
    return span.until - 1 if span.until is not None else look_over(use.database, use.instrument, use.clock).last


def _published(use: Factory) -> dict[str, Any]:
    return published_curve() if use.instrument.name == SUPERTERP else {}


@router.get("/paths")
def find_path(
    use: UseCases, span: InSpan, station: str, antenna: AntennaQuery, dipole: str, at: str = ""
) -> RedirectResponse:
    (path,) = select_paths(use.full_instrument, station, antenna, dipole)
    address = f"/paths/{path.station}/{path.antenna}/{path.dipole}{span.with_more(at=at)}"
    return RedirectResponse(address, status.HTTP_303_SEE_OTHER)


@router.get("/paths/{station}/{antenna}/{dipole}")
def show_path(
    request: Request, use: UseCases, station: InPath, antenna: int, dipole: InPath, span: InSpan, at: str = "",
    csv: CsvQuery = "",
) -> Response:  # fmt: skip
    (path,) = select_paths(use.full_instrument, station, antenna, dipole)
    series, life = use.drift.series(path), use.lives.of(station, antenna, dipole)
    instant = parse_instant("at", at) if at else _last_shown(use, span)
    try:
        found = None if instant is None else use.calibrations.in_effect(instant, [path]).curves[0]
        gap = "no spectra are stored"
    except NotInEffectError as error:
        found, gap = None, str(error)
    address = f"/paths/{station}/{antenna}/{dipole}"
    figures = {
        "time": charts.draw_path(life, series, use.drift.points(series), span, instant, address),
        **_draw_life(use, life, series, span),
        **(_draw_date(use, path, found) if found is not None else {}),
    }
    return _page(
        request, use, span, "path.html", "/", figures, csv, path=path, life=life, at=instant, found=found, gap=gap
    )


def _draw_date(use: Factory, path: Scope, found: CurveInEffect) -> dict[str, Chart | None]:
    """What is known of a path on a date: C beside its predecessor, the noise in kelvin, the fit over sidereal time."""
    curve, name, before = found.served.curve, name_path(*path.parts), _find_predecessor(use, found)
    others = _published(use) | ({} if before is None else {"before it": (before.frequency_mhz, before.c)})
    drawn: dict[str, Chart | None] = {
        "curve": draw_curves(f"C of {name} on {format_instant(found.at)[:10]}", [curve], others),
        "difference": None if before is None else draw_difference(before, curve, ("before it", "this version")),
        "terms": _draw_terms(use, [curve]),
    }
    if not curve.parameters:
        return drawn  # a curve without noise constants says nothing of the power
    _, prediction = use.predictions.of(str(path.station), path.antenna or 0, str(path.dipole), found.at, None)
    if prediction.per_kelvin is not None:
        kelvin = {term: power / prediction.per_kelvin for term, power in prediction.contributions.items()}
        drawn["noise"] = draw_noise(prediction.frequency_mhz, kelvin, f"noise of {name} at the start of the chain")
    beside = use.predictions.beside_data(found)
    if beside is not None:
        over_lst, departures = beside
        title = f"measured / predicted power of {name} - 1"
        drawn["residuals"] = draw_residuals(title, curve.frequency_mhz, departures, limit_residuals([departures]))
        drawn["lst"] = charts.draw_over_lst(over_lst, name)
    return drawn


def _find_predecessor(use: Factory, found: CurveInEffect) -> CalibrationCurve | None:
    """Find the curve that the path was served before the version that answers."""
    try:
        before = use.calibrations.in_effect(found.promotion.valid_from - 1, [found.path]).curves[0]
    except NotInEffectError:
        return None
    return before.served.curve if before.served.curve.c is not None else None


# A version, two versions, a finding.


@router.get("/calibrations/{version_id}")
def show_calibration(
    request: Request, use: UseCases, version_id: InPath, span: InSpan, against: str = "", csv: CsvQuery = ""
) -> Response:
    with use.database.read() as stores:
        version = stores.versions.get(version_id)
        promotions = stores.ledger.of_calibration(version.id, PROMOTIONS_SHOWN)
        confirmed = stores.versions.confirmation(version.id)
        other = stores.versions.get(against) if against else None
        others = [one for one in stores.versions.search(version.scope, None, "", 100) if one.id != version.id]
    fitted = [curve for curve in version.curves if curve.c is not None]
    figures: dict[str, Chart | None] = {
        "curve": draw_curves(f"C of {name_scope(version.scope)}", fitted, _published(use)) if fitted else None,
        "terms": _draw_terms(use, fitted),
    }
    for curve in fitted if other is not None else ():
        first = next((one for one in other.curves if one.dipole == curve.dipole and one.c is not None), None)  # type: ignore[union-attr]
        if first is not None:
            names = (f"version {against[:8]}", f"this version, {curve.dipole}")
            figures[f"difference-{curve.dipole}"] = draw_difference(first, curve, names)
    return _page(
        request, use, span, "calibration.html", "/", figures, csv, version=version, promotions=promotions,
        chains=_rows_of_chains(version), confirmed=confirmed, other=other, others=others[-MOST_OTHERS:],
        downloads=[name for name in FORMATS if name != "nuradio" or version.scope.antenna is not None],
    )  # fmt: skip


MOST_OTHERS, PROMOTIONS_SHOWN = 30, 100


@router.get("/investigations/{name}")
def show_investigation(request: Request, use: UseCases, name: InPath, span: InSpan) -> Response:
    found = use.database.look(lambda stores: stores.investigations.get(name))
    changes = {
        by.ref.rpartition("#")[2]: one
        for one in use.changes.list_all(found.station)
        for by in one.evidence
        if by.ref.startswith(f"{found.id}#")
    }
    findings = [
        (one, follows_date(one["cause"], one["parameters"]), changes.get(str(number)))
        for number, one in enumerate(found.report["findings"])
    ]
    stations = [one for one in found.report.get("stations", ()) if one["station"] == found.station]
    # reports of before there were models have no adopted causes
    adopted = found.report.get("adopted", [])
    return _page(
        request, use, span, "investigation.html", "/", found=found, report=found.report, adopted=adopted,
        findings=findings, station=stations[0] if stations else {},
    )  # fmt: skip


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
