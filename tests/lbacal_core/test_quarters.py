from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from lbacal_core.spectra.quarters import number_quarters, start_of_quarter
from lbacal_core.spectra.spectra import Spectra


def at(text: str) -> float:
    return datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()


@pytest.fixture
def spectra() -> Spectra:
    """Two paths, an event in the last minute of a quarter and one in the first of the next."""
    rng = np.random.default_rng(1)
    times = [at("2014-03-31T23:59:59.9"), at("2014-04-01T00:00:00")]
    return Spectra(
        frequency_mhz=np.array([30.0, 40.0, 50.0]),
        power=rng.lognormal(size=(4, 3)),
        event_id=np.array(["a", "b", "a", "b"]),
        time_unix=np.array(times * 2),
        station=np.array(["CS002"] * 4),
        antenna=np.array([0, 0, 1, 1]),
        dipole=np.array(["X"] * 4),
        blocks=np.full(4, 100),
    )


def test_quarters_begin_in_january_april_july_and_october() -> None:
    begins = [at(f"2014-{month:02}-01") for month in (1, 4, 7, 10)]
    numbers = number_quarters(np.array(begins))
    assert np.diff(numbers).tolist() == [1, 1, 1]
    assert [start_of_quarter(int(number)) for number in numbers] == begins
    assert number_quarters(np.array(begins) - 1e-3).tolist() == (numbers - 1).tolist()
    assert number_quarters(np.array([at("1969-12-31")])).tolist() == [-1]


def test_a_late_spectrum_changes_the_hash_of_one_quarter_of_one_path(spectra: Spectra) -> None:
    before, after = spectra.select(np.array([0, 1, 2])).quarter_hashes, spectra.quarter_hashes
    assert len(after) == 4
    new = ("CS002", 1, "X", int(number_quarters(spectra.time_unix)[3]))
    assert {key: value for key, value in after.items() if key != new} == before


def test_the_order_of_rows_does_not_count(spectra: Spectra) -> None:
    assert spectra.select(np.array([3, 1, 0, 2])).digest() == spectra.digest()


@pytest.mark.parametrize("field", ["power", "time_unix", "blocks", "event_id", "antenna", "frequency_mhz"])
def test_every_value_that_a_fit_sees_counts(spectra: Spectra, field: str) -> None:
    changed = getattr(spectra, field).copy()
    changed[-1] = "c" if field == "event_id" else changed[-1] + 1
    assert replace(spectra, **{field: changed}).digest() != spectra.digest()


def test_what_is_said_of_the_whole_counts(spectra: Spectra) -> None:
    for change in ({"resistance_ohm": 75.0}, {"width_mhz": np.ones(3)}, {"duration_s": np.ones(4)}):
        assert replace(spectra, **change).digest() != spectra.digest()


def test_the_digest_of_a_path_is_that_of_its_spectra_alone(spectra: Spectra) -> None:
    """A year of the array was hashed once for every path, each time from a copy of its rows."""
    for antenna in (0, 1):
        own = spectra.select(spectra.antenna == antenna)
        assert spectra.digest("CS002", antenna, "X") == own.digest() != spectra.digest()
    assert spectra.digest("CS002") == spectra.digest()


def test_the_same_spectra_in_another_path_or_quarter_are_others(spectra: Spectra) -> None:
    one = spectra.select(np.array([0]))
    assert replace(one, antenna=np.array([7])).digest() != one.digest()
    assert replace(one, dipole=np.array(["Y"])).digest() != one.digest()
