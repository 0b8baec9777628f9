"""What an antenna should see."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from lbacal.instants import format_instant, parse_at
from service.handlers.request import UseCases, Whole, answer
from service.handlers.routes import reads
from service.wire.answer_models import PredictionAnswer

router = APIRouter(tags=["predictions"])


@reads(router, "/v1/predictions", PredictionAnswer, 404, takes_turn=True)
def get_prediction(
    request: Request,
    use: UseCases,
    station: str,
    antenna: Whole,
    dipole: str,
    at: str | None = None,
    mjd: str | None = None,
    temperature_c: float | None = None,
) -> Response:
    """Predict the power of a path.

    The expected spectrum at `at` (or `mjd`) by the calibration then in effect with its covariance, what it is made of
    at the start of the chain, what the converter shows, the flux of a zenith source that doubles the power of this one
    dipole, and how the recorded power of single events scatters about it.
    """
    instant = parse_at(at, mjd)
    curve, found = use.predictions.of(station, antenna, dipole, instant, temperature_c)
    answered = {"calibration": curve.promotion.calibration, "answered_by": curve.promotion.scope.level}
    return answer(request, {"at": format_instant(instant), **answered, **found.as_dict()})
