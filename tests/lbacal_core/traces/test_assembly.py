from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.traces.assembly import EventFacts, assemble_spectra, read_event_facts
from lbacal_core.traces.background import CleaningSettings

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


def test_records_become_spectra_in_order_of_time_without_the_excluded() -> None:
    records = [record("B", 3, 1.5e9), record("A", 4, 1.4e9), record("A", 2, 1.4e9), record("A", 5, 1.4e9, "dead")]
    facts = EventFacts(environment={"A": {"temperature_c": 4.0}})
    found = assemble_spectra(records, SETTINGS, facts)
    assert found.event_id.tolist() == ["A", "A", "B"]
    assert found.antenna.tolist() == [1, 2, 1]
    assert found.power[:, 0].tolist() == [3.0, 5.0, 4.0]
    assert found.environment["temperature_c"].tolist()[:2] == [4.0, 4.0]
    assert np.isnan(found.environment["temperature_c"][2])


def test_event_facts_are_read_and_holes_are_unknown(tmp_path: Path) -> None:
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
def test_bad_event_facts_are_named(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "events.csv"
    path.write_text(text)
    with pytest.raises(BadInputError, match=words):
        read_event_facts(path)
    with pytest.raises(UnreadableFileError):
        read_event_facts(tmp_path / "absent.csv")
