"""The life of a path, a station or the array: what was in effect when, and all that happened to it."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request, Response

from lbacal.instants import format_instant, parse_instant
from service.factory import Factory
from service.handlers.drift import describe_alarm, describe_change
from service.handlers.models import describe_investigation, describe_model
from service.handlers.request import InPath, UseCases, Whole, answer
from service.handlers.routes import reads
from service.usecases.life import Life, list_bad
from service.wire.answer_models import (
    BadAntennasAnswer,
    BadPathAnswer,
    EpochAnswer,
    FactorAnswer,
    InEffectStretch,
    LifeAnswer,
    PromotionLine,
    VersionAnswer,
)
from service.wire.answers import describe_scope, fill_answer

router = APIRouter(tags=["life"])


@reads(router, "/v1/paths/{station}/{antenna}/{dipole}/life", LifeAnswer, takes_turn=True)
def get_life_of_path(request: Request, use: UseCases, station: InPath, antenna: Whole, dipole: InPath) -> Response:
    """Get the life of a path.

    Its epochs between the changes in force, what was in effect when, and the versions, changes, causes, alarms and
    investigations that concern it, each in order of time.
    """
    return answer(request, describe_life(use.lives.of(station, antenna, dipole), use))


@reads(router, "/v1/stations/{station}/life", LifeAnswer, takes_turn=True)
def get_life_of_station(request: Request, use: UseCases, station: InPath) -> Response:
    """Get the life of a station, as that of a path."""
    return answer(request, describe_life(use.lives.of(station), use))


@reads(router, "/v1/life", LifeAnswer, takes_turn=True)
def get_life_of_array(request: Request, use: UseCases) -> Response:
    """Get the life of the array, as that of a path."""
    return answer(request, describe_life(use.lives.of(None), use))


@reads(router, "/v1/antennas/bad", BadAntennasAnswer, takes_turn=True)
def get_bad_antennas(request: Request, use: UseCases, at: str | None = None, station: str | None = None) -> Response:
    """Antennas not to be used at an instant (now unless given).

    Silent ones, those that investigations left out as insensitive, and those that lost more than half of their power
    at a change in force.
    """
    instant = use.clock() if at is None else parse_instant("at", at)
    found, calibrated = list_bad(use.database, use.instrument, instant, station)
    bad = [fill_answer(BadPathAnswer, one, **describe_scope(one.path), reason=one.sentence) for one in found]
    return answer(request, {"at": format_instant(instant), "bad": bad, "calibrated": calibrated})


def describe_life(life: Life, use: Factory) -> dict[str, Any]:
    """Describe a life as JSON values of `LifeAnswer`."""
    return {
        "epochs": [fill_answer(EpochAnswer, one) for one in life.epochs],
        "in_effect": [
            fill_answer(InEffectStretch, one, factor=factor and [fill_answer(FactorAnswer, at) for at in factor])
            for one, factor in zip(life.in_effect, life.factors, strict=True)
        ],
        "withdrawals": [fill_answer(PromotionLine, one, promotion=one.number) for one in life.withdrawals],
        "versions": [fill_answer(VersionAnswer, one) for one in life.versions],
        "changes": [describe_change(one, use) for one in life.changes],
        "causes": [describe_model(one) for one in life.causes],
        "alarms": [describe_alarm(one, use.clock()) for one in life.alarms],
        "investigations": [describe_investigation(one) for one in life.investigations],
    }
