import json
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

import pytest

from lbacal_core.errors import BadInputError, LbacalError, UnknownNameError, UnreadableFileError
from lbacal_core.instrument.antennas import AntennaRecord
from lbacal_core.instrument.instrument import load_instrument, parse_instrument


def make_content() -> dict[str, Any]:
    """The smallest instrument with a hardware change."""
    return {
        "name": "two antennas",
        "latitude_deg": 52.9,
        "longitude_deg": 6.9,
        "height_m": 49,
        "frequency_mhz": [30, 50, 80],
        "dipoles": {"X": {"azimuth_deg": 45}, "Y": {"azimuth_deg": 135}},
        "antenna_gain": [0.1, 0.5, 0.2],
        "receiver_gain": [1, 1, 0.3],
        "cables": {"50 m": [0.6, 0.5, 0.4], "80 m": [0.4, 0.3, 0.2]},
        "antennas": [
            {"station": "CS002", "antenna": 0, "cable": "50 m", "until": "2013-05-01"},
            {"station": "CS002", "antenna": 0, "cable": "80 m", "since": "2013-05-01T00:00:00Z"},
            {"station": "CS002", "antenna": 1, "cable": "80 m"},
        ],
    }


def unix(text: str) -> float:
    return datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()


def put(*place_and_value: Any) -> Callable[[dict[str, Any]], None]:
    """Set the value at the end of a path of fields and rows."""

    def change(content: Any) -> None:
        *path, last, value = place_and_value
        for step in path:
            content = content[step]
        content[last] = value

    return change


def remove(field: str) -> Callable[[dict[str, Any]], None]:
    return lambda content: content.pop(field)


def append(record: dict[str, Any]) -> Callable[[dict[str, Any]], None]:
    return lambda content: content["antennas"].append(record)


WRONG_CONTENT: dict[str, tuple[Callable[[dict[str, Any]], None], str]] = {
    "missing field": (remove("receiver_gain"), "expected the fields name, .* found no receiver_gain"),
    "name of spaces": (put("name", ""), "name: expected a name, found ''"),
    "latitude NaN": (put("latitude_deg", float("nan")), "latitude_deg: expected a finite number, found nan"),
    "latitude too far": (put("latitude_deg", 99), "latitude_deg: expected -90 to 90, found 99"),
    "channels in kHz": (put("frequency_mhz", [30e3, 50e3, 80e3]), "expected MHz, found 80000, which looks like kHz"),
    "azimuth beyond a turn": (put("dipoles", "X", {"azimuth_deg": 4500}), "X.azimuth_deg: expected -360 to 360"),
    "parallel arms": (
        put("dipoles", "X", {"azimuth_deg": 315}),
        "dipoles: expected arms that differ, found X and Y, which are parallel",
    ),
    "no antennas": (put("antennas", []), "antennas: expected one or more, found none"),
    "falling channels": (put("frequency_mhz", [80, 50, 30]), "channel 1: expected more than 80 MHz"),
    "no dipoles": (put("dipoles", {}), "dipoles: expected one dipole or more, found none"),
    "dipole named sky": (put("dipoles", "sky", {"azimuth_deg": 0}), "dipoles: expected a letter or name of up to 8"),
    "arm beyond upright": (put("dipoles", "X", {"azimuth_deg": 0, "tilt_deg": 91}), "X.tilt_deg: expected -90 to 90"),
    "dipoles as list": (put("dipoles", [45, 135]), "dipoles: expected an object of azimuth_deg by letter, found list"),
    "azimuth as number": (put("dipoles", "X", 45), "dipoles.X.azimuth_deg: expected a finite number"),
    "arms in radians": (
        put("dipoles", {"X": {"azimuth_deg": 0.785}, "Y": {"azimuth_deg": 2.36}}),
        r"expected degrees \(360 less .*, found X 0.785, Y 2.36, which look like radians",
    ),
    "short gain": (put("antenna_gain", [1, 1]), r"antenna_gain: expected 3 numbers, one a channel, found shape \(2,\)"),
    "gain zero": (
        put("receiver_gain", 2, 0),
        r"receiver_gain, channel 2: expected a finite power factor > 0, found 0\.0$",
    ),
    "gain in dB": (
        put("antenna_gain", 1, -3.0),
        r"antenna_gain, channel 1: expected a finite power factor > 0, found -3\.0$",
    ),
    "gain infinite": (put("antenna_gain", 1, float("inf")), "antenna_gain, entry 1: expected a finite number, found"),
    "amplifying cable": (put("cables", "50 m", 0, 1.2), "cables.50 m, channel 0: .* > 0 and <= 1, found"),
    "no cables": (put("cables", {}), "antennas, row 0: cable: expected one of"),
    "unknown cable": (put("antennas", 2, "cable", "90 m"), "row 2: cable: expected one of 50 m, 80 m, found '90 m'"),
    "antenna negative": (put("antennas", 2, "antenna", -1), "row 2: antenna: expected a whole number >= 0, found -1"),
    "no station": (lambda c: c["antennas"][1].pop("station"), "antennas, row 1: expected station, antenna and cable"),
    "record as list": (put("antennas", 0, ["CS002", 0]), "antennas, row 0: expected station, antenna and cable"),
    "since in words": (
        put("antennas", 1, "since", "May"),
        "row 1: since: expected an ISO 8601 date or instant, found 'May'",
    ),
    "since before time": (put("antennas", 1, "since", "0001-01-01T00:00+14:00"), "row 1: since: expected an ISO 8601"),
    "until before since": (put("antennas", 1, "until", "2012-01-01"), "antennas, row 1: until: expected a date after"),
    "misspelt since": (
        lambda c: c["antennas"][1].__setitem__("sinse", c["antennas"][1].pop("since")),
        "antennas, row 1: since: expected the field 'since' or none, found 'sinse'",
    ),
    "misspelt antenna": (put("antena", "hamaker"), "antenna: expected the field 'antenna' or none, found 'antena'"),
    "misspelt tilt": (
        put("dipoles", "X", {"azimuth_deg": 45, "tild_deg": 10}),
        "dipoles.X: tilt_deg: expected the field 'tilt_deg' or none, found 'tild_deg'",
    ),
    "misspelt shape error": (
        put("antenna_gain_provenance", {"kind": "relative", "source": "x", "shape_eror": 0.1}),
        "antenna_gain_provenance: shape_error: expected the field 'shape_error' or none, found 'shape_eror'",
    ),
    "the same antenna twice": (
        append({"station": "CS002", "antenna": 1, "cable": "50 m"}),
        "antennas, rows 2 and 3: expected one record at a time for station CS002, antenna 1, found two",
    ),
    "overlap of a day": (
        put("antennas", 1, "since", "2013-04-30"),
        "antennas, rows 0 and 1: expected one record at a time for station CS002, antenna 0",
    ),
}


@pytest.mark.parametrize("case", WRONG_CONTENT)
def test_wrong_content_is_named_with_field_and_row(tmp_path, case):
    change, sentence = WRONG_CONTENT[case]
    content = make_content()
    change(content)
    path = tmp_path / "i.json"
    path.write_text(json.dumps(content))
    with pytest.raises(BadInputError, match=sentence) as caught:
        load_instrument(str(path))
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith((str(path), "instrument two antennas"))


@pytest.mark.parametrize("content", [[], 3, "text", None])
def test_json_of_another_kind_is_refused(content):
    with pytest.raises(BadInputError, match=r"i\.json: expected a JSON object, found"):
        parse_instrument(content, "i.json")


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"", "an empty file"),
        (b" \n", "an empty file"),
        (b"{", "something else"),
        (b"\xff\xfe\x00", "something else"),
        (b"\x89HDF\r\n", "something else"),
        (b"[" * 200_000, "something else"),
        (b"9" * 5000, "something else"),
        (b'{"name": "a", "name": "b"}', "the field 'name' twice in one object"),
    ],
)
def test_a_file_that_is_not_json_is_one_sentence(tmp_path, content, found):
    path = tmp_path / "i.json"
    path.write_bytes(content)
    with pytest.raises(UnreadableFileError, match=found) as caught:
        load_instrument(str(path))
    assert str(caught.value).startswith(f"{path}: expected JSON")
    assert "\n" not in str(caught.value)


def test_a_folder_is_named_as_such(tmp_path):
    with pytest.raises(UnreadableFileError, match=r"cannot be read \(Is a directory\)"):
        load_instrument(str(tmp_path))


def test_a_name_that_nothing_answers_to_is_answered_with_the_names_that_exist():
    told = r"unknown instrument 'lofar', and no such file; is lofar-superterp meant\? known: .*or the path of a file"
    with pytest.raises(UnknownNameError, match=told):
        load_instrument("lofar")


def test_every_truncation_is_a_sentence(tmp_path):
    text = json.dumps(make_content())
    path = tmp_path / "i.json"
    for length in range(len(text)):
        path.write_text(text[:length])
        with pytest.raises(LbacalError):
            load_instrument(str(path))


def test_an_instrument_returns_as_the_file_it_came_from():
    instrument = parse_instrument(make_content(), "i.json")
    again = parse_instrument(json.loads(json.dumps(instrument.as_dict())), "i.json")
    assert again.digest() == instrument.digest()
    assert again.as_dict() == instrument.as_dict()


@pytest.mark.parametrize("longitude", [-173.1, 186.9])
def test_a_longitude_may_be_counted_to_either_side(longitude):
    assert parse_instrument(make_content() | {"longitude_deg": longitude}, "i.json").longitude_deg == longitude


def test_fields_of_others_are_left_alone_and_not_part_of_the_digest():
    content = make_content()
    content["remark"] = {"anything": [1, 2]}
    content["antennas"][0]["x_m"] = 12.5
    assert parse_instrument(content, "i.json").digest() == parse_instrument(make_content(), "i.json").digest()


def test_a_cable_of_another_antenna_or_another_year_renamed_every_calibration():
    """The digest of a fit holds what the fit uses: its antennas' records while they last, and their cables."""
    content = make_content()
    old, begin, change = parse_instrument(content, "i.json"), unix("2013-01-01"), unix("2013-05-01")
    content["antennas"][2]["cable"] = "50 m"
    other_antenna = parse_instrument(content, "i.json")
    assert other_antenna.digest_of(begin, 2e9, "CS002", 0) == old.digest_of(begin, 2e9, "CS002", 0)
    assert other_antenna.digest_of(begin, 2e9, "CS002", 1) != old.digest_of(begin, 2e9, "CS002", 1)
    assert other_antenna.digest_of(begin, 2e9, "CS002") != old.digest_of(begin, 2e9, "CS002")
    content = make_content()
    content["antennas"][1]["until"] = "2020-01-01"
    ended = parse_instrument(content, "i.json")
    assert ended.digest_of(begin, unix("2020-01-01")) == old.digest_of(begin, unix("2020-01-01"))
    assert ended.digest_of(begin, unix("2020-01-02")) != old.digest_of(begin, unix("2020-01-02"))
    assert old.digest_of(begin, change, "CS002", 0) != old.digest_of(change, unix("2014-01-01"), "CS002", 0)
    content = make_content()
    content["receiver_gain"][0] *= 2.0
    assert parse_instrument(content, "i.json").digest_of(begin, 2e9) != old.digest_of(begin, 2e9)


def test_the_cable_changes_at_the_instant_of_the_record():
    instrument = parse_instrument(make_content(), "i.json")
    change = unix("2013-05-01")
    assert instrument.cable_of("CS002", 0, change - 1e-6) == "50 m"
    assert instrument.cable_of("CS002", 0, change) == "80 m"
    assert instrument.cables_between("CS002", 0, change - 10, change - 1) == ["50 m"]
    assert instrument.cables_between("CS002", 0, change - 10, change) == ["50 m", "80 m"]
    assert instrument.cables_between("CS002", 1, 0.0, 2e9) == ["80 m"]


def test_an_antenna_or_a_date_without_a_record_is_named():
    content = make_content()
    content["antennas"][1]["until"] = "2014-01-01"
    instrument = parse_instrument(content, "i.json")
    with pytest.raises(BadInputError, match="station CS002, antenna 9: expected an antenna of instrument two antennas"):
        instrument.cable_of("CS002", 9, unix("2013-01-01"))
    # Data of station HERA and an instrument whose antennas stand at S1: "no such antenna" did not help.
    with pytest.raises(BadInputError, match=r"\(antennas 0 to \d+ of it\), found station CS002, antenna 999"):
        instrument.cable_of("CS002", 999, 1.4e9)
    with pytest.raises(BadInputError, match=r"\(stations CS002\), found station 'HERA', antenna 36"):
        instrument.cable_of("HERA", 36, 1.4e9)
    with pytest.raises(BadInputError, match=r"CS002, antenna 0: expected a cable on record .* at 2014-01-01, found"):
        instrument.cable_of("CS002", 0, unix("2014-01-01"))


def test_a_group_is_kept_and_changes_with_the_record():
    content = make_content()
    content["antennas"][0]["group"], content["antennas"][1]["group"] = "board 1", "board 2"
    instrument = parse_instrument(content, "i.json")
    change = unix("2013-05-01")
    assert instrument.group_between("CS002", 0, change - 10, change - 1) == "board 1"
    assert instrument.group_between("CS002", 0, change, change + 1) == "board 2"
    assert instrument.group_between("CS002", 0, change - 10, change + 1) is None
    assert instrument.group_between("CS002", 1, 0.0, 2e9) is None
    assert instrument.as_dict()["antennas"][0]["group"] == "board 1"
    assert instrument.digest() != parse_instrument(make_content(), "i.json").digest()
    content["antennas"][2]["grup"] = "board 3"
    with pytest.raises(BadInputError, match="the field 'group' or none"):
        parse_instrument(content, "i.json")


def test_a_name_longer_than_any_files_was_an_error_of_the_system(tmp_path):
    (tmp_path / "i.json").write_text(json.dumps(make_content() | {"antenna": "a" * 300}))
    assert load_instrument(str(tmp_path / "i.json")).antenna == "a" * 300
    with pytest.raises(UnknownNameError):
        load_instrument("b" * 5000)


def test_an_antenna_file_is_found_beside_the_instrument_file(tmp_path):
    (tmp_path / "lba.npz").touch()
    (tmp_path / "i.json").write_text(json.dumps(make_content() | {"antenna": "lba.npz", "sky": "gsm"}))
    instrument = load_instrument(str(tmp_path / "i.json"))
    assert (instrument.antenna, instrument.sky) == (str(tmp_path / "lba.npz"), "gsm")


def test_the_superterp_says_that_its_antenna_gain_is_made_from_the_published_c():
    gain = load_instrument("lofar-superterp").gain_provenance
    assert gain.kind == "relative"
    assert "published C" in gain.source
    assert gain.scale_error == pytest.approx(0.39)


PROVENANCE = {"kind": "absolute", "source": "NEC", "shape_error": [0.1, 0.02, 0.2], "scale_error": 0.05}


def test_an_instrument_says_what_its_antenna_gain_is():
    content = make_content() | {"antenna": "hamaker", "sky": "gsm", "antenna_gain_provenance": PROVENANCE}
    instrument = parse_instrument(content, "i.json")
    assert (instrument.antenna, instrument.sky) == ("hamaker", "gsm")
    assert instrument.antenna_gain_note == (
        "absolute: NEC; error of ln G_ant 20 % (shape, at most), 5 % (common factor)"
    )
    assert parse_instrument(json.loads(json.dumps(instrument.as_dict())), "i.json").as_dict() == instrument.as_dict()
    assert instrument.digest() == parse_instrument(make_content(), "i.json").digest(), "words do not change it"


def test_an_antenna_gain_of_1_in_every_channel_makes_c_relative():
    plain = make_content()
    assert parse_instrument(plain, "i.json").antenna_gain_note.startswith("unchecked")
    without = plain | {"antenna_gain": [1.0] * len(plain["frequency_mhz"])}
    assert parse_instrument(without, "i.json").antenna_gain_note.startswith("relative: antenna_gain is 1")


def test_an_error_of_one_number_holds_in_every_channel():
    content = make_content() | {"antenna_gain_provenance": {"kind": "relative", "source": "x", "shape_error": 0.1}}
    assert parse_instrument(content, "i.json").gain_provenance.shape_error.tolist() == [0.1, 0.1, 0.1]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"kind": "measured"}, "kind: expected absolute or relative"),
        ({"source": None}, "source: expected a name"),
        ({"shape_error": [0.1, 0.2]}, "shape_error: expected a number a channel"),
        ({"shape_error": [0.1, "x", 0.2]}, "expected a finite number"),
        ({"scale_error": -0.1}, r"scale_error: expected a fraction, 0 to 1 \(0.1 for 10 %\), found -0.1"),
        ({"shape_error": 10}, r"shape_error: expected a fraction, 0 to 1 \(0.1 for 10 %\), found 10"),
    ],
)
def test_a_provenance_that_says_nothing_sensible_is_refused(change, said):
    with pytest.raises(BadInputError, match=said):
        parse_instrument(make_content() | {"antenna_gain_provenance": PROVENANCE | change}, "i.json")


def test_a_record_covers_its_first_instant_and_not_its_last():
    record = AntennaRecord("CS002", 0, "50 m", since=10.0, until=20.0)
    assert [record.covers(instant) for instant in (9.9, 10.0, 19.9, 20.0)] == [False, True, True, False]
