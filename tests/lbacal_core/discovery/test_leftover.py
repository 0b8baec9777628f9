from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.discovery.baseline import gather_stations
from lbacal_core.discovery.extend import fit_plain
from lbacal_core.discovery.leftover import axis_functions, find_leftover, share_of_channels
from lbacal_core.twin.faults.uncatalogued import MainsHum

SIGNIFICANT = 0.002
WHATEVER = 1.1
"""More than any probability: only the test on events not used is left."""


@pytest.fixture(scope="module")
def evidence(station):
    return fit_plain(station).evidence


def test_nothing_is_left_of_a_clean_station(evidence):
    assert find_leftover(evidence, np.random.default_rng(1), SIGNIFICANT) is None


def test_the_largest_structure_of_noise_predicts_nothing_of_events_not_used(evidence):
    assert find_leftover(evidence, np.random.default_rng(1), WHATEVER) is None


def test_a_wave_over_the_day_is_left_along_utc_and_predicts_events_not_used(spoil, chain, sky):
    spoilt = fit_plain(gather_stations(spoil(MainsHum(size=0.01)), chain, sky)[0]).evidence
    found = find_leftover(spoilt, np.random.default_rng(1), SIGNIFICANT)
    assert found is not None
    assert (found.axis, found.target) == ("utc", "station")
    assert found.held_out_gain > 0
    # The vectors that describe it are functions of UTC times functions of frequency, and take the structure out.
    values = found.vectors.reshape(len(found.vectors), -1)
    rank = np.linalg.matrix_rank(values)
    assert rank == len(axis_functions(spoilt.data)["utc"]) * 6 * 2
    assert found.channel_share.sum() == pytest.approx(1.0)
    assert find_leftover(replace(spoilt, empirical=found.vectors), np.random.default_rng(1), SIGNIFICANT) is None


def test_the_spectrum_of_a_vector_is_where_it_is_not_flat(evidence):
    line = np.zeros_like(evidence.residuals.mean)
    line[:, ::2, 20] = 1.0
    share = share_of_channels(evidence, line)
    assert np.argmax(share) == 20
    assert share[20] > 0.9
    assert share.sum() == pytest.approx(1.0)
