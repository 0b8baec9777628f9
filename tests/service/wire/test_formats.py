from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given, strategies

from service.errors import NotAcceptableError
from service.wire.answers import FORMATS, choose_format


@pytest.mark.parametrize(
    ("accept", "kind"),
    [
        (None, "json"),
        ("", "json"),
        ("*/*", "json"),
        ("application/*", "json"),
        ("text/*", "csv"),
        ("application/fits", "fits"),
        ("APPLICATION/FITS ; q=0.3", "fits"),
        ("application/x-hdf5, application/json;q=0.5", "hdf5"),
        ("text/html, application/xhtml+xml, */*;q=0.8", "json"),
        ("application/json;q=0, */*", "csv"),
        ("text/csv;q=0.2, application/fits;q=0.3", "fits"),
    ],
)
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
