"""Request bodies, strict: an unknown field, a number as text or a control character is an error with its place."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sized
from typing import Annotated, Any, Literal, NoReturn, TypeVar

import jiter
import numpy as np
from pydantic import BaseModel, ConfigDict, FailFast, Field, StringConstraints, ValidationError

from lbacal_core.errors import BadInputError
from lbacal_core.foreign import require_unique_fields
from lbacal_core.spectra.spectra import MAX_COVARIATES
from service.errors import MalformedBodyError, TooLargeError, describe_refusal

MAX_SPECTRA = 100_000
"""Spectra a batch: 174 events of the Superterp, or 64 MB of 51 channels."""
LONGEST_NAME = 200
MAX_FIELDS = 64
"""Fields of one object; the largest body has nine."""
_MOST = {"{": 2 * MAX_SPECTRA + 100, "[": MAX_SPECTRA + 100, ":": 30 * MAX_SPECTRA, ",": 80 * MAX_SPECTRA}
"""Signs of structure in a body. What holds more of them than any batch takes many times its size in memory."""

_CONTAINERS = (dict, list)

Name = Annotated[str, StringConstraints(min_length=1, max_length=LONGEST_NAME, pattern=r"^[^\x00-\x1f\x7f]+$")]
_PRINTED = r"[^\x00-\x08\x0b-\x1f\x7f]*"
Reason = Annotated[
    str, StringConstraints(min_length=1, max_length=2000, pattern=rf"^{_PRINTED}[^\s\x00-\x1f\x7f]{_PRINTED}$")
]
DipoleName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_+-]{0,7}$")]
CovariateName = Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_]{0,39}$")]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Power = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Number = Annotated[int, Field(ge=0, le=2**31 - 1)]


class Body(BaseModel):
    """Base of all bodies."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


class SpectrumBody(Body):
    """One spectrum: `power` is mean |F(nu)|^2/R_r per channel, ADC^2/Ohm/MHz, > 0."""

    event_id: Name
    time_utc: str
    station: Name
    antenna: Number
    dipole: DipoleName
    blocks: Annotated[int, Field(gt=0, le=2**31 - 1)]
    power: Annotated[list[Power], FailFast()]
    env: Annotated[dict[CovariateName, Finite | None], Field(max_length=MAX_COVARIATES)] | None = None


class SpectraBody(Body):
    """A batch of spectra on one frequency grid."""

    frequency_mhz: Annotated[list[Finite], FailFast()]
    spectra: Annotated[list[SpectrumBody], Field(min_length=1, max_length=MAX_SPECTRA), FailFast()]
    resistance_ohm: Finite | None = None


class FlagBody(Body):
    """Set or clear (null) the quality flag of an event."""

    flag: Name | None
    reason: Reason


class PromotionBody(Body):
    """Promote a version for an interval; `calibration` null withdraws what the scope has there.

    To withdraw what the array has, `scope` must say so: a forgotten `station` must not do it.
    """

    calibration: Name | None
    scope: Literal["array"] | None = None
    station: Name | None = None
    antenna: Number | None = None
    dipole: DipoleName | None = None
    valid_from: str
    valid_to: str | None = None
    reason: Reason


class ReasonBody(Body):
    """Why something is done whose address says what."""

    reason: Reason


class AcknowledgementBody(Body):
    """Say that a problem is known, until an instant or for good."""

    until: str | None = None
    reason: Reason


class MomentBody(Body):
    """When something changed, and how well that is known."""

    value: str
    sigma_days: Annotated[float, Field(ge=0, le=366, allow_inf_nan=False)] = 0.0


class PathBody(Body):
    """A path, or without `dipole` both paths of an antenna."""

    station: Name
    antenna: Number
    dipole: DipoleName | None = None


class SizeBody(Body):
    """A change of C as a fraction, and its standard deviation."""

    value: Annotated[float, Field(gt=-1, lt=100, allow_inf_nan=False)]
    sigma: Annotated[float, Field(ge=0, allow_inf_nan=False)]


class ChangeBody(Body):
    """Enter what is known to have changed: in paths, a whole station, or the array."""

    paths: Annotated[list[PathBody], Field(min_length=1, max_length=1000)] | None = None
    station: Name | None = None
    array: Literal[True] | None = None
    at: MomentBody
    kind: Literal["step", "ramp", "season", "course"] = "step"
    size: SizeBody | None = None
    reason: Reason


Act = Literal["in_force", "dismissed"]


class DecisionBody(Body):
    """Put a change in force, or dismiss it."""

    decision: Act
    reason: Reason


class TagBody(Body):
    """Freeze the ledger as it was known at `as_of`, or as it is now."""

    as_of: str | None = None
    reason: Reason


class AdoptionBody(Body):
    """Adopt a finding of an investigation, by its number in the report, or structure without a name."""

    finding: Number | Literal["unexplained"]
    reason: Reason
    promote: bool = False


class InvestigationBody(Body):
    """Ask what the simulation gets wrong in the window [since, until): one report a station and calendar year."""

    since: str
    until: str
    station: Name | None = None
    reason: Reason


class RefitBody(Body):
    """Ask for fits over the window [since, until)."""

    scope: Literal["array", "station", "antenna"]
    since: str
    until: str
    station: Name | None = None
    antenna: Number | None = None
    dipole: DipoleName | None = None
    reason: Reason
    promote: bool = False
    fit: Literal["years", "year"] = Field(
        default="years", description="whether one chain is fitted through the years, or the window by itself"
    )


AnyBody = TypeVar("AnyBody", bound=Body)
AnySized = TypeVar("AnySized", bound=Sized)


def parse_body(kind: type[AnyBody], content: bytes) -> AnyBody:
    """Read a body: not JSON is malformed, JSON of another shape is bad input at its place."""
    try:
        return kind.model_validate(parse_json(content))
    except ValidationError as error:
        errors = error.errors(include_url=False)
        expected, found = describe_refusal(errors)
        place = "body" + "".join(f"[{k}]" if isinstance(k, int) else f".{k}" for k in errors[0]["loc"])
        more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
        raise BadInputError(place, expected, found + more) from error


def parse_json(content: bytes) -> Any:
    """Read JSON, within bounds: no field twice in an object, no NaN, and not more structure than any batch has."""
    signs = np.frombuffer(content, dtype=np.uint8)
    for sign, most in _MOST.items():
        if (count := np.count_nonzero(signs == ord(sign))) > most:
            raise TooLargeError(f"the body has {count} times {sign!r}, {most} are allowed: send smaller batches")
    try:
        parsed = jiter.from_json(content, allow_inf_nan=False, catch_duplicate_keys=True)
    except ValueError:
        return _read_strictly(content)
    _require_few_fields(parsed)
    return parsed


def _require_few_fields(value: Any) -> None:
    """Refuse objects of many fields, but for those in lists that begin with a number, which no body has."""
    inside: Iterable[Any]
    if isinstance(value, dict):
        inside = _limited(value).values()
    elif isinstance(value, list) and value and not isinstance(value[0], float):
        inside = value
    else:
        return
    for one in inside:
        if type(one) in _CONTAINERS:
            _require_few_fields(one)


def _read_strictly(content: bytes) -> Any:
    """Read JSON five times as slowly, to say what is wrong where something is."""
    try:
        return json.loads(content.decode(), object_pairs_hook=_make_object, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise MalformedBodyError(f"the body is not JSON: {error}") from error


def _make_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    _limited(pairs)
    return require_unique_fields(pairs)


def _limited(fields: AnySized) -> AnySized:
    if len(fields) > MAX_FIELDS:
        raise BadInputError("body", f"objects of at most {MAX_FIELDS} fields", str(len(fields)))
    return fields


def _refuse_constant(name: str) -> NoReturn:
    raise BadInputError("body", "JSON, whose numbers are finite", name)
