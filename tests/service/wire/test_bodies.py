from __future__ import annotations

import json
import tracemalloc
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given, strategies
from hypothesis import strategies as st

from lbacal_core.errors import BadInputError, LbacalError
from service.errors import MalformedBodyError, NotAcceptableError, TooLargeError
from service.wire import bodies
from service.wire.answers import FORMATS, choose_format
from service.wire.bodies import MAX_SPECTRA, ReasonBody, SpectraBody, parse_body, parse_json

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


@pytest.mark.long
def test_what_the_largest_batch_holds_is_within_every_limit() -> None:
    assert len(parse_body(SpectraBody, repeat(json.dumps(ROW), MAX_SPECTRA).encode()).spectra) == MAX_SPECTRA
    with pytest.raises(BadInputError, match="at most 100000 of them, found 100001"):
        parse_body(SpectraBody, repeat(json.dumps(ROW), MAX_SPECTRA + 1).encode())


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"blocks": 100', '"blocks": 100, "blocks": 100'),
        ('"blocks": 100', '"blocks" :100,"blocks" : 50'),
        ('"blocks": 100', '"blocks": 100, "\\u0062locks": 50'),
        ('"event_id": "e"', '"event_id": "x\\":", "event_id": "y"'),
        ('"power": [1.0, 2.0]', '"power": [1.0, 2.0], "env": {"a": 1, "a": 2}'),
        ('"power": [1.0, 2.0]', '"power": [1.0, {"a": 1, "a": 2}]'),
    ],
)
def test_a_field_given_twice_is_refused_however_it_is_written(old: str, new: str) -> None:
    assert old in body(ROW)
    with pytest.raises((MalformedBodyError, BadInputError), match="twice in one object"):
        parse_body(SpectraBody, body(ROW).replace(old, new).encode())


def _write(value: Any) -> str:
    """JSON of a value, whose objects are lists of pairs and may give a field twice."""
    if isinstance(value, tuple):
        return "{" + ",".join(f"{json.dumps(name)} : {_write(one)}" for name, one in value) + "}"
    return "[" + ",".join(map(_write, value)) + "]" if isinstance(value, list) else json.dumps(value)


_NAMES = st.sampled_from(["a", "b", 'a"', '":', "\\"])
_VALUES = st.none() | st.booleans() | st.integers() | st.floats() | st.text('a":, ', max_size=5)
_JSON = st.recursive(
    _VALUES,
    lambda inner: st.lists(inner, max_size=4) | st.lists(st.tuples(_NAMES, inner), max_size=4).map(tuple),
    max_leaves=12,
)


@given(_JSON)
def test_the_fast_reader_says_what_the_strict_one_says(value: Any) -> None:
    content = _write(value).encode()
    try:
        expected = bodies._read_strictly(content)
    except LbacalError as error:
        with pytest.raises(type(error)):
            parse_json(content)
        return
    assert parse_json(content) == expected


def test_a_text_that_looks_like_a_name_is_a_text() -> None:
    text = 'a":b" :"'
    assert parse_body(SpectraBody, body({**ROW, "event_id": text}).encode()).spectra[0].event_id == text


def test_text_that_is_not_utf_8_is_malformed() -> None:
    for content in (body(ROW).encode("utf-16"), b"\xef\xbb\xbf" + body(ROW).encode(), b"\xff"):
        with pytest.raises(MalformedBodyError, match="not JSON"):
            parse_body(SpectraBody, content)


@pytest.mark.parametrize("reason", ["\x00", "a\x00b", " ", "a\x1b[2J", ""])
def test_a_reason_of_nul_alone_was_text(reason: str) -> None:
    with pytest.raises(BadInputError, match="reason"):
        parse_body(ReasonBody, json.dumps({"reason": reason}).encode())


@pytest.mark.parametrize("reason", ["x", "two words", "two\nlines\tand a tab", " é "])
def test_a_reason_is_any_text_that_is_seen(reason: str) -> None:
    assert parse_body(ReasonBody, json.dumps({"reason": reason}).encode()).reason == reason


@pytest.mark.parametrize(
    ("accept", "kind"),
    [
        (None, "json"), ("", "json"), ("*/*", "json"), ("application/*", "json"), ("text/*", "csv"),
        ("application/fits", "fits"), ("APPLICATION/FITS ; q=0.3", "fits"),
        ("application/x-hdf5, application/json;q=0.5", "hdf5"),
        ("text/html, application/xhtml+xml, */*;q=0.8", "json"), ("application/json;q=0, */*", "csv"),
        ("text/csv;q=0.2, application/fits;q=0.3", "fits"),
    ],
)  # fmt: skip
def test_the_header_accept_chooses(accept: str | None, kind: str) -> None:
    assert choose_format(None, accept) == kind
    assert choose_format("csv", accept) == "csv"


@pytest.mark.parametrize(
    "accept", ["application/xml", "text/plain", "image/png, text/html", "application/json;q=0", "json", "*/*;q=x"]
)
def test_what_cannot_be_served_was_answered_with_json_and_is_refused_now(accept: str) -> None:
    with pytest.raises(NotAcceptableError, match="this answer is application/json or text/csv or"):
        choose_format(None, accept)


@given(strategies.text(alphabet="abcjson/*,;=q01.- \t\x00é", max_size=60))
def test_any_header_is_a_choice_or_a_refusal(accept: str) -> None:
    with suppress(NotAcceptableError):
        assert choose_format(None, accept) in FORMATS
