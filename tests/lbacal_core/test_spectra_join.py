from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lbacal_core.errors import BadInputError
from lbacal_core.spectra.spectra import Spectra, join_spectra


def part(events: range, **changes: Any) -> Spectra:
    n = len(events)
    power = 1.0 + np.outer(np.array(events), np.ones(3))
    values: dict[str, Any] = {
        "frequency_mhz": np.array([30.0, 31.0, 32.0]),
        "power": power,
        "event_id": np.array([f"E{k:03d}" for k in events]),
        "time_unix": 1.4e9 + 60.0 * np.array(events),
        "station": np.full(n, "CS002"),
        "antenna": np.zeros(n, dtype=np.int64),
        "dipole": np.full(n, "X"),
        "blocks": np.full(n, 100),
        "origin": f"{events.start}.h5",
    }
    return Spectra(**(values | changes))


def test_files_make_one_set_in_their_order() -> None:
    joined = join_spectra([part(range(3)), part(range(3, 5))])
    assert joined.event_id.tolist() == ["E000", "E001", "E002", "E003", "E004"]
    assert joined.power[:, 0].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert joined.origin == "0.h5 and 1 more"
    one = part(range(3))
    assert join_spectra([one]) is one


def test_a_spectrum_in_three_files_counts_once() -> None:
    joined = join_spectra([part(range(3)), part(range(2, 5)), part(range(4))])
    assert joined.event_id.tolist() == ["E000", "E001", "E002", "E003", "E004"]
    assert joined.digest() == part(range(5)).digest()


def test_two_spectra_of_one_path_in_one_event_that_differ_are_refused() -> None:
    other = part(range(2, 4))
    other = replace(other, power=2.0 * other.power)
    with pytest.raises(BadInputError, match=r"2\.h5: row 0: .*E002, CS002 antenna 0 X as in 0\.h5, row 2"):
        join_spectra([part(range(3)), other])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frequency_mhz": np.array([30.0, 31.0, 33.0])}, "5.h5"),
        ({"resistance_ohm": 75.0}, "resistance_ohm"),
        ({"width_mhz": np.full(3, 0.5)}, "width_mhz"),
        ({"duration_s": np.full(2, 1.0)}, "0.h5: duration_s"),
    ],
)
def test_files_of_another_kind_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(BadInputError, match=message):
        join_spectra([part(range(3)), part(range(5, 7), **changes)])


def test_a_covariate_is_unknown_where_a_file_lacks_it() -> None:
    warm = part(range(2), environment={"temperature_c": np.array([7.0, 8.0])}, duration_s=np.ones(2))
    joined = join_spectra([warm, part(range(2, 3), duration_s=np.full(1, 2.0))])
    assert joined.environment["temperature_c"].tolist()[:2] == [7.0, 8.0]
    assert np.isnan(joined.environment["temperature_c"][2])
    assert joined.duration_s is not None
    assert joined.duration_s.tolist() == [1.0, 1.0, 2.0]
