"""Whether the service lives and can serve."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from service.handlers.problems import document
from service.handlers.request import UseCases, answer
from service.storage.migration import require_current

router = APIRouter(tags=["health"])


@router.get("/healthz", summary="The process lives")
async def get_health(request: Request) -> Response:
    return answer(request, {"status": "alive"})


@router.get("/readyz", summary="The database answers and has the right schema", responses=document(503))
def get_readiness(request: Request, use: UseCases) -> Response:
    require_current(use.database)
    return answer(request, {"status": "ready", "instrument": use.instrument.name})
