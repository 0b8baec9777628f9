"""What pydantic found wrong, in the words of our own errors: what was expected, and what was found."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

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
