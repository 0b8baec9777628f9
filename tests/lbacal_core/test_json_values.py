from __future__ import annotations

import pytest

from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.foreign import parse_name, parse_number, parse_numbers, parse_optional_name, read_json


@pytest.mark.parametrize("value", [float("nan"), float("inf"), True, "1", None, 10**400])
def test_what_is_no_finite_number_is_refused_with_its_place(value):
    with pytest.raises(BadInputError, match="here: expected a finite number"):
        parse_number(value, "here")


def test_the_first_entry_that_is_no_number_is_named():
    with pytest.raises(BadInputError, match="gain, entry 1: expected a finite number, found 'a'"):
        parse_numbers([1, "a", None], "gain")
    assert parse_numbers([1, 2.5], "gain").tolist() == [1.0, 2.5]


def test_a_name_is_printable_and_may_be_absent_where_that_is_allowed():
    assert parse_optional_name(None, "here") is None
    for value in ("", "a\nb", 3, None):
        with pytest.raises(BadInputError, match="here: expected a name"):
            parse_name(value, "here")


@pytest.mark.parametrize("text", ["", "{", '{"a": 1, "a": 2}', "[" * 100_000])
def test_a_file_that_is_no_json_is_a_sentence(tmp_path, text):
    (tmp_path / "f.json").write_text(text)
    with pytest.raises(UnreadableFileError, match="expected JSON"):
        read_json(tmp_path / "f.json")
