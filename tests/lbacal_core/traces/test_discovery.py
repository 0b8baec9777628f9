from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.traces.trace import TraceReference, find_files, group_traces, list_traces, name_event

ONE = TraceReference(Path("a.dat"), "10", "CS011", 10, 1_311_073_541, 199_999_000, 200e6)


def test_an_event_is_named_after_its_utc_second() -> None:
    assert name_event(1_311_073_541.9) == "20110719T110541"


def test_traces_either_side_of_a_second_are_one_event() -> None:
    later = replace(ONE, rcu=11, start_s=ONE.start_s + 1, start_sample=24)
    other_station = replace(ONE, station="CS002")
    next_event = replace(ONE, start_s=ONE.start_s + 60)
    events = group_traces([next_event, later, ONE, other_station])
    assert [(event.event_id, event.station, len(event.references)) for event in events] == [
        ("20110719T110541", "CS011", 2),
        ("20110719T110541", "CS002", 1),
        ("20110719T110641", "CS011", 1),
    ]


def test_a_given_name_holds_and_two_traces_of_one_path_are_refused() -> None:
    assert group_traces([ONE], "E7")[0].event_id == "E7"
    with pytest.raises(BadInputError, match="RCU 10"):
        group_traces([ONE, replace(ONE, path=Path("b.dat"))])


def test_folders_are_searched_and_bad_paths_named(tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    for name in ("deep/b.dat", "a.h5", "notes.txt"):
        (tmp_path / name).write_bytes(b"x")
    assert [file.name for file in find_files([tmp_path])] == ["a.h5", "b.dat"]
    with pytest.raises(UnreadableFileError, match="no such file"):
        list_traces(tmp_path / "absent.dat")
    (tmp_path / "empty.dat").write_bytes(b"")
    with pytest.raises(UnreadableFileError, match="empty"):
        list_traces(tmp_path / "empty.dat")
