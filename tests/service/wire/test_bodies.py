from __future__ import annotations

import json
import tracemalloc
from typing import Any

import pytest

from lbacal_core.errors import BadInputError, LbacalError
from service.errors import MalformedBodyError, TooLargeError
from service.wire.bodies import MAX_SPECTRA, SpectraBody, parse_body

ROW = {
    "event_id": "e", "time_utc": "2014-03-01", "station": "CS001", "antenna": 0, "dipole": "X", "blocks": 100,
    "power": [1.0, 2.0],
}  # fmt: skip


def body(*rows: dict[str, Any]) -> str:
    return json.dumps({"frequency_mhz": [30.0, 31.0], "spectra": rows})


def repeat(row: str, count: int) -> str:
    return '{"frequency_mhz":[30,31],"spectra":[' + ",".join([row] * count) + "]}"


MEAN = {
    "300000 empty spectra": (repeat("{}", 300_000), TooLargeError),
    "90000 empty spectra": (repeat("{}", 90_000), BadInputError),
    "500000 nulls": (body({**ROW, "power": [None] * 500_000}), BadInputError),
    "nine million zeros": (repeat("0", 9_000_000), TooLargeError),
    "100000 fields": (json.dumps({str(k): 1 for k in range(100_000)}), BadInputError),
    "100000 covariates": (body({**ROW, "env": {f"n{k}": 1.0 for k in range(100_000)}}), BadInputError),
    "the same field 100000 times": ("{" + ",".join(['"a":1'] * 100_000) + "}", BadInputError),
    "lists in lists": ("[" * 100_000, MalformedBodyError),
    "a number of 5000 digits": (body(ROW).replace("100", "9" * 5000), MalformedBodyError),
}


@pytest.mark.parametrize(("content", "kind"), MEAN.values(), ids=MEAN.keys())
def test_a_bad_body_of_a_megabyte_cost_two_gigabytes_and_now_a_small_multiple(
    content: str, kind: type[LbacalError]
) -> None:
    raw = content.encode()
    tracemalloc.start()
    try:
        with pytest.raises(kind) as caught:
            parse_body(SpectraBody, raw)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 30 * len(raw) + 5e6, "bytes; the errors of every field of every row took 2500 times the body"
    assert len(str(caught.value)) < 500


def test_what_the_largest_batch_holds_is_within_every_limit() -> None:
    assert len(parse_body(SpectraBody, repeat(json.dumps(ROW), MAX_SPECTRA).encode()).spectra) == MAX_SPECTRA
    with pytest.raises(BadInputError, match="at most 100000 of them, found 100001"):
        parse_body(SpectraBody, repeat(json.dumps(ROW), MAX_SPECTRA + 1).encode())


def test_text_that_is_not_utf_8_is_malformed() -> None:
    for content in (body(ROW).encode("utf-16"), b"\xef\xbb\xbf" + body(ROW).encode(), b"\xff"):
        with pytest.raises(MalformedBodyError, match="not JSON"):
            parse_body(SpectraBody, content)
