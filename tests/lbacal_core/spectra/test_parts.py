from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest

from lbacal_core.errors import BadInputError
from lbacal_core.spectra.blocks import split_into_blocks
from lbacal_core.spectra.spectra import Spectra, join_spectra, number_quarters


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


def test_quarters_begin_in_january_april_july_and_october():
    begins = [at(f"2014-{month:02}-01") for month in (1, 4, 7, 10)]
    numbers = number_quarters(np.array(begins))
    assert np.diff(numbers).tolist() == [1, 1, 1]
    assert number_quarters(np.array(begins) - 1e-3).tolist() == (numbers - 1).tolist()
    assert number_quarters(np.array([at("1969-12-31")])).tolist() == [-1]


def test_a_late_spectrum_changes_the_hash_of_one_quarter_of_one_path(spectra):
    before, after = (
        {(path, number): value for path, of_path in one.quarter_hashes.items() for number, value in of_path.items()}
        for one in (spectra.select(np.array([0, 1, 2])), spectra)
    )
    assert len(after) == 4
    new = ("CS002", 1, "X"), int(number_quarters(spectra.time_unix)[3])
    assert {key: value for key, value in after.items() if key != new} == before


@pytest.mark.parametrize("field", ["power", "time_unix", "blocks", "event_id", "antenna", "frequency_mhz"])
def test_every_value_that_a_fit_sees_counts(spectra, field):
    changed = getattr(spectra, field).copy()
    changed[-1] = "c" if field == "event_id" else changed[-1] + 1
    whole = {"resistance_ohm": 75.0, "width_mhz": np.ones(3), "duration_s": np.ones(4)}
    for change in ({field: changed}, *({name: value} for name, value in whole.items())):
        assert replace(spectra, **change).digest() != spectra.digest()


def test_the_digest_of_a_path_is_that_of_its_spectra_alone(spectra):
    """A year of the array was hashed once for every path, each time from a copy of its rows."""
    for antenna in (0, 1):
        own = spectra.select(spectra.antenna == antenna)
        assert spectra.digest("CS002", antenna, "X") == own.digest() != spectra.digest()
    assert spectra.digest("CS002") == spectra.digest()


def test_the_same_spectra_in_another_path_or_quarter_are_others(spectra):
    one = spectra.select(np.array([0]))
    assert replace(one, antenna=np.array([7])).digest() != one.digest()
    assert replace(one, dipole=np.array(["Y"])).digest() != one.digest()


def test_blocks_hold_every_spectrum_in_its_place(two_stations):
    kept = np.delete(np.arange(len(two_stations)), [0, 9])
    # events in the file in the reverse order of time, and not all antennas in each
    partial = two_stations.select(kept[::-1])
    blocks = split_into_blocks(partial)
    assert [(b.station, b.dipole) for b in blocks] == [(s, d) for s in ("CS002", "CS003") for d in "XY"]
    assert sum(int(b.is_present.sum()) for b in blocks) == kept.size
    for block in blocks:
        assert np.all(np.diff(block.time_unix) > 0)
        assert np.all((block.blocks > 0) == block.is_present)
        for row, antenna in enumerate(block.antennas):
            for column, event in enumerate(block.event_id):
                at = np.flatnonzero(
                    (partial.station == block.station)
                    & (partial.dipole == block.dipole)
                    & (partial.antenna == antenna)
                    & (partial.event_id == event)
                )
                assert block.is_present[row, column] == (at.size == 1)
                expected = partial.power[at[0]] if at.size else np.ones(4)
                np.testing.assert_array_equal(block.power[row, column], expected)
        hours = (block.time_unix - two_stations.time_unix[0]) / 3600
        np.testing.assert_array_equal(block.environment["temperature_c"], 10 + hours)


def test_an_event_that_one_dipole_lacks_altogether_is_not_in_its_block(two_stations):
    lost = (two_stations.event_id == "event 2") & (two_stations.dipole == "X")
    blocks = {block.dipole: block for block in split_into_blocks(two_stations.select(~lost))}
    assert blocks["X"].power.shape[1] == len(blocks["X"].event_id) == 2
    assert blocks["Y"].power.shape[1] == len(blocks["Y"].event_id) == 3


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


def test_files_make_one_set_in_their_order():
    joined = join_spectra([part(range(3)), part(range(3, 5))])
    assert joined.event_id.tolist() == ["E000", "E001", "E002", "E003", "E004"]
    assert joined.power[:, 0].tolist() == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert joined.origin == "0.h5 and 1 more"
    one = part(range(3))
    assert join_spectra([one]) is one


def test_a_spectrum_in_three_files_counts_once():
    joined = join_spectra([part(range(3)), part(range(2, 5)), part(range(4))])
    assert joined.event_id.tolist() == ["E000", "E001", "E002", "E003", "E004"]
    assert joined.digest() == part(range(5)).digest()


def test_two_spectra_of_one_path_in_one_event_that_differ_are_refused():
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
def test_files_of_another_kind_are_refused(changes, message):
    with pytest.raises(BadInputError, match=message):
        join_spectra([part(range(3)), part(range(5, 7), **changes)])


def test_a_covariate_is_unknown_where_a_file_lacks_it():
    warm = part(range(2), environment={"temperature_c": np.array([7.0, 8.0])}, duration_s=np.ones(2))
    joined = join_spectra([warm, part(range(2, 3), duration_s=np.full(1, 2.0))])
    assert joined.environment["temperature_c"].tolist()[:2] == [7.0, 8.0]
    assert np.isnan(joined.environment["temperature_c"][2])
    assert joined.duration_s is not None
    assert joined.duration_s.tolist() == [1.0, 1.0, 2.0]
