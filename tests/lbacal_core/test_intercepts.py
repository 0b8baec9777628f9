"""What intercepts are made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lbacal_core.chain.intercepts import three_constants

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


def test_a_constant_is_described_with_its_unit_and_what_is_known_of_it():
    terms = replace(three_constants(GAIN), mean=np.array([150.0]), precision=np.array([0.01]))
    assert terms.describe().startswith("n_lna in P_sky, known as 150 +- 10; n_rcu in ADC^2/Ohm/MHz")
