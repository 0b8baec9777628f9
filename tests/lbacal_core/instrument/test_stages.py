"""What is a chain, and what follows from the list of its stages."""

import json
from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.instrument.chain import three_constants
from lbacal_core.instrument.instrument import load_instrument, parse_instrument
from lbacal_core.instrument.stages import Stage, fill_fields, gain_behind, parse_stages, require_chain, split_stages

HALF, TEN = np.full(3, 0.5), np.full(3, 10.0)
ANTENNA, GROUND = Stage("antenna", "antenna", is_free=True), Stage("ground", "ground", noise_k=np.full(3, 290.0))
LNA, COAX = Stage("lna", "lna", TEN, is_free=True), Stage("coax", "cable", HALF)
AMPLIFIER, ADC = Stage("amp", "amplifier", TEN), Stage("adc", "adc", is_free=True)


def names(stages):
    return [stage.name for stage in stages]


def test_the_cable_parts_what_is_referred_to_the_sky_from_what_is_not():
    front, behind = split_stages([GROUND, LNA, COAX, AMPLIFIER, ADC])
    assert (names(front), names(behind)) == (["ground", "lna"], ["amp", "adc"])


def test_without_a_cable_the_lna_is_the_last_in_front_and_without_one_the_antenna():
    assert names(split_stages([ANTENNA, LNA, AMPLIFIER, ADC])[0]) == ["antenna", "lna"]
    assert names(split_stages([ANTENNA, AMPLIFIER, ADC])[0]) == ["antenna"]


def test_receiver_gain_is_what_stands_behind_the_cable():
    np.testing.assert_array_equal(gain_behind([LNA, COAX, AMPLIFIER, Stage("f", "filter", HALF), ADC], 3), 5.0)


@pytest.mark.parametrize(
    ("stages", "found"),
    [
        ([LNA, LNA, ADC], "'lna' twice"),
        ([ADC, AMPLIFIER], "adc, amplifier"),
        ([LNA, GROUND, ADC], "lna, ground, adc"),
        ([LNA, COAX, Stage("other", "cable", HALF), ADC], "found 2"),
        ([Stage("coax", "cable", HALF, is_free=True), ADC], "no noise temperature of the cable"),
        ([GROUND, AMPLIFIER], "whose noise_temperature_k is free, or has an error, found none"),
    ],
)
def test_a_list_that_is_no_chain_is_refused_with_the_reason(stages, found):
    with pytest.raises(BadInputError, match=found):
        require_chain(stages, "i.json: stages")


def test_fields_that_follow_from_the_stages_need_not_be_given():
    content = {"antennas": [{"station": "S1", "antenna": 0}, {"station": "S1", "antenna": 1, "cable": "coax"}]}
    filled = fill_fields(content, [Stage("a", "antenna", TEN), LNA, COAX, AMPLIFIER, ADC], 3)
    assert filled["antenna_gain"] == filled["receiver_gain"] == [10.0] * 3
    assert filled["cables"] == {"coax": [0.5] * 3}
    assert {row["cable"] for row in filled["antennas"]} == {"coax"}


def test_a_cable_without_a_gain_is_each_antennas_own():
    assert "cables" not in fill_fields({}, [LNA, Stage("coax", "cable"), ADC], 3)


NU = np.array([50.0, 60.0, 80.0])
ADC_ROW = {"name": "adc", "kind": "adc", "noise_temperature_k": "free"}
TOUCHSTONE = """! a filter of 20, 10 and 0 dB with 3 dB between
# MHz S DB R 50
40 -20 0 {0} 0 -60 0 -20 0
60 -20 0 {1} 0 -60 0 -20 0
90 -20 0 {2} 0 -60 0 -20 0
"""


def gain_of(content, folder=None):
    filter_and_adc = [{"name": "filter", "kind": "filter", **content}, ADC_ROW]
    return parse_stages(filter_and_adc, NU, "i.json: stages", folder)[0].gain


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ({"gain": 0.5}, [0.5, 0.5, 0.5]),
        ({"gain_db": 20}, [100.0, 100.0, 100.0]),
        ({"gain": [1, 2, 3]}, [1.0, 2.0, 3.0]),
        ({"gain_db": [0, 10, 20]}, [1.0, 10.0, 100.0]),
        ({"gain": {"frequency_mhz": [40, 60, 100], "gain_db": [-10, -20, 0]}}, [10**-1.5, 0.01, 0.1]),
        # it was a KeyError: docs/formats/instrument.md has a table under either name
        ({"gain_db": {"frequency_mhz": [40, 60, 100], "gain_db": [-10, -20, 0]}}, [10**-1.5, 0.01, 0.1]),
        ({"gain": {"frequency_mhz": [40, 60, 100], "gain": [0.1, 0.01, 1.0]}}, [10**-1.5, 0.01, 0.1]),
    ],
)
def test_a_gain_is_a_number_one_a_channel_or_a_table_in_power_or_in_decibel(content, expected):
    np.testing.assert_allclose(gain_of(content), expected)


def test_a_touchstone_file_beside_the_instrument_gives_the_gain_from_port_1_to_port_2(tmp_path):
    (tmp_path / "filter.s2p").write_text(TOUCHSTONE.format(-20, -10, -4))
    np.testing.assert_allclose(gain_of({"gain": "filter.s2p"}, tmp_path), [10**-1.5, 0.1, 10**-0.6])
    content = {
        "name": "staged", "latitude_deg": 1, "longitude_deg": 2, "height_m": 3, "frequency_mhz": NU.tolist(),
        "dipoles": {"A": {"azimuth_deg": 0}}, "antenna_gain": [1, 1, 1], "antenna": "short-dipole",
        "stages": [{"name": "filter", "kind": "filter", "gain": "filter.s2p"}, ADC_ROW],
        "antennas": [{"station": "S1", "antenna": 0}],
    }  # fmt: skip
    (tmp_path / "mine.json").write_text(json.dumps(content))
    instrument = load_instrument(str(tmp_path / "mine.json"))
    np.testing.assert_allclose(instrument.receiver_gain, [10**-1.5, 0.1, 10**-0.6])
    # what is written is complete: no file is needed beside it
    again = parse_instrument(json.loads(json.dumps(instrument.as_dict())), "again")
    assert again.digest() == instrument.digest()


def test_stages_without_one_of_the_antenna_do_not_give_its_gain():
    content = {"frequency_mhz": NU.tolist(), "stages": [{"name": "amp", "kind": "amplifier", "gain": 2}, ADC_ROW]}
    with pytest.raises(BadInputError, match="antenna_gain: expected the field, or a stage of kind antenna with a gain"):
        parse_instrument(content, "i.json")


def test_a_touchstone_file_of_one_port_is_an_antenna_and_one_of_none_or_three_is_refused(tmp_path):
    (tmp_path / "one.s1p").write_text("# MHz S DB R 75\n40 -20 0\n90 -20 0\n")
    np.testing.assert_allclose(gain_of({"gain": "one.s1p"}, tmp_path), 0.99)
    for antenna in ("one.s1p", 75 * 1.1 / 0.9):
        np.testing.assert_allclose(gain_of({"gain": {"antenna": antenna, "load": 75}}, tmp_path), 0.99)
    with pytest.raises(BadInputError, match=r"gain\.load: expected an impedance in ohm whose real part is above 0"):
        gain_of({"gain": {"antenna": "one.s1p", "load": -50}}, tmp_path)
    (tmp_path / "three.s3p").write_text("# MHz S DB R 50\n" + "".join(f"{nu} {'-20 0 ' * 9}\n" for nu in (40, 90)))
    with pytest.raises(BadInputError, match=r"one port \(\.s1p\) or two \(\.s2p\), found '\.s3p'"):
        gain_of({"gain": {"antenna": "three.s3p", "load": 75}}, tmp_path)
    with pytest.raises(BadInputError, match=r"gain of stage 'filter': .*\{.frequency_mhz.: .*, found 'filter\.csv'"):
        gain_of({"gain": "filter.csv"}, tmp_path)
    (tmp_path / "no.s2p").write_text("nothing of the kind\n")
    with pytest.raises(UnreadableFileError, match="expected a Touchstone file"):
        gain_of({"gain": "no.s2p"}, tmp_path)
    with pytest.raises(UnreadableFileError, match="expected a Touchstone file"):
        gain_of({"gain": "absent.s2p"}, tmp_path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({}, "a gain, found none"),
        ({"gain": 1, "gain_db": 0}, "gain or gain_db, found both"),
        ({"gain": [1, 2]}, "one number, 3 or a table with frequency_mhz, found 2"),
        ({"gain": 0}, "numbers > 0, found 0.0"),
        ({"gain": {"frequency_mhz": [55, 90], "gain": [1, 1]}}, "a table from 50 to 80 MHz, found 55 to 90 MHz"),
        ({"gain": "f.s2p"}, "no folder to look for files in"),
        ({"gain": 1, "noise": 3}, "noise_temperature_k, .*found noise"),
        ({"gain": 1, "noise_temperature_error_k": 3}, "an error >= 0 of a known noise temperature"),
        ({"gain": 1, "noise_temperature_k": "unknown"}, "'free', or kelvin as .*, found 'unknown'"),
    ],
)
def test_a_stage_that_says_something_else_is_refused(content, message):
    with pytest.raises(BadInputError, match=message):
        gain_of(content)


GAIN = np.array([1.0, 0.8, 0.1])


def test_the_converter_is_parted_from_the_receiver_and_absent_where_there_is_none():
    terms = three_constants(GAIN)
    receiver, converter = terms.split_behind(np.array([2.0, 5.0]))
    np.testing.assert_array_equal(receiver, 2.0 * GAIN)
    np.testing.assert_array_equal(converter, 5.0)
    receiver, converter = replace(terms, ends_in_adc=False).split_behind(np.array([2.0, 5.0]))
    np.testing.assert_array_equal(receiver, 2.0 * GAIN + 5.0)
    np.testing.assert_array_equal(converter, 0.0)


def test_what_is_known_in_front_is_added_to_the_constants_and_counts_none_of_the_degrees_of_freedom():
    terms = replace(three_constants(GAIN), known=np.array([3.0, 2.0, 1.0]))
    np.testing.assert_array_equal(terms.before(np.array([[0.5], [1.0]])), [[3.5, 2.5, 1.5], [4.0, 3.0, 2.0]])
    assert terms.free_count == 3
    assert replace(terms, precision=np.array([0.1])).free_count == 2


def test_some_channels_of_it_are_those_of_each_form():
    some = three_constants(GAIN).select(np.array([True, False, True]))
    np.testing.assert_array_equal(some.behind, [[1.0, 0.1], [1.0, 1.0]])
    assert some.known.shape == (2,)


def test_channels_in_another_unit_and_cables_beside_a_cable_with_another_gain_are_refused():
    table = {"frequency_mhz": [30.0, 80.0], "gain_db": [0.0, 0.0]}
    content = load_instrument("lofar-superterp").as_dict() | {"frequency_mhz": [30.0, 50.0, 80.0]}
    content |= {"antenna_gain": [1.0] * 3, "cables": {"coax": [0.5] * 3}}
    del content["receiver_gain"]
    content |= {"antennas": [{"station": "S1", "antenna": 0, "cable": "coax"}]}
    content |= {"antenna_gain_provenance": None, "stages": [one.as_dict() for one in (LNA, COAX, ADC)]}
    content["stages"].insert(2, {"name": "f", "kind": "filter", "gain": table})
    assert parse_instrument(content, "i.json").cables["coax"][0] == 0.5
    with pytest.raises(BadInputError, match="which looks like GHz"):
        parse_instrument(content | {"frequency_mhz": [0.03, 0.05, 0.08]}, "i.json")
    content["cables"] = {"coax": [0.5] * 3, "long": [0.25] * 3}
    with pytest.raises(BadInputError, match="the cable 'long' as the gain of the stage 'coax', or that stage without"):
        parse_instrument(content, "i.json")
