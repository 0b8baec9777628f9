from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lbacal_core.errors import BadInputError, LbacalError, UnreadableFileError
from lbacal_core.hdf5 import FLOATS, INTEGERS, NUMBERS, STRINGS, is_in_file, open_dataset, read_values
from lbacal_core.spectra.spectra import Spectra, join_spectra, read_columns, read_spectra, write_spectra

NOW = 1_500_000_000.0


@pytest.fixture
def path(two_stations: Spectra, tmp_path: Path) -> Path:
    write_spectra(two_stations, tmp_path / "s.h5")
    return tmp_path / "s.h5"


def refusal(path: Path) -> str:
    """The one sentence with which the reader refuses a file."""
    with pytest.raises(LbacalError) as caught:
        read_spectra(path, NOW)
    sentence = str(caught.value)
    assert "\n" not in sentence
    assert len(sentence) < 400
    assert sentence.isprintable()
    return sentence


def put(name: str, data: object, **storage: object) -> Callable[[h5py.File], None]:
    """Replace a dataset."""

    def change(file: h5py.File) -> None:
        if name in file:
            del file[name]
        file.create_dataset(name, data=data, **storage)

    return change


def put_value(name: str, row: int, value: object) -> Callable[[h5py.File], None]:
    """Replace one row, or one channel of it."""

    def change(file: h5py.File) -> None:
        values = file[name][()]
        values[row] = value
        put(name, values)(file)

    return change


def put_power(row: int, channel: int, value: float) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        file["power"][row, channel] = value

    return change


def remove(name: str) -> Callable[[h5py.File], None]:
    return lambda file: file.__delitem__(name)


def attribute(name: str, value: object) -> Callable[[h5py.File], None]:
    return lambda file: file.attrs.__setitem__(name, value)


def put_unwritten(name: str, shape: tuple[int, ...]) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        del file[name]
        file.create_dataset(name, shape=shape, dtype="f8", chunks=True)

    return change


def as_virtual(file: h5py.File) -> None:
    layout = h5py.VirtualLayout(shape=(24,), dtype="f8")
    layout[:] = h5py.VirtualSource("other.h5", "time_unix", shape=(24,))
    del file["time_unix"]
    file.create_virtual_dataset("time_unix", layout)


ROWS = 24
WRONG_CONTENT: dict[str, tuple[Callable[[h5py.File], None], str]] = {
    # the format itself
    "no format": (lambda file: file.attrs.__delitem__("format"), "attribute format: expected lbacal-spectra-1, found"),
    "format is a number": (attribute("format", 1), "attribute format: expected lbacal-spectra-1"),
    "format not UTF-8": (attribute("format", np.bytes_(b"\xff\xfe")), "attribute format: expected UTF-8"),
    "missing column": (remove("blocks"), "no blocks"),
    "unknown dataset": (put("powers", np.ones(3)), "unknown powers"),
    # lengths and shapes
    "short column": (put("antenna", np.zeros(23, dtype=int)), "antenna: expected 24 rows as in event_id, found"),
    "narrow power": (put("power", np.ones((24, 3))), r"4 channels as in frequency_mhz, found shape \(24, 3\)"),
    "0-d events": (put("event_id", "one"), "event_id: expected one dimension"),
    "null data": (put("time_unix", h5py.Empty("f8")), "time_unix: expected 24 rows as in event_id, found shape None"),
    "short env": (put("env/temperature_c", np.ones(3)), "env/temperature_c: expected 24 rows"),
    # types
    "antenna as float": (put("antenna", np.zeros(24)), "antenna: expected integers, found float64"),
    "integer time": (put("time_unix", np.full(24, 1_400_000_000)), "time_unix: expected 8-byte floats, found int64"),
    "time as float32": (put("time_unix", np.full(24, 1.4e9, "f4")), "time_unix: expected 8-byte floats, found float32"),
    "power as text": (put("power", np.full((24, 4), b"1.0")), "power: expected floats of 4 or 8 bytes"),
    "station as number": (put("station", np.full(24, 2)), "station: expected strings, found int64"),
    "lists as dipole": (
        put("dipole", np.array([np.ones(2)] * 24 + [None], dtype=object)[:24], dtype=h5py.vlen_dtype(float)),
        "dipole: expected strings",
    ),
    "antenna beyond 63 bits": (
        put("antenna", np.full(24, 2**64 - 1, dtype=np.uint64)),
        r"antenna: expected integers below 2\*\*63, found 18446744073709551615",
    ),
    "a group as column": (lambda file: [file.__delitem__("blocks"), file.create_group("blocks")], "found a group"),
    "env is a dataset": (
        lambda file: [file.__delitem__("env"), put("env", np.ones(24))(file)],
        "env: expected a group",
    ),
    "a group in env": (lambda file: file.create_group("env/more"), "env/more: expected a dataset, found a group"),
    # values
    "NaN": (put_power(5, 2, np.nan), "power, row 5: expected finite power > 0, found nan at 32 MHz"),
    "negative power": (put_power(1, 1, -2.5), "power, row 1: expected finite power > 0, found -2.5 at 31 MHz"),
    "before 2009": (put_value("time_unix", 3, 1.2e9), "time_unix, row 3: expected an instant of 2009 or later"),
    "NaN time": (put_value("time_unix", 2, np.nan), "time_unix, row 2: .*found nan"),
    "future": (
        put_value("time_unix", 9, NOW + 86_401),
        r"an instant not after 2017-07-15T02:40:00Z, a day ahead of now, found 2017-07-15T02:40:01Z \(1500086401.0 s",
    ),
    "no dipole's letter": (put_value("dipole", 4, b"?"), r"dipole, row 4: expected a letter .*, found '\?'"),
    "negative antenna": (put_value("antenna", 6, -1), "antenna, row 6: expected a number >= 0, found -1"),
    "no blocks averaged": (put_value("blocks", 6, 0), "blocks, row 6: expected a count > 0, found 0"),
    "empty station": (put_value("station", 8, b""), "station, row 8: expected a name, found ''"),
    "event not UTF-8": (put_value("event_id", 3, b"caf\xe9"), r"event_id, row 3: expected UTF-8 text, found b'caf"),
    "event of two lines": (
        put_value("event_id", 3, b"a\nb"),
        r"event_id, row 3: expected printable text, found 'a\\nb'",
    ),
    "the same key twice": (put("event_id", [b"one"] * 24), "row .*: expected one spectrum per event, station, antenna"),
    "infinite temperature": (put_value("env/temperature_c", 2, np.inf), "env/temperature_c, row 2: .*found inf"),
    "a temperature in Kelvin": (
        put("env/temperature_c", np.full(24, 283.15)),
        "env/temperature_c: expected -90 to 60 .*NaN.* from Kelvin subtract 273.15.* found 283.15 in ",
    ),
    "rain of a missing value": (
        put_value("env/rain_mm_h", 2, -999.0),
        r"rain_mm_h: expected 0 to 2300 .*found -999 in ",
    ),
    "falling frequency": (
        put("frequency_mhz", np.array([33.0, 32.0, 31.0, 30.0])),
        "channel 1: expected more than 33 MHz .* found 32 MHz",
    ),
    # R_r
    "unequal resistances": (attribute("resistance_ohm", [50.0, 60.0]), "attribute resistance_ohm: expected one number"),
    "negative resistance": (attribute("resistance_ohm", -50.0), "resistance_ohm: expected Ohm > 0, found -50"),
    "arm that is text": (attribute("azimuth_deg_X", "east"), "attribute azimuth_deg_X: expected a number of degrees"),
    # what would make the library read elsewhere, or never end
    "external link": (
        lambda file: [file.__delitem__("power"), file.__setitem__("power", h5py.ExternalLink("other.h5", "/power"))],
        "power: expected a dataset in this file, found a link",
    ),
    "link in env": (
        lambda file: file.__setitem__("env/wind", h5py.ExternalLink("other.h5", "/wind")),
        "env/wind: expected a dataset in this file, found a link",
    ),
    "env is the root": (
        lambda file: [file.__delitem__("env"), file.__setitem__("env", file["/"])],
        "env/env: expected a dataset, found a group|expected numbers",
    ),
    "external storage": (
        lambda file: [
            file.__delitem__("time_unix"),
            file.create_dataset("time_unix", shape=(24,), dtype="f8", external=[("/etc/passwd", 0, 192)]),
        ],
        "time_unix: expected a dataset stored in this file",
    ),
    "virtual dataset": (as_virtual, "time_unix: expected a dataset stored in this file"),
    "checksum filter": (
        put("blocks", np.ones(24, int), fletcher32=True),
        "blocks: expected no filter, gzip or shuffle",
    ),
    "huge power": (put_unwritten("power", (24, 10**12)), r"power: .*found shape \(24, 1000000000000\)"),
    "never written": (put_unwritten("power", (24, 4)), "power: expected 96 values, found 0 bytes"),
    "hugely never written": (
        lambda file: [put_unwritten("frequency_mhz", (10**9,))(file), put_unwritten("power", (24, 10**9))(file)],
        "(frequency_mhz|power): expected .* values, found 0 bytes, too few to hold them",
    ),
}


@pytest.mark.parametrize("case", WRONG_CONTENT)
def test_wrong_content_is_named_with_field_and_row(path, case):
    change, sentence = WRONG_CONTENT[case]
    with h5py.File(path, "a") as file:
        change(file)
    with pytest.raises(BadInputError, match=sentence):
        read_spectra(path, NOW)
    assert refusal(path).startswith("s.h5")


def test_a_missing_empty_or_other_file_is_named(tmp_path):
    assert refusal(tmp_path / "none.h5").endswith("none.h5: expected a spectra file, found no file")
    assert refusal(tmp_path).endswith("expected a spectra file, found a folder")
    empty = tmp_path / "empty.h5"
    empty.write_bytes(b"")
    assert "found an empty file" in refusal(empty)
    text = tmp_path / "text.h5"
    text.write_text("frequency_mhz,power\n30,1\n")
    assert "expected a spectra file (HDF5), found something unreadable" in refusal(text)


def test_every_truncation_is_a_sentence(path):
    content = path.read_bytes()
    cut = path.with_name("cut.h5")
    for length in [*range(1, 64), *range(64, len(content), 331), len(content) - 1]:
        cut.write_bytes(content[:length])
        refusal(cut)


@given(content=st.binary(max_size=4096))
@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_random_bytes_are_a_sentence(tmp_path, content):
    (tmp_path / "random.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + content)
    with pytest.raises(UnreadableFileError):
        read_spectra(tmp_path / "random.h5")


@pytest.mark.long
@pytest.mark.parametrize("storage", ["contiguous", "gzip"])
def test_flipped_bytes_give_a_sentence_or_numbers_unless_the_hdf5_library_itself_dies(path, storage, flip_bytes):
    if storage == "gzip":
        with h5py.File(path, "a") as file:
            put("power", file["power"][()], compression="gzip", shuffle=True)(file)
    imports = "from lbacal_core.spectra.spectra import read_spectra"
    outcomes = flip_bytes(path.read_bytes(), 120, imports, "read_spectra(Path(name), 1.5e9)")
    assert set(outcomes) <= {"read", "sentence", "died"}
    # A file changed in its structure is refused, one changed in its numbers may be read; both must occur.
    assert {"read", "sentence"} <= set(outcomes)
    assert outcomes.count("died") < 12  # 1 % of 2000 in a longer run


def test_a_file_returns_what_was_written(two_stations, path):
    read = read_spectra(path)
    assert read.digest() == two_stations.digest()
    for name in ("power", "time_unix", "station", "antenna", "dipole", "blocks", "event_id"):
        np.testing.assert_array_equal(getattr(read, name), getattr(two_stations, name))
    np.testing.assert_array_equal(read.environment["rain_mm_h"], two_stations.environment["rain_mm_h"])
    assert read.resistance_ohm == 50.0
    assert len(read) == ROWS


@pytest.mark.parametrize("change", ["fixed strings", "big endian", "gzip", "int32", "no env", "no resistance"])
def test_storage_that_changes_no_value_is_welcome(path, change):
    before = read_spectra(path).digest()
    with h5py.File(path, "a") as file:
        if change == "fixed strings":
            for name in ("station", "event_id", "dipole"):
                put(name, file[name][()].astype("S12"))(file)
        if change == "big endian":
            put("power", file["power"][()].astype(">f8"))(file)
        if change == "gzip":
            for name in ("power", "station"):
                put(name, file[name][()], compression="gzip", shuffle=True)(file)
        if change == "int32":
            put("antenna", file["antenna"][()].astype("i4"))(file)
            put("frequency_mhz", file["frequency_mhz"][()].astype("i4"))(file)
        if change == "no env":
            del file["env"]
        if change == "no resistance":
            del file.attrs["resistance_ohm"]
    assert read_spectra(path).digest() == before


def test_a_highly_compressible_file_is_not_taken_for_an_unwritten_one(two_stations, tmp_path):
    rows = 20_000
    many = Spectra(
        two_stations.frequency_mhz,
        np.ones((rows, 4)),
        np.array([f"e{k}" for k in range(rows)]),
        two_stations.time_unix[0] + np.arange(rows),
        np.full(rows, "CS002"),
        np.zeros(rows, dtype=np.int64),
        np.full(rows, "X"),
        np.ones(rows, dtype=np.int64),
    )
    write_spectra(many, tmp_path / "s.h5")
    with h5py.File(tmp_path / "s.h5", "a") as file:
        put("power", many.power, compression="gzip", compression_opts=9, chunks=(rows, 4))(file)
    assert read_spectra(tmp_path / "s.h5").digest() == many.digest() != two_stations.digest()


def test_a_spectrum_under_the_names_of_two_events_is_refused_and_one_of_the_same_instant_is_not(two_stations):
    twice = np.append(np.arange(ROWS), 5)
    names = "time_unix", "station", "antenna", "dipole", "blocks", "power"
    own = {name: getattr(two_stations, name)[twice] for name in names} | {"environment": {}}
    own["event_id"] = np.append(two_stations.event_id, "processed again")
    with pytest.raises(BadInputError, match=r"row 24: expected each spectrum once, found event 0, .* processed again"):
        replace(two_stations, **own)
    own["power"] = np.append(own["power"][:-1], 1.01 * own["power"][-1:], axis=0)
    assert len(replace(two_stations, **own)) == ROWS + 1


def test_a_time_within_the_next_day_is_welcome(two_stations, path):
    last = two_stations.time_unix[16]
    assert len(read_spectra(path, now_unix=last - 86_400)) == ROWS
    with pytest.raises(BadInputError, match="row 16"):
        read_spectra(path, now_unix=last - 86_401)


def test_the_digest_sees_the_last_bit_of_a_power_and_a_millisecond_but_not_the_order_of_rows(two_stations):
    shuffled = two_stations.select(np.random.default_rng(2).permutation(ROWS))
    assert shuffled.digest() == two_stations.digest()
    power = two_stations.power.copy()
    power[3, 1] = np.nextafter(power[3, 1], 2)
    for change in ({"power": power}, {"time_unix": two_stations.time_unix + 1e-3}):
        assert replace(two_stations, **change).digest() != two_stations.digest()


@pytest.mark.shared
def test_the_example_data_set_is_readable(shared):
    spectra = read_spectra(shared / "examples" / "spectra.h5", NOW)
    assert len(np.unique(spectra.event_id)) == 400
    assert spectra.frequency_mhz.size == 51


def test_widths_and_durations_survive_the_file_and_a_selection(two_stations, tmp_path):
    rows, channels = len(two_stations), two_stations.frequency_mhz.size
    given = replace(two_stations, width_mhz=np.full(channels, 0.2), duration_s=np.arange(1.0, rows + 1))
    write_spectra(given, tmp_path / "s.h5")
    read = read_spectra(tmp_path / "s.h5").select(np.array([3, 1]))
    assert read.duration_s is not None
    assert read.duration_s.tolist() == [4.0, 2.0]
    assert read.channel_widths().tolist() == [0.2] * channels
    assert given.digest() != two_stations.digest()


def test_arms_survive_the_file_and_a_join_and_files_that_disagree_are_refused(two_stations, tmp_path):
    write_spectra(replace(two_stations, arms_deg={"X": 44.5}), tmp_path / "s.h5")
    read = read_spectra(tmp_path / "s.h5")
    early, late = (read.select(read.time_unix < limit) for limit in (read.time_unix.mean(), np.inf))
    assert join_spectra([early, late]).arms_deg == {"X": 44.5}
    with pytest.raises(BadInputError, match=r"arm of X: expected 44\.5 deg as in s\.h5, found 90 deg"):
        join_spectra([early, replace(late, arms_deg={"X": 90.0})])


@pytest.mark.parametrize(("name", "values"), [("width_mhz", [0.0]), ("duration_s", [np.nan]), ("width_mhz", [])])
def test_widths_and_durations_that_are_none_are_refused(two_stations, name, values):
    with pytest.raises(BadInputError, match=name):
        replace(two_stations, **{name: np.array(values)})


def test_widths_of_a_thousand_mhz_at_channels_of_one_were_taken(two_stations):
    channels = two_stations.frequency_mhz.size
    replace(two_stations, width_mhz=np.full(channels, 4.0))
    with pytest.raises(BadInputError, match=r"width_mhz: expected at most 10 spacings of channels, 10 MHz, found 1000"):
        replace(two_stations, width_mhz=np.full(channels, 1e3))


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        (STRINGS, ["CS002", "CS003", "CS002", "e\u0301t\u00e9"]),
        (INTEGERS, np.array([3, 1, 2], dtype=">i2")),
        (NUMBERS, np.array([3, 1, 2], dtype="u1")),
        (FLOATS, np.array([0.1, np.nan, np.inf])),
    ],
)
def test_values_are_read_as_their_kind_says(tmp_path, kind, values):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["a"] = values
        read = read_values(open_dataset(file, "a", kind, "a"), kind, "a")
    np.testing.assert_array_equal(read, np.asarray(values))
    assert np.issubdtype(read.dtype, kind.read_as)


def test_the_first_row_of_a_text_that_is_none_is_named(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["a"] = np.array([b"good", b"\xff", b"good", b"\xff"])
        with pytest.raises(BadInputError, match="a, row 1: expected UTF-8 text"):
            read_values(open_dataset(file, "a", STRINGS, "a"), STRINGS, "a")


def test_a_link_is_seen_without_being_followed(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["here"] = 1.0
        file["elsewhere"] = h5py.ExternalLink("none.h5", "/a")
        file["nowhere"] = h5py.SoftLink("/none")
        assert [is_in_file(file, name) for name in ("here", "elsewhere", "nowhere")] == [True, False, False]


def test_powers_of_four_bytes_are_read_as_the_numbers_that_they_are(two_stations, tmp_path):
    write_spectra(two_stations, tmp_path / "s.h5")
    with h5py.File(tmp_path / "s.h5", "a") as file:
        del file["power"]
        file["power"] = two_stations.power.astype("f4")
    assert np.array_equal(read_spectra(tmp_path / "s.h5").power, two_stations.power.astype("f4").astype("f8"))


def test_flagged_spectra_stay_in_the_file_and_are_left_out_when_read(two_stations, tmp_path):
    rows = len(two_stations)
    flag = np.full(rows, "", dtype="U5")
    flag[[2, 5]] = "storm"
    power = np.where((flag != "")[:, None], np.nan, two_stations.power)
    write_spectra(replace(two_stations, flag=flag, power=power), tmp_path / "s.h5")
    with h5py.File(tmp_path / "s.h5") as file:
        assert len(file["power"]) == rows
    read = read_spectra(tmp_path / "s.h5")
    assert (read.left_out, read.flag) == ({"storm": 2}, None)
    assert read.digest() == two_stations.select(flag == "").digest()
    with pytest.raises(BadInputError, match=r"flag, row 2: expected no flagged spectra"):
        read_columns((tmp_path / "s.h5").read_bytes(), "body", 1 << 30)
    write_spectra(replace(two_stations, flag=np.full(rows, "storm")), tmp_path / "s.h5")
    with pytest.raises(BadInputError, match=f"flag: expected a spectrum that is not flagged, found all {rows} are"):
        read_spectra(tmp_path / "s.h5")
