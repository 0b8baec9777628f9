"""Request bodies, strict: an unknown field, a number as text or a control character is an error with its place."""

from __future__ import annotations

from typing import Annotated, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError

from lbacal_core.errors import BadInputError
from service.errors import MalformedBodyError

Name = Annotated[str, StringConstraints(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f]+$")]
Reason = Annotated[
    str,
    StringConstraints(
        min_length=1, max_length=2000, pattern=r"^[^\x00-\x08\x0b-\x1f\x7f]*\S[^\x00-\x08\x0b-\x1f\x7f]*$"
    ),
]
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
    dipole: Literal["X", "Y"]
    blocks: Annotated[int, Field(gt=0, le=2**31 - 1)]
    power: list[float]
    env: dict[Name, float | None] | None = None


class SpectraBody(Body):
    """A batch of spectra on one frequency grid."""

    frequency_mhz: list[float]
    spectra: Annotated[list[SpectrumBody], Field(min_length=1)]
    resistance_ohm: float | None = None


class FlagBody(Body):
    """Set or clear (null) the quality flag of an event."""

    flag: Name | None
    reason: Reason


class PromotionBody(Body):
    """Promote a version for an interval; `calibration` null withdraws what the scope has there."""

    calibration: Name | None
    station: Name | None = None
    antenna: Number | None = None
    dipole: Literal["X", "Y"] | None = None
    valid_from: str
    valid_to: str | None = None
    reason: Reason


class RefitBody(Body):
    """Ask for fits over the window [since, until)."""

    scope: Literal["array", "station", "antenna"]
    since: str
    until: str
    station: Name | None = None
    antenna: Number | None = None
    dipole: Literal["X", "Y"] | None = None
    reason: Reason
    promote: bool = False


AnyBody = TypeVar("AnyBody", bound=Body)


def parse_body(kind: type[AnyBody], content: bytes) -> AnyBody:
    """Read a body: not JSON is malformed, JSON of another shape is bad input at its place."""
    try:
        return kind.model_validate_json(content)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        if first["type"] == "json_invalid":
            raise MalformedBodyError(f"the body is not JSON: {first['msg']}") from error
        place = "body" + "".join(f"[{k}]" if isinstance(k, int) else f".{k}" for k in first["loc"])
        more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
        found = "nothing" if first["type"] == "missing" else repr(first["input"])[:80]
        raise BadInputError(place, first["msg"].lower(), found + more) from error
