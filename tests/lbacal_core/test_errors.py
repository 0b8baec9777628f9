from __future__ import annotations

import pytest

from lbacal_core import errors
from lbacal_core.errors import BadInputError, LbacalError, UnknownNameError


def test_a_refusal_says_where_what_was_expected_and_what_was_found() -> None:
    error = BadInputError("s.h5: power, row 17", "finite power > 0", "nan at 32 MHz")
    assert str(error) == "s.h5: power, row 17: expected finite power > 0, found nan at 32 MHz"
    assert (error.place, error.expected, error.found) == ("s.h5: power, row 17", "finite power > 0", "nan at 32 MHz")


def test_a_message_is_one_line_of_readable_length_whatever_was_found() -> None:
    sentence = str(BadInputError("file", "a number", "1\n2 " * 100_000))
    assert "\n" not in sentence
    assert len(sentence) < 200
    assert "\n" not in str(LbacalError("two\nlines"))


def test_an_unknown_name_is_answered_with_the_names_that_exist() -> None:
    assert "known: a, b" in str(UnknownNameError("station", "c", ["a", "b"]))


def every_error() -> list[type[LbacalError]]:
    return [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, LbacalError)]


def test_every_error_has_a_code_of_its_own() -> None:
    codes = [kind.code for kind in every_error()]
    assert len(codes) == len(set(codes)) >= 4


@pytest.mark.parametrize("kind", every_error())
def test_every_error_has_an_http_status_of_a_failure(kind: type[LbacalError]) -> None:
    assert 400 <= kind.status < 600


def test_what_a_file_holds_never_steers_the_terminal() -> None:
    assert str(BadInputError("file", "a name", "\x1b[2Jgone\x00")) == "file: expected a name, found ?[2Jgone?"
