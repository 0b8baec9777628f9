"""Spectra in, and what is stored."""

from __future__ import annotations

from operator import attrgetter
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response

from lbacal.instants import format_instant, parse_instant
from service.handlers.request import (
    HDF5,
    InPath,
    JsonBody,
    Limit,
    SpectraUpload,
    StationQuery,
    UseCases,
    Whole,
    answer,
    caller_with,
    media_type_of,
)
from service.handlers.routes import acts, page_of, reads
from service.page.charts import Span
from service.storage.spectra import StoredEvent
from service.usecases.keys import Caller
from service.wire.answer_models import EventAnswer, EventsAnswer, ReceiptAnswer, ReceiptsAnswer
from service.wire.answers import fill_answer
from service.wire.bodies import FlagBody, SpectraBody, parse_body

router = APIRouter(tags=["spectra"])
Writer = Annotated[Caller, caller_with("spectra:write")]


@acts(router, "/v1/spectra", SpectraBody, ReceiptAnswer, 409, otherwise=ReceiptAnswer, media=HDF5)
def store_spectra(request: Request, use: UseCases, _caller: Writer, body: SpectraUpload) -> Response:
    """Store spectra.

    A whole batch or nothing, as JSON or as a spectra file (HDF5); sending the same again does no harm. 201 if
    anything was stored, else 200. `warnings` name the paths whose level does not belong to what is stored, and events
    with other covariates.
    """
    receipt = use.intake.receive(body, is_file=media_type_of(request) == HDF5)
    more = {"warnings": list(receipt.warnings) or None, "covariates": receipt.covariates or None}
    told = {name: value for name, value in fill_answer(ReceiptAnswer, receipt, **more).items() if value is not None}
    return answer(request, told, status=201 if receipt.stored else 200)


@reads(router, "/v1/spectra/receipts", ReceiptsAnswer)
def list_receipts(
    request: Request,
    use: UseCases,
    sha256: Annotated[str, Query(pattern=r"^[0-9a-f]{64}(,[0-9a-f]{64}){0,99}$", description="up to 100, with commas")],
) -> Response:
    """List the bodies that are stored already.

    Those among the named ones, by the SHA-256 of their bytes, whose spectra are all stored: they need not be sent
    again.
    """
    found = use.database.ask(lambda stores: stores.spectra.arrivals.find_receipts(sha256.split(",")))
    told = [one for digest in sorted(found) for one in found[digest][1]]
    return answer(request, {"stored": sorted(found), "warnings": told})


@reads(router, "/v1/events", EventsAnswer)
def list_events(
    request: Request,
    use: UseCases,
    station: StationQuery,
    since: str | None = None,
    until: str | None = None,
    flag: Annotated[str | None, Query(pattern=r"^[^\x00-\x1f]{1,200}$")] = None,
    cursor: Annotated[Whole, Query(ge=0, le=2**63 - 1)] = 0,
    limit: Limit = 100,
) -> Response:
    """List stored events.

    In order of arrival, with the count of their spectra; `next` is the cursor of the next page. The flag `far_level`
    lists those of which spectra wait because their level does not belong to what was stored.
    """
    ends = (None if one is None else parse_instant(name, one) for name, one in (("since", since), ("until", until)))
    span = Span(*ends)
    events = use.database.look(
        lambda stores: stores.spectra.events(cursor, limit, station, span.since, span.until, flag)
    )
    return answer(request, page_of("events", events, limit, describe_event, attrgetter("number")))


@acts(router, "/v1/events/{event_id}/flag", FlagBody, EventAnswer, 404, status=200)
def flag_event(request: Request, use: UseCases, caller: Writer, event_id: InPath, body: JsonBody) -> Response:
    """Set or clear the quality flag of an event.

    A flagged event is left out of fits; null clears. Who did it and why is kept.
    """
    wanted = parse_body(FlagBody, body)
    event = use.intake.set_flag(event_id, wanted.flag, reason=wanted.reason, by=caller.name)
    return answer(request, describe_event(event))


def describe_event(event: StoredEvent) -> dict[str, Any]:
    """Describe an event as JSON values of `EventAnswer`."""
    return fill_answer(EventAnswer, event, time_utc=format_instant(event.time))
