from __future__ import annotations

import numpy as np

from lbacal_core.spectra.blocks import split_into_blocks
from lbacal_core.spectra.spectra import Spectra


def test_blocks_hold_every_spectrum_in_its_place(two_stations: Spectra) -> None:
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


def test_an_event_that_one_dipole_lacks_altogether_is_not_in_its_block(two_stations: Spectra) -> None:
    lost = (two_stations.event_id == "event 2") & (two_stations.dipole == "X")
    blocks = {block.dipole: block for block in split_into_blocks(two_stations.select(~lost))}
    assert blocks["X"].power.shape[1] == len(blocks["X"].event_id) == 2
    assert blocks["Y"].power.shape[1] == len(blocks["Y"].event_id) == 3
