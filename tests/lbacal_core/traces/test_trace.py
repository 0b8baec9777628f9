from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lbacal_core.errors import BadInputError
from lbacal_core.traces.trace import Trace, TraceReference, name_dipole, name_station

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
def test_packed_station_numbers_give_the_stations_names(number: int, name: str) -> None:
    assert name_station(number) == name


def test_the_outer_set_exchanges_the_letters_of_even_and_odd_receivers() -> None:
    assert [name_dipole(rcu, "UNDEFINED") for rcu in (10, 11)] == ["X", "Y"]
    assert [name_dipole(rcu, "LBA_INNER") for rcu in (10, 11)] == ["X", "Y"]
    assert [name_dipole(rcu, "LBA_OUTER") for rcu in (10, 11)] == ["Y", "X"]


def test_a_reference_knows_its_instant_and_antenna() -> None:
    assert REFERENCE.time_unix == pytest.approx(1_311_073_541.03641856, abs=1e-6)
    assert REFERENCE.antenna == 5


def test_impossible_receivers_and_rates_are_refused() -> None:
    with pytest.raises(BadInputError, match="RCU"):
        replace(REFERENCE, rcu=192)
    with pytest.raises(BadInputError, match="sample rate"):
        replace(REFERENCE, sample_rate_hz=200.0)


def test_blocks_must_rise_in_time() -> None:
    samples = np.zeros((2, 1024), dtype=np.int16)
    with pytest.raises(BadInputError, match="rising"):
        Trace(REFERENCE, samples, np.array([3, 3]), np.ones(2, dtype=bool), {})
    with pytest.raises(BadInputError, match="1024"):
        Trace(REFERENCE, samples[:, :100], np.array([3, 4]), np.ones(2, dtype=bool), {})
