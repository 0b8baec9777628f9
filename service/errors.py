"""Failures of the service that a client can cause or cure; each class carries its HTTP status and code once."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from lbacal_core.errors import LbacalError


class MalformedBodyError(LbacalError, status=400, code="malformed_body"):
    """A body that is not JSON, or not HDF5 where that was announced."""


class UnauthenticatedError(LbacalError, status=401, code="no_valid_key"):
    """No valid key where one is needed."""


class ForbiddenError(LbacalError, status=403, code="scope_missing"):
    """A valid key without the scope."""


class NotFoundError(LbacalError, status=404, code="not_found"):
    """There is nothing under that name."""


class NotInEffectError(LbacalError, status=404, code="not_in_effect"):
    """No calibration is in effect at the instant; the message names the neighbours."""


class NotAcceptableError(LbacalError, status=406, code="not_acceptable"):
    """No media type that the client takes is one that the route has."""


class ConflictError(LbacalError, status=409, code="conflict"):
    """The request contradicts stored data."""


class TooLargeError(LbacalError, status=413, code="too_large"):
    """A body, or an order, above the limit."""


class UnsupportedMediaError(LbacalError, status=415, code="unsupported_media_type"):
    """A content type the route does not read."""


class SlowBodyError(LbacalError, status=408, code="slow_body"):
    """A body that does not come."""


class TooManyError(LbacalError, status=429, code="too_many"):
    """A caller asks for more than its share; `retry_s` is when to ask again."""

    def __init__(self, sentence: str, retry_s: float) -> None:
        super().__init__(sentence)
        self.retry_s = retry_s


class UnavailableError(LbacalError, status=503, code="unavailable"):
    """The database does not answer, or its schema is not the one this code needs.

    The sentence is for everybody; `detail` is what the database said, which may name hosts and roles: it is for the log
    and for whoever runs a command here. `is_passing` tells that waiting may cure it.
    """

    def __init__(self, sentence: str, detail: str = "", *, is_passing: bool = False) -> None:
        super().__init__(sentence)
        self.detail = " ".join(detail.split())
        self.is_passing = is_passing


# What pydantic found wrong, in the words of our own errors: what was expected, and what was found.


_EXPECTED = {
    "missing": "a value",
    "extra_forbidden": "no field of this name",
    "finite_number": "a finite number",
    "greater_than": "a number > {gt:g}",
    "greater_than_equal": "a number >= {ge:g}",
    "less_than_equal": "a number <= {le:g}",
    "literal_error": "{expected}",
    "string_pattern_mismatch": "text that matches {pattern}",
    "model_type": "an object",
    "model_attributes_type": "an object",
    "dict_type": "an object",
    "list_type": "a list",
    "too_long": "at most {max_length} of them",
    "too_short": "at least {min_length} of them",
    "string_too_long": "at most {max_length} characters",
    "string_too_short": "at least {min_length} character",
}
"""By pydantic's names of errors; they keep the case of the expected values, so that X stays X."""
_BEGINNING = re.compile(r"^(?:Input should be|Input should|Value error,) ")


def describe_refusal(errors: Sequence[Mapping[str, Any]]) -> tuple[str, str]:
    """Describe the first of pydantic's errors: what was expected, and what was found."""
    first = errors[0]
    words = _EXPECTED.get(first["type"])
    expected = words.format(**first.get("ctx", {})) if words else _BEGINNING.sub("", first["msg"])
    if first["type"] == "missing":
        return expected, "nothing"
    found = first["input"]
    if first["type"] in ("too_long", "too_short"):
        return expected, str(len(found))
    return expected, repr(found)[:80]
