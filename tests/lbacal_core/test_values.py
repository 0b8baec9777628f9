import hashlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lbacal_core import errors
from lbacal_core.errors import BadInputError, LbacalError, UnreadableFileError, name_path, write_chance
from lbacal_core.foreign import parse_name, parse_number, parse_numbers, parse_optional_name, read_npz
from lbacal_core.grids import guess_widths, require_channels, require_same_grid
from lbacal_core.instrument.antennas import are_dipole_names, is_dipole_name, look_like_radians
from lbacal_core.provenance import Remembered, canonical_json, hash_arrays, hash_content


@pytest.mark.parametrize("name", ["X", "y", "EW", "arm-2", "Z_up", "45deg"])
def test_an_arm_may_bear_any_short_name(name):
    assert is_dipole_name(name)


@pytest.mark.parametrize("name", ["", "X Y", "?", "a" * 9, "-X", "sky", "antenna", "É"])
def test_what_could_not_be_a_field_of_a_sky_power_file_is_no_name(name):
    assert not is_dipole_name(name)


def test_names_of_an_array_are_told_one_by_one():
    assert are_dipole_names(np.array(["X", "?", "X"])).tolist() == [True, False, True]


@pytest.mark.parametrize(
    "azimuth_deg", [[45.0, 135.0], [225.0, 315.0], [0.0, 90.0], [0.0, 120.0, 240.0], [0.0, 90.0, 0.0]]
)
def test_arms_in_radians_look_like_radians_and_in_degrees_do_not(azimuth_deg):
    """Arms given in radians converged: two nearly parallel dipoles, and C off by a few per cent."""
    assert look_like_radians(np.radians(azimuth_deg).tolist())
    assert not look_like_radians(azimuth_deg)


@pytest.mark.parametrize("azimuth_deg", [[3.9], [0.0, 0.0], [1.0, 362.0]])
def test_one_arm_and_parallel_arms_may_point_near_the_north(azimuth_deg):
    assert not look_like_radians(azimuth_deg)


def test_a_refusal_says_where_what_was_expected_and_what_was_found():
    error = BadInputError("s.h5: power, row 17", "finite power > 0", "nan at 32 MHz")
    assert str(error) == "s.h5: power, row 17: expected finite power > 0, found nan at 32 MHz"
    assert (error.place, error.expected, error.found) == ("s.h5: power, row 17", "finite power > 0", "nan at 32 MHz")


def test_a_message_is_one_line_of_readable_length_whatever_was_found():
    sentence = str(BadInputError("file", "a number", "1\n2 " * 100_000))
    assert "\n" not in sentence
    assert len(sentence) < 200
    assert "\n" not in str(LbacalError("two\nlines"))
    steering = BadInputError("file", "a name", "\x1b[2Jgone\x00")
    assert str(steering) == "file: expected a name, found ?[2Jgone?", "what a file holds never steers the terminal"


def every_error() -> list[type[LbacalError]]:
    return [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, LbacalError)]


def test_every_error_has_a_code_of_its_own():
    codes = [kind.code for kind in every_error()]
    assert len(codes) == len(set(codes)) >= 4


@pytest.mark.parametrize("kind", every_error())
def test_every_error_has_an_http_status_of_a_failure(kind):
    assert 400 <= kind.status < 600


GRID = np.arange(30.0, 81.0)


def test_the_same_grid_passes_with_the_rounding_of_a_file():
    require_same_grid("s.h5", GRID + 4e-7, GRID, "instrument a")


@pytest.mark.parametrize(
    ("frequency", "sentence"),
    [
        (GRID[1:], r"s\.h5: .*: expected the 51 channels of instrument a, found 50 channels, without 30 MHz"),
        (GRID[:40], r"found 40 channels, without 70, 71, .*, 79 MHz and 1 more$"),
        (GRID[1:] + 0.5, r"expected the 51 channels of instrument a, found 50 channels$"),
        (GRID + 0.5 * (GRID > 36.0), r"s\.h5: frequency_mhz, channel 7: expected 37 MHz as in .* a, found 37\.5 MHz"),
        (GRID + 1e-5 * (GRID > 32.0), r"expected 33 MHz as in instrument a, found 33\.00001 MHz"),
        # 51 channels of NaN were stored.
        (np.full(51, np.nan), "channel 0: expected 30 MHz as in instrument a, found nan MHz"),
    ],
)
def test_another_number_of_channels_and_the_first_off_the_grid_are_named(frequency, sentence):
    with pytest.raises(BadInputError, match=sentence):
        require_same_grid("s.h5", frequency, GRID, "instrument a")


@pytest.mark.parametrize(
    ("frequency", "sentence"),
    [
        ([], r"expected a list of channels, found shape \(0,\)"),
        ([[30.0, 31.0]], r"expected a list of channels, found shape \(1, 2\)"),
        ([30.0, np.nan], "channel 1: expected finite MHz > 0, found nan"),
        ([30.0, np.inf], "channel 1: expected finite MHz > 0, found inf"),
        ([-30.0, 31.0], "channel 0: expected finite MHz > 0, found -30"),
        ([30.0, 31.0, 31.0], r"channel 2: expected more than 31 MHz \(channels rise\), found 31 MHz"),
    ],
)
def test_channels_are_finite_positive_and_rising(frequency, sentence):
    with pytest.raises(BadInputError, match=sentence):
        require_channels("a file", np.array(frequency))
    require_channels("a file", GRID)


def test_channels_without_widths_are_as_wide_as_the_nearer_neighbour_is_away(two_stations):
    assert two_stations.channel_widths().tolist() == [1.0] * two_stations.frequency_mhz.size
    np.testing.assert_allclose(guess_widths(np.array([10.0, 10.4, 11.4])), [0.4, 0.4, 1.0])
    assert guess_widths(np.array([78.0])).tolist() == [1.0]


def test_a_path_a_polarisation_a_station_and_the_array_have_one_name_each():
    assert name_path("CS002", 17, "X") == "CS002 antenna 17 X"
    assert [name_path("CS002", None, "X"), name_path("CS002", 0), name_path("CS002"), name_path(None)] == [
        "CS002 X", "CS002 antenna 0", "CS002", "array",
    ]  # fmt: skip


def test_a_chance_below_what_double_precision_holds_was_written_as_zero():
    assert [write_chance(p) for p in (0.0, 1e-310, 2.5e-300, 0.031)] == [
        "p < 1e-300", "p < 1e-300", "p = 2.5e-300", "p = 3.1e-02",
    ]  # fmt: skip


@pytest.mark.parametrize("value", [float("nan"), float("inf"), True, "1", None, 10**400])
def test_what_is_no_finite_number_is_refused_with_its_place(value):
    with pytest.raises(BadInputError, match="here: expected a finite number"):
        parse_number(value, "here")


def test_the_first_entry_that_is_no_number_is_named():
    with pytest.raises(BadInputError, match="gain, entry 1: expected a finite number, found 'a'"):
        parse_numbers([1, "a", None], "gain")
    assert parse_numbers([1, 2.5], "gain").tolist() == [1.0, 2.5]


def test_a_name_is_printable_and_may_be_absent_where_that_is_allowed():
    assert parse_optional_name(None, "here") is None
    for value in ("", "a\nb", 3, None):
        with pytest.raises(BadInputError, match="here: expected a name"):
            parse_name(value, "here")


def test_a_value_is_made_once_and_what_was_asked_for_last_stays_longest():
    made: list[int] = []

    def make(keys: list[int]) -> dict[int, int]:
        made.extend(keys)
        return {key: key**2 for key in keys if key >= 0}

    kept = Remembered[int, int](2)
    assert kept.get_many([3, 1, 3], make) == {3: 9, 1: 1}
    assert kept.get_many([3], make) == {3: 9}
    assert kept.get_many([2, -1], make) == {2: 4}, "what nothing makes is left out"
    assert kept.get_many([3], make) == {3: 9}
    assert made == [3, 1, 2, -1]
    assert kept.get_many([1], make) == {1: 1}
    assert made == [3, 1, 2, -1, 1], "it was asked for longest ago"


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


@pytest.mark.long
@given(content=st.dictionaries(st.text(), JSON, min_size=2, max_size=5))
def test_the_order_of_fields_does_not_change_a_hash(content):
    assert hash_content(dict(reversed(content.items()))) == hash_content(content)


def test_the_hash_of_content_is_that_of_its_canonical_json():
    assert canonical_json({"b": [1, 2.5], "a": "é"}) == '{"a":"é","b":[1,2.5]}'
    assert hash_content({"a": 1}) == hashlib.sha256(b'{"a":1}').hexdigest()
    with pytest.raises(ValueError, match="JSON compliant"):
        hash_content({"a": float("nan")})


def test_arrays_hash_alike_whatever_their_byte_order_and_memory_layout():
    values = np.arange(12.0).reshape(3, 4)
    expected = hash_arrays(values)
    assert hash_arrays(values.astype(">f8")) == expected
    assert hash_arrays(np.asfortranarray(values)) == expected
    assert hash_arrays(np.array(["a", "bc"])) == hash_arrays(np.array(["a", "bc"], dtype="U20"))


def test_arrays_that_differ_in_value_shape_type_or_division_hash_differently():
    values = np.arange(12.0)
    others = [
        (np.nextafter(values, 99),),
        (values.reshape(3, 4),),
        (values.astype("f4"),),
        (values[:6], values[6:]),
        (np.array(["a", "b"]),),
        (np.array(["ab"]),),
        (np.array(["a"]), np.array(["b"])),
    ]
    hashes = {hash_arrays(values), *(hash_arrays(*arrays) for arrays in others)}
    assert len(hashes) == len(others) + 1


@pytest.fixture
def path(tmp_path: Path) -> Path:
    np.savez_compressed(tmp_path / "a.npz", a=np.arange(200.0), b=np.ones(3))
    return tmp_path / "a.npz"


def test_missing_arrays_a_single_array_and_pickled_objects_are_refused(path, tmp_path):
    with pytest.raises(BadInputError, match=r"a\.npz: expected the arrays a, c, d, found no c, d"):
        read_npz(path, ("a", "c", "d"), "numbers")
    np.save(tmp_path / "a.npy", np.ones(3))
    with pytest.raises(BadInputError, match="found no a"):
        read_npz(tmp_path / "a.npy", ("a",), "numbers")
    np.savez(tmp_path / "a.npz", a=np.array([{}], dtype=object))
    with pytest.raises(UnreadableFileError, match="file of numbers, found a broken one"):
        read_npz(tmp_path / "a.npz", ("a",), "numbers")


def test_every_truncation_is_a_sentence(path):
    content = path.read_bytes()
    for length in range(0, len(content), 7):
        path.write_bytes(content[:length])
        with pytest.raises(UnreadableFileError, match="expected a NumPy"):
            read_npz(path, ("a",), "numbers")


def test_changed_bytes_give_a_sentence_or_arrays(path):
    content = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    rng = np.random.default_rng(1)
    refused = 0
    for _ in range(300):
        mutant = content.copy()
        mutant[rng.integers(0, mutant.size, 2)] = rng.integers(0, 256, 2)
        path.write_bytes(mutant.tobytes())
        try:
            read_npz(path, ("a",), "numbers")
        except (BadInputError, UnreadableFileError):
            refused += 1
    assert 100 < refused < 300
