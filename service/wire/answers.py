"""JSON answers: how values of the service look on the wire. Every function is pure: the same value, the same bytes."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypeVar

import numpy as np

from lbacal.instants import format_instant, format_optional
from lbacal_core.curves.validity import Instant, Scope
from lbacal_core.provenance import as_json
from service.errors import NotAcceptableError
from service.wire.answer_models import INSTANT, Answer


def to_json(content: Any) -> bytes:
    """Write an answer; never NaN."""
    return json.dumps(content, allow_nan=False, separators=(",", ":"), ensure_ascii=False).encode()


def describe_scope(scope: Scope) -> dict[str, Any]:
    """The fields `station`, `antenna` and `dipole`, None where they do not apply."""
    return {"station": scope.station, "antenna": scope.antenna, "dipole": scope.dipole}


def fill_answer(answer: type[Answer], *values: Any, **given: Any) -> dict[str, Any]:
    """The fields of an answer, each from the first value that has it: what a store holds is named once, in the answer.

    A value has its fields as attributes, or as keys.
    `made_at` is the instant `made` of a value, `alive` its `is_alive`, and a scope is told with its path. `given` are
    fields that a value has in another form, or not at all.
    """
    scope = next((value.scope for value in values if isinstance(getattr(value, "scope", None), Scope)), None)
    of_scope = {} if scope is None else {"scope": scope.level, **describe_scope(scope)}
    known = of_scope | given
    return {
        field.alias or name: known[name]
        if name in known
        else _read_field(name, values, is_instant=INSTANT in field.metadata)
        for name, field in answer.model_fields.items()
    }


def _read_field(name: str, values: Sequence[Any], *, is_instant: bool) -> Any:
    names = name, name.removesuffix("_at"), f"is_{name}"
    told = (_find(value, one) for value in values for one in names)
    found = next(one for one in told if one is not _ABSENT)
    if is_instant:
        return format_optional(found)
    if isinstance(found, np.ndarray):
        return as_json(found)
    return dict(found) if isinstance(found, Mapping) else list(found) if isinstance(found, tuple) else found


_ABSENT = object()


def _find(value: Any, name: str) -> Any:
    return value.get(name, _ABSENT) if isinstance(value, Mapping) else getattr(value, name, _ABSENT)


def describe_stretch(start: Instant, end: Instant | None) -> dict[str, Any]:
    """A half-open interval as text, `from` and `to` (None where it is open)."""
    return {"from": format_instant(start), "to": format_optional(end)}


# Which format an answer has: `format=` decides, else the header Accept, as far as we can serve it.

Format = Literal["json", "csv", "ecsv", "fits", "hdf5", "nuradio"]
FORMATS: dict[Format, str] = {
    "json": "application/json",
    "csv": "text/csv",
    "ecsv": "text/x-ecsv",
    "fits": "application/fits",
    "hdf5": "application/x-hdf5",
    "nuradio": "text/plain",
}
"""Media type of each format of a calibration. The first that a client takes is served."""
Name = TypeVar("Name")
_BY_NAME_ONLY = ("nuradio",)
"""Its 101 numbers are not what somebody means who takes any text."""


def choose_format(wanted: Format | None, accept: str | None) -> Format:
    """The format of an answer about calibrations."""
    if wanted is not None:
        return wanted
    return choose_media({name: media for name, media in FORMATS.items() if name not in _BY_NAME_ONLY}, accept)


def choose_media(offered: Mapping[Name, str], accept: str | None) -> Name:
    """The name of the offered media type that a client likes best, the first of those it likes equally.

    RFC 9110, 12.5.1: `type/subtype` goes before `type/*`, and that before `*/*`; what has quality 0 is refused.
    """
    ranges = _parse_accept(accept or "*/*")
    quality = {name: _quality(media, ranges) for name, media in offered.items()}
    best = max(quality, key=lambda name: quality[name])
    if quality[best] <= 0.0:
        raise NotAcceptableError(f"this answer is {' or '.join(offered.values())}, not {str(accept)[:60]}")
    return best


def _quality(media: str, ranges: Mapping[str, float]) -> float:
    family = media.partition("/")[0]
    return next((ranges[name] for name in (media, f"{family}/*", "*/*") if name in ranges), 0.0)


def _parse_accept(accept: str) -> dict[str, float]:
    """Quality of each media range; one that cannot be read has quality 0."""
    ranges: dict[str, float] = {}
    for part in accept.split(","):
        name, *parameters = (piece.strip().lower() for piece in part.split(";"))
        if name:
            given = [value for key, _, value in (p.partition("=") for p in parameters) if key.strip() == "q"]
            ranges[name] = max(ranges.get(name, 0.0), _parse_quality(given[0].strip() if given else "1"))
    return ranges or {"*/*": 1.0}


def _parse_quality(text: str) -> float:
    try:
        quality = float(text)
    except ValueError:
        return 0.0
    return quality if 0.0 <= quality <= 1.0 else 0.0
