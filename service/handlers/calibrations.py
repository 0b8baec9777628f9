"""The calibration in effect, and the versions behind it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from operator import attrgetter
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request, Response

from lbacal.instants import format_instant, parse_at
from lbacal.tables import write_format
from lbacal_core.curves.curves import STATUSES
from lbacal_core.curves.validity import Scope
from service.factory import Factory
from service.handlers.request import (
    IMMUTABLE,
    REVALIDATE,
    AntennaQuery,
    InPath,
    Limit,
    StationQuery,
    UseCases,
    Whole,
    answer,
    answer_in_pieces,
)
from service.handlers.routes import page_of, reads
from service.storage.models import ID_DIGITS
from service.storage.versions import Version
from service.usecases.calibrations import (
    CurveInEffect,
    InEffect,
    WrittenAnswer,
    WrittenCurve,
    select_paths,
    select_scope,
)
from service.usecases.gate import compare_versions
from service.wire import answer_models as wire
from service.wire import answers
from service.wire.answers import FORMATS, Format, choose_format, fill_answer, to_json

router = APIRouter(tags=["calibrations"])
CURVES_AT_ONCE = 64
"""Curves that are sent in one piece, 0.5 MB."""


@reads(router, "/v1/calibrations/effective", wire.InEffectAnswer, 404, takes_turn=True, files=True)
def get_in_effect(
    request: Request,
    use: UseCases,
    at: str | None = None,
    mjd: str | None = None,
    scope: Annotated[Literal["array"] | None, Query(description="array: its reference chain")] = None,
    station: str | None = None,
    antenna: AntennaQuery = None,
    dipole: str | None = None,
    as_of: str | None = None,
    tag: Annotated[str | None, Query(description="as_of of a tag")] = None,
    gap: Literal["error", "hold"] = "error",
    format: Format | None = None,  # noqa: A002 - its name on the wire
) -> Response:
    """Find the calibration in effect on a date.

    `at` (or `mjd`) is when the data were taken, `as_of` when the question is asked: pin it to get the same answer
    for ever, or ask by a `tag`, which does that under a name. A path is answered by its own version, else its
    station's, else the array's; a curve of a station or of the array is carried through the path's own cable
    (`factor`), with the spread of single paths as `c_sigma_sys`, and follows the ramps and seasons in force to the ten
    days of `at`. `scope=array` asks for the array's reference chain itself, which is nobody's cable.
    """
    kind = choose_format(format, request.headers.get("accept"))
    instant = parse_at(at, mjd)
    known = use.tags.read_knowledge(as_of, tag)
    is_whole = (scope, station, antenna, dipole, known.as_of, gap) == (None, None, None, None, None, "error")
    if is_whole:
        written = use.calibrations.answer_all(instant, partial(write_answer, use))
    else:
        paths = select_scope(use.full_instrument, scope, station, antenna, dipole)
        found = use.calibrations.in_effect(instant, paths, known.as_of, hold=gap == "hold")
        wanted = [curve for curve in found.curves if dipole in (None, curve.dipole)]
        written = write_answer(use, replace(found, curves=wanted))
    head = to_json({"at": format_instant(instant), "as_of": known.text})[:-1] + b',"curves":['
    cache = IMMUTABLE if known.is_final else REVALIDATE
    pieces = _join(head, written)
    if kind == "json" and is_whole:
        return answer_in_pieces(request, pieces, len(head) + written.size, f"{head!r} {written.digest}", cache)
    body = b"".join(pieces)
    content = body if kind == "json" else write_format(kind, json.loads(body))
    return answer(request, content, media_type=FORMATS[kind], cache=cache)


@reads(router, "/v1/budgets/{digest}", wire.BudgetAnswer, 404)
def get_budget(request: Request, use: UseCases, digest: InPath) -> Response:
    """Get one budget.

    The systematic terms that curves share: name, source and, by polarisation, vectors of d ln C along frequency,
    one standard deviation each, independent of each other. A term of the same name is the same for all.
    """
    return answer(request, use.database.look(lambda stores: stores.budgets.get(digest)), cache=IMMUTABLE)


@reads(router, "/v1/calibrations/edges", wire.EdgesAnswer, takes_turn=True)
def list_edges(request: Request, use: UseCases, as_of: str) -> Response:
    """List the instants at which answers change.

    The instants at which what `effective` answers about a station may change, as known at `as_of`: between two of
    them it is the same. `station` null is the array's reference chain. `lbacal sync` asks at each.
    """
    found = use.calibrations.edges(use.tags.read_past(as_of))
    instrument = use.full_instrument
    antennas = {s: sorted({r.antenna for r in instrument.antennas if r.station == s}) for s in found}
    listed = {station: [format_instant(edge) for edge in edges] for station, edges in found.items()}
    stations = [
        {"station": station, "antennas": antennas[station], "dipoles": list(instrument.dipoles), "edges": edges}
        for station, edges in listed.items()
    ]
    return answer(request, {"as_of": as_of, "stations": stations})


@reads(router, "/v1/calibrations", wire.VersionsAnswer)
def list_versions(
    request: Request,
    use: UseCases,
    station: StationQuery,
    scope: Annotated[Literal["array"] | None, Query(description="array: its versions only")] = None,
    antenna: AntennaQuery = None,
    dipole: str | None = None,
    status: Literal[STATUSES] | None = None,  # type: ignore[valid-type] # a closed list, written once
    cursor: Annotated[str, Query(pattern=r"^[0-9a-f]{0,64}$")] = "",
    limit: Limit = 100,
) -> Response:
    """List versions.

    In order of id, without their curves; `next` is the cursor of the next page.
    """
    select_paths(use.full_instrument, station, antenna, dipole)
    is_everything = (scope, station, antenna, dipole) == (None, None, None, None)
    wanted = None if is_everything else Scope(station, antenna, dipole)
    versions = use.database.look(lambda stores: stores.versions.search(wanted, status, cursor, limit))
    describe_version = partial(fill_answer, wire.VersionAnswer)
    return answer(request, page_of("calibrations", versions, limit, describe_version, attrgetter("id")))


@reads(router, "/v1/calibrations/{version_id}", wire.WholeVersionAnswer, 404, files=True)
def get_version(
    request: Request,
    use: UseCases,
    version_id: InPath,
    format: Format | None = None,  # noqa: A002 - its name on the wire
) -> Response:
    """Get one version.

    Its inputs, curves and `payload_sha256`, the SHA-256 of `curves` as canonical JSON. The other formats have the
    columns of `effective`, the window of the fit as interval.
    """
    kind = choose_format(format, request.headers.get("accept"))
    version = use.database.look(lambda stores: stores.versions.get(version_id))
    chains = {dipole: chain.as_dict() for dipole, chain in version.chains.items()}
    more = {"reference": chains or None, "anomalies": version.anomalies.as_dict()}
    content = {**fill_answer(wire.VersionAnswer, version), "curves": version.payload, **more}
    body = content if kind == "json" else write_format(kind, describe_version_rows(version))
    return answer(request, body, media_type=FORMATS[kind], cache=_keeping(version_id))


@reads(router, "/v1/calibrations/{first}/diff/{second}", wire.DiffAnswer, 404)
def get_diff(request: Request, use: UseCases, first: InPath, second: InPath) -> Response:
    """Compare two versions.

    Per dipole the change of C from the first to the second that one and the same path is served, as a fraction and in
    standard deviations.
    """
    a, b = use.database.look(lambda stores: (stores.versions.get(first), stores.versions.get(second)))
    return answer(request, describe_diff(a, b), cache=_keeping(first, second))


def write_answer(use: Factory, found: InEffect) -> WrittenAnswer:
    """Write the curves in effect as JSON, most of which were written before."""
    written = use.calibrations.write(found.curves, _write_curve)
    named = sorted({one.budget for one in written if one.budget is not None} & found.budgets.keys())
    end = b'],"budgets":{%b},"missing":%b}' % (
        ",".join(f"{json.dumps(name)}:{found.budgets[name]}" for name in named).encode(),
        to_json([answers.describe_scope(path) for path in found.missing]),
    )
    return WrittenAnswer([one.text for one in written], end)


def _join(head: bytes, written: WrittenAnswer) -> Iterator[bytes]:
    """An answer in pieces of some hundred kB."""
    yield head
    for first in range(0, len(written.curves), CURVES_AT_ONCE):
        yield (b"," if first else b"") + b",".join(written.curves[first : first + CURVES_AT_ONCE])
    yield written.end


def _write_curve(curve: CurveInEffect) -> WrittenCurve:
    covariance = curve.served.curve.covariance
    return WrittenCurve(to_json(_describe_curve(curve)), None if covariance is None else covariance.budget)


def _describe_curve(curve: CurveInEffect) -> dict[str, Any]:
    """A curve as in fit.json, as the path is served it, with the version and the scope that answered."""
    served, chain, promotion = curve.served, curve.chain, curve.promotion
    return {
        **served.curve.as_dict(),
        "calibration": promotion.calibration,
        "answered_by": promotion.scope.level,
        "factor": served.factor.tolist(),
        "factor_sigma": served.error,
        "flag": curve.flags,
        "flag_reason": curve.flag_reason,
        "reference": None if chain is None else fill_answer(
            wire.ReferenceAnswer, chain, paths=len(chain.members), cable=served.cable, cables=chain.cables.digest,
            spreads=None if chain.spreads is None else chain.spreads.digest,
        ),
        "valid": answers.describe_stretch(promotion.valid_from, promotion.valid_to),
        "held": curve.is_held,
        "trace": [fill_answer(wire.TraceAnswer, one, promotion=one.number) for one in curve.trace],
        "epoch": fill_answer(wire.EpochAnswer, curve.epoch),
        "why": curve.why,
    }  # fmt: skip


def _keeping(*ids: str) -> str:
    """How long an answer about versions may be kept: a short id may be that of several one day."""
    return IMMUTABLE if all(len(one) == ID_DIGITS for one in ids) else REVALIDATE


def describe_version_rows(version: Version) -> dict[str, Any]:
    """The converged curves of a version as an answer to "in effect at": `at`, `as_of`, `curves`."""
    window = answers.describe_stretch(version.since, version.until)
    more = {"calibration": version.id, "answered_by": version.scope.level, "valid": window, "held": False}
    curves = [
        {**curve.as_dict(), **more, "flag": curve.flags.tolist(), "flag_reason": None, "factor": [1.0] * len(curve.c)}
        for curve in version.curves
        if curve.c is not None
    ]
    return {"at": window["from"], "as_of": None, "curves": curves}


def describe_diff(first: Version, second: Version) -> dict[str, Any]:
    """The difference of two versions as `DiffAnswer`: their curves by dipole, and the inputs that are not the same."""
    curves = [fill_answer(wire.DiffCurve, change, dipole=dipole) for dipole, change in compare_versions(first, second)]
    names = sorted({*first.inputs, *second.inputs})
    inputs = {
        name: {"first": first.inputs.get(name), "second": second.inputs.get(name)}
        for name in names
        if first.inputs.get(name) != second.inputs.get(name)
    }
    return {"first": first.id, "second": second.id, "curves": curves, "inputs": inputs}


# What an antenna should see.

predictions = APIRouter(tags=["predictions"])


@reads(predictions, "/v1/predictions", wire.PredictionAnswer, 404, takes_turn=True)
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
