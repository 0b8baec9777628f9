from __future__ import annotations

from datetime import UTC, date, datetime, timedelta
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lbacal.instants import format_instant, format_time, parse_at, parse_instant, parse_mjd
from lbacal_core.errors import BadInputError


def seconds(*parts: int) -> int:
    return round(datetime(*parts, tzinfo=UTC).timestamp()) * 1_000_000  # type: ignore[misc]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2014-05-01", seconds(2014, 5, 1)),
        ("2014-05-01T12:30", seconds(2014, 5, 1, 12, 30)),
        ("2014-05-01 12:30:15", seconds(2014, 5, 1, 12, 30, 15)),
        ("2014-05-01T12:30:15Z", seconds(2014, 5, 1, 12, 30, 15)),
        ("2014-05-01T14:30:15+02:00", seconds(2014, 5, 1, 12, 30, 15)),
        ("2014-05-01T10:00:15-0230", seconds(2014, 5, 1, 12, 30, 15)),
        ("2014-05-01T00:00:00.5", seconds(2014, 5, 1) + 500_000),
        ("2014-05-01T00:00:00.1234567Z", seconds(2014, 5, 1) + 123_456),
        ("1969-12-31T23:59:59.999999", -1),
    ],
)
def test_an_instant_is_read_to_the_microsecond(text: str, expected: int) -> None:
    assert parse_instant("at", text) == expected


@pytest.mark.parametrize(
    "text",
    ["", "2014", "2014-05", "20140501", "56778", "56778.5", "1398902400", "2014-5-1", "2014-13-01", "2014-02-30",
     "2014-05-01T", "2014-05-01T12", "2014-05-01T25:00", "2014-05-01T12:30:61", "2014-05-01T12:30.5", "now", "today",
     "2014-05-01T12:30:15 02:00", "2014-05-01T12:30:15+25:00",
     " 2014-05-01", "2014-05-01\n", "٢٠١٤-05-01", "0000-01-01",
     "2014-W18-4", "2014-121", "nan", "null"],
)  # fmt: skip
def test_what_is_no_instant_is_an_error_and_not_a_second_of_1970(text: str) -> None:
    with pytest.raises(BadInputError, match="at: expected an ISO 8601"):
        parse_instant("at", text)


@given(st.integers(-(10**17) // 2, 10**17))
def test_an_instant_survives_writing_and_reading(instant: int) -> None:
    assert parse_instant("at", format_instant(instant)) == instant


def test_mjd_counts_days_from_1858() -> None:
    epoch = datetime(1858, 11, 17, tzinfo=UTC)
    expected = epoch + timedelta(days=56778.25)
    assert parse_mjd("mjd", "56778.25") == round(expected.timestamp() * 1e6)


@pytest.mark.parametrize(
    "text", ["", "nan", "inf", "-1", "1e9", "2014-05-01", "0x10", "4_0", "٥٦٧٧٨", "56778 ", "100000", "5e4", "."]
)
def test_what_is_no_mjd_is_an_error(text: str) -> None:
    with pytest.raises(BadInputError, match="mjd"):
        parse_mjd("mjd", text)


@pytest.mark.parametrize(
    "text",
    ["0001-01-01T00:00:00+01:00", "0001-01-01T00:00:00+14:00", "9999-12-31T23:59:59-23:59", "9999-12-31T23:59:59-0001"],
)
def test_a_local_instant_beyond_the_years_1_to_9999_is_refused_before_it_is_stored(text: str) -> None:
    with pytest.raises(BadInputError, match="years 1 to 9999"):
        parse_instant("at", text)


@pytest.mark.parametrize("text", ["0001-01-01T00:00:00Z", "9999-12-31T23:59:59.999999Z", "0001-01-01T14:00:00+14:00"])
def test_the_first_and_the_last_instant_are_written_back(text: str) -> None:
    assert parse_instant("at", format_instant(parse_instant("at", text))) == parse_instant("at", text)


def test_an_instant_stored_beyond_the_years_1_to_9999_does_not_break_what_lists_it() -> None:
    assert format_instant(seconds(1, 1, 1) - 3_600_000_000) == "0001-01-01T00:00:00Z"
    assert format_instant(2**63 - 1) == "9999-12-31T23:59:59.999999Z"


@pytest.mark.parametrize(("at", "mjd"), [(None, None), ("2014-05-01", "56778")])
def test_a_query_asks_about_exactly_one_instant(at: str | None, mjd: str | None) -> None:
    with pytest.raises(BadInputError, match="either at"):
        parse_at(at, mjd)


@pytest.mark.parametrize(
    ("given", "written"),
    [
        (date(2014, 5, 1), "2014-05-01"),
        (np.datetime64("2014-05-01"), "2014-05-01T00:00:00Z"),
        (np.datetime64("2014-05-01T12:30:15.5"), "2014-05-01T12:30:15.500000Z"),
        (np.datetime64("2014-05-01T12:30:15.123456789"), "2014-05-01T12:30:15.123456Z"),
        (datetime(2014, 5, 1, 12), "2014-05-01T12:00:00Z"),  # noqa: DTZ001 - a naive one is UTC
    ],
)
def test_dates_and_instants_of_numpy_are_written_as_others_are(given: Any, written: str) -> None:
    assert format_time(given) == written


@pytest.mark.parametrize("given", [np.datetime64("NaT"), np.datetime64("12014-05-01"), 2014])
def test_what_is_no_instant_of_iso_8601_is_refused(given: Any) -> None:
    with pytest.raises(BadInputError, match="an astropy Time, a date, a datetime or ISO 8601 text"):
        format_time(given)
