"""The record of one antenna."""

from __future__ import annotations

from lbacal_core.instrument.antennas import AntennaRecord, parse_record, record_as_dict


def test_a_record_covers_its_first_instant_and_not_its_last() -> None:
    record = AntennaRecord("CS002", 0, "50 m", since=10.0, until=20.0)
    assert [record.covers(instant) for instant in (9.9, 10.0, 19.9, 20.0)] == [False, True, True, False]


def test_a_record_returns_as_the_row_it_came_from() -> None:
    row = {"station": "S1", "antenna": 3, "cable": "50 m", "since": "2013-05-01T00:00:00+00:00", "group": "board 1"}
    assert record_as_dict(parse_record(row, "row 0")) == row
