"""The application: routes, errors, and the edge that every request passes."""

from __future__ import annotations

import asyncio
from functools import cache
from importlib.metadata import version

from fastapi import APIRouter, Depends, FastAPI
from fastapi_offline import FastAPIOffline
from prometheus_client import CollectorRegistry
from starlette.middleware.gzip import GZipMiddleware
from starlette.routing import BaseRoute

from service.factory import Factory
from service.handlers import (
    acts,
    calibrations,
    drift,
    health,
    jobs,
    ledger,
    life,
    models,
    pages,
    problems,
    session,
    spectra,
)
from service.handlers.edge import BAD_KEYS_AT_ONCE, BAD_KEYS_PER_S, AnswersHead, Buckets, Edge, Traffic
from service.handlers.request import LARGE_READS, require_acceptable, require_known_query

GZIP_FROM = 100_000
"""Bytes from which an answer is compressed for those who accept that: the curves of a station, not of a path."""


def make_app(factory: Factory) -> FastAPI:
    """Make the application on one factory."""
    app: FastAPI = FastAPIOffline(
        title="lbacal",
        version=version("lbacal"),
        summary="Absolute calibration of radio antennas with the Galaxy: store spectra, ask what is in effect.",
        redoc_url=None,
    )
    app.router.routes.extend(_list_routes())
    app.state.factory = factory
    app.state.wrong_keys = Buckets(BAD_KEYS_PER_S, BAD_KEYS_AT_ONCE)
    app.state.registry = CollectorRegistry()
    app.state.large_bodies = asyncio.Semaphore(1)
    app.state.large_reads = asyncio.Semaphore(LARGE_READS)
    problems.install(app)
    session.install(app)

    app.add_middleware(GZipMiddleware, minimum_size=GZIP_FROM, compresslevel=1)
    app.add_middleware(AnswersHead)
    app.add_middleware(Edge, traffic=Traffic(app.state.registry), max_rate=factory.settings.max_rate)
    return app


@cache
def _list_routes() -> list[BaseRoute]:
    """The routes of all handlers, of which FastAPI makes what it needs once, at the first request of a process."""
    every = APIRouter(dependencies=[Depends(require_acceptable), Depends(require_known_query)])
    for router in (
        spectra.router,
        calibrations.router,
        jobs.router,
        ledger.router,
        models.investigations,
        models.router,
        calibrations.predictions,
        drift.router,
        drift.changes,
        life.router,
        drift.alarms,
        health.router,
        pages.router,
        pages.assets,
        session.router,
        acts.router,
    ):
        every.include_router(router)
    return every.routes
