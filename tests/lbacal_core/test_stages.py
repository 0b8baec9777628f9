"""What is a chain, and what follows from the list of its stages."""

from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.errors import BadInputError
from lbacal_core.instrument.stages import Stage, fill_fields, gain_behind, require_chain, split_stages

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
