from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from lbacal.transport import bodies_of_events, files_of_events
from lbacal_core.spectra.spectra import Spectra, read_spectra

SPECTRA = Spectra(
    frequency_mhz=np.array([30.0, 31.0]),
    power=np.arange(1.0, 13.0).reshape(6, 2),
    event_id=np.array(["b", "a", "b", "c", "a", "Ä"]),
    time_unix=np.array([1.4e9 + 2, 1.4e9, 1.4e9 + 1, 1.4e9 + 1.5, 1.4e9 + 3, 1.4e9 + 9]),
    station=np.array(["CS002"] * 6),
    antenna=np.arange(6),
    dipole=np.array(list("XYXYXY")),
    blocks=np.full(6, 100),
    environment={"rain_mm_h": np.array([1.0, np.nan, 2.0, 3.0, 4.0, 5.0])},
)


def test_each_event_is_one_file_in_order_of_time_and_nothing_is_lost(tmp_path: Path) -> None:
    found = []
    for k, (count, rows, content) in enumerate(files_of_events(SPECTRA)):
        (tmp_path / f"{k}.h5").write_bytes(content)
        found.append(read_spectra(tmp_path / f"{k}.h5"))
        assert (len(found[-1]), count) == (rows, 1)
    assert [set(one.event_id.tolist()) for one in found] == [{"a"}, {"b"}, {"c"}, {"Ä"}]
    assert sorted(np.concatenate([one.power[:, 0] for one in found])) == SPECTRA.power[:, 0].tolist()
    assert found[0].environment["rain_mm_h"].tolist()[1:] == [4.0]
    assert found[0].time_unix.tolist() == [1.4e9, 1.4e9 + 3]


def test_a_bundle_takes_whole_events_until_it_holds_enough() -> None:
    assert [(count, rows) for count, rows, _ in files_of_events(SPECTRA, 3)] == [(2, 4), (2, 2)]
    assert [(count, rows) for count, rows, _ in files_of_events(SPECTRA, 100)] == [(4, 6)]


def test_the_same_spectra_make_the_same_bytes_and_others_do_not() -> None:
    first, again = (list(files_of_events(SPECTRA)) for _ in range(2))
    changed = replace(SPECTRA, power=SPECTRA.power * (1 + 1e-15))
    assert first == again
    assert not {content for *_, content in first} & {content for *_, content in files_of_events(changed)}


def test_json_says_of_each_event_what_the_file_does() -> None:
    bodies = list(bodies_of_events(SPECTRA))
    assert [[row["event_id"] for row in body["spectra"]] for body in bodies] == [["a", "a"], ["b", "b"], ["c"], ["Ä"]]
    assert bodies[0]["spectra"][0] == {
        "event_id": "a", "time_utc": "2014-05-13T16:53:20Z", "station": "CS002", "antenna": 1, "dipole": "Y",
        "blocks": 100, "power": [3.0, 4.0],
    }  # fmt: skip


def test_no_spectra_are_no_bodies() -> None:
    assert list(files_of_events(SPECTRA.select(np.zeros(6, dtype=bool)))) == []
