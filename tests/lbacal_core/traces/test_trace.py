from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.traces.assembly import EventFacts, assemble_spectra, read_event_facts
from lbacal_core.traces.background import CleaningSettings
from lbacal_core.traces.trace import (
    Trace,
    TraceReference,
    find_files,
    group_traces,
    list_traces,
    name_dipole,
    name_station,
    require_antenna_set,
)

REFERENCE = TraceReference(Path("a.dat"), "10", "CS011", 10, 1_311_073_541, 7_283_712, 200e6)


@pytest.mark.parametrize(
    ("number", "name"),
    [
        (2, "CS002"),
        (11, "CS011"),
        (99, "CS099"),
        (101, "CS101"),
        (106, "RS106"),
        (121, "CS201"),
        (142, "CS302"),
        (146, "RS306"),
        (181, "CS501"),
        (188, "RS508"),
        (201, "DE601"),
        (208, "UK608"),
    ],
)
def test_packed_station_numbers_give_the_stations_names(number, name):
    assert name_station(number) == name


@pytest.mark.parametrize(
    ("antenna_set", "letters"),
    [
        ("UNDEFINED", "XYXY"),
        ("LBA_INNER", "XYXY"),
        ("LBA_OUTER", "YXYX"),
        # Antenna 4 (receivers 8 and 9) and antenna 5 (10 and 11): once inner and outer, once the reverse.
        ("LBA_SPARSE_EVEN", "XYYX"),
        ("LBA_SPARSE_ODD", "YXXY"),
    ],
)
def test_letters_are_those_of_the_field_of_each_antenna_and_exchanged_in_the_outer_one(antenna_set, letters):
    assert "".join(name_dipole(rcu, antenna_set) for rcu in (8, 9, 10, 11)) == letters
    assert {name_dipole(rcu, "LBA_X") for rcu in range(96)} == {"X"}
    assert {name_dipole(rcu, "LBA_Y") for rcu in range(96)} == {"Y"}


def test_a_set_that_nobody_knows_is_refused_instead_of_named_by_parity():
    require_antenna_set(None)
    require_antenna_set("LBA_SPARSE_ODD")
    with pytest.raises(BadInputError, match="LBA_SPARSE_EVEN"):
        require_antenna_set("LBA_OUTTER")


def test_a_reference_knows_its_instant_and_antenna():
    assert REFERENCE.time_unix == pytest.approx(1_311_073_541.03641856, abs=1e-6)
    assert REFERENCE.antenna == 5


def test_impossible_receivers_rates_and_blocks_that_do_not_rise_in_time_are_refused():
    with pytest.raises(BadInputError, match="RCU"):
        replace(REFERENCE, rcu=192)
    with pytest.raises(BadInputError, match="sample rate"):
        replace(REFERENCE, sample_rate_hz=200.0)
    samples = np.zeros((2, 1024), dtype=np.int16)
    with pytest.raises(BadInputError, match="rising"):
        Trace(REFERENCE, samples, np.array([3, 3]), np.ones(2, dtype=bool), {})
    with pytest.raises(BadInputError, match="1024"):
        Trace(REFERENCE, samples[:, :100], np.array([3, 4]), np.ones(2, dtype=bool), {})


ONE = replace(REFERENCE, start_sample=199_999_000)


def test_traces_either_side_of_a_second_are_one_event():
    later = replace(ONE, rcu=11, start_s=ONE.start_s + 1, start_sample=24)
    other_station = replace(ONE, station="CS002")
    next_event = replace(ONE, start_s=ONE.start_s + 60)
    events = group_traces([next_event, later, ONE, other_station])
    assert [(event.event_id, event.station, len(event.references)) for event in events] == [
        ("20110719T110541", "CS011", 2),
        ("20110719T110541", "CS002", 1),
        ("20110719T110641", "CS011", 1),
    ]


def test_a_given_name_holds_and_two_traces_of_one_path_are_refused():
    assert group_traces([ONE], "E7")[0].event_id == "E7"
    with pytest.raises(BadInputError, match="RCU 10"):
        group_traces([ONE, replace(ONE, path=Path("b.dat"))])


def test_folders_are_searched_and_bad_paths_named(tmp_path):
    (tmp_path / "deep").mkdir()
    for name in ("deep/b.dat", "a.h5", "notes.txt"):
        (tmp_path / name).write_bytes(b"x")
    assert [file.name for file in find_files([tmp_path])] == ["a.h5", "b.dat"]
    with pytest.raises(UnreadableFileError, match="no such file"):
        list_traces(tmp_path / "absent.dat")
    (tmp_path / "empty.dat").write_bytes(b"")
    with pytest.raises(UnreadableFileError, match="empty"):
        list_traces(tmp_path / "empty.dat")


SETTINGS = CleaningSettings()


def record(event: str, rcu: int, time_unix: float, excluded: str = "") -> dict[str, object]:
    return {
        "event_id": event,
        "station": "CS002",
        "rcu": rcu,
        "antenna": rcu // 2,
        "dipole": "XY"[rcu % 2],
        "time_unix": time_unix,
        "blocks": 400,
        "excluded": excluded,
        "power": [] if excluded else [1.0 + rcu] * 51,
    }


def test_records_become_spectra_in_order_of_time_without_the_excluded():
    records = [record("B", 3, 1.5e9), record("A", 4, 1.4e9), record("A", 2, 1.4e9), record("A", 5, 1.4e9, "dead")]
    facts = EventFacts(environment={"A": {"temperature_c": 4.0}})
    found = assemble_spectra(records, SETTINGS, facts)
    assert found.event_id.tolist() == ["A", "A", "B"]
    assert found.antenna.tolist() == [1, 2, 1]
    assert found.power[:, 0].tolist() == [3.0, 5.0, 4.0]
    assert found.environment["temperature_c"].tolist()[:2] == [4.0, 4.0]
    assert np.isnan(found.environment["temperature_c"][2])


def test_event_facts_are_read_and_holes_are_unknown(tmp_path):
    path = tmp_path / "events.csv"
    path.write_text("# station log\nevent_id,temperature_c,rain_mm_h,pulse_unix\nA,3.5,,1400000000.25\nB,,0.2,\n")
    facts = read_event_facts(path)
    assert facts.pulse_unix == {"A": 1_400_000_000.25}
    assert facts.environment["A"]["temperature_c"] == 3.5
    assert np.isnan(facts.environment["B"]["temperature_c"])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time,temperature_c\n1,2\n", "event_id"),
        ("event_id,wind\nA,2\n", "wind"),
        ("event_id,rain_mm_h\nA,much\n", "row 1"),
        ("event_id,rain_mm_h\nA,inf\n", "finite"),
    ],
)
def test_bad_event_facts_are_named(tmp_path, text, words):
    path = tmp_path / "events.csv"
    path.write_text(text)
    with pytest.raises(BadInputError, match=words):
        read_event_facts(path)
    with pytest.raises(UnreadableFileError):
        read_event_facts(tmp_path / "absent.csv")
