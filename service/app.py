"""The application: routes, errors, and the headers that keep a browser from talking to anybody else."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from importlib.metadata import version

from fastapi import Depends, FastAPI, Request, Response
from fastapi_offline import FastAPIOffline

from service.factory import Factory
from service.handlers import calibrations, drift, health, jobs, pages, problems, spectra
from service.handlers.request import require_known_query

_ELSEWHERE = "img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
_PLOTS = "style-src 'self' 'sha256-47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU='; style-src-attr 'unsafe-inline'"
"""Plotly makes one empty style element (the hash is that of nothing) and writes style attributes into its SVG."""
STRICT = f"default-src 'none'; script-src 'self'; {_PLOTS}; {_ELSEWHERE}"
"""A browser loads what this host serves, and runs no script written into a page."""
DOCS = f"default-src 'none'; script-src 'self' 'unsafe-inline'; style-src 'self' 'unsafe-inline'; {_ELSEWHERE}"
"""The pages of FastAPI's documentation carry a script in the page; they show nothing that anybody sent."""


def make_app(factory: Factory) -> FastAPI:
    """The application on one factory."""
    app: FastAPI = FastAPIOffline(
        title="lbacal",
        version=version("lbacal"),
        summary="Absolute calibration of radio antennas with the Galaxy: store spectra, ask what is in effect.",
        redoc_url=None,
        dependencies=[Depends(require_known_query)],
    )
    app.state.factory = factory
    for router in (
        spectra.router,
        calibrations.router,
        jobs.router,
        drift.router,
        health.router,
        pages.router,
        pages.assets,
    ):
        app.include_router(router)
    problems.install(app)

    app.middleware("http")(_secure)
    return app


async def _secure(request: Request, call_next: Callable[[Request], Awaitable[Response]]) -> Response:
    response = await call_next(request)
    response.headers["Content-Security-Policy"] = DOCS if request.url.path == "/docs" else STRICT
    response.headers["X-Content-Type-Options"] = "nosniff"
    response.headers["Referrer-Policy"] = "same-origin"
    return response
