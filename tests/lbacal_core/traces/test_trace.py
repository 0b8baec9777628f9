from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lbacal_core.errors import BadInputError
from lbacal_core.traces.trace import Trace, TraceReference, name_dipole, name_station, require_antenna_set

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


def test_mixed_sets_have_the_letters_of_the_field_of_each_antenna() -> None:
    """Antenna 4 (receivers 8 and 9) and antenna 5 (10 and 11): once inner and outer, once the reverse."""
    assert [name_dipole(rcu, "LBA_SPARSE_EVEN") for rcu in (8, 9, 10, 11)] == ["X", "Y", "Y", "X"]
    assert [name_dipole(rcu, "LBA_SPARSE_ODD") for rcu in (8, 9, 10, 11)] == ["Y", "X", "X", "Y"]
    assert {name_dipole(rcu, "LBA_X") for rcu in range(96)} == {"X"}
    assert {name_dipole(rcu, "LBA_Y") for rcu in range(96)} == {"Y"}


def test_a_set_that_nobody_knows_is_refused_instead_of_named_by_parity() -> None:
    require_antenna_set(None)
    require_antenna_set("LBA_SPARSE_ODD")
    with pytest.raises(BadInputError, match="LBA_SPARSE_EVEN"):
        require_antenna_set("LBA_OUTTER")


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
