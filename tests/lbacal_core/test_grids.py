from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.errors import BadInputError
from lbacal_core.grids import guess_widths, require_channels, require_same_grid
from lbacal_core.spectra.spectra import Spectra

GRID = np.arange(30.0, 81.0)


def test_the_same_grid_passes_with_the_rounding_of_a_file() -> None:
    require_same_grid("s.h5", GRID + 4e-7, GRID, "instrument a")


def test_another_number_of_channels_is_named() -> None:
    sentence = r"s\.h5: frequency_mhz: expected the 51 channels of instrument a, found 50 channels"
    with pytest.raises(BadInputError, match=sentence):
        require_same_grid("s.h5", GRID[1:], GRID, "instrument a")


def test_the_first_channel_off_the_grid_is_named() -> None:
    off = GRID.copy()
    off[7:] += 0.5
    sentence = r"s\.h5: frequency_mhz, channel 7: expected 37 MHz as in instrument a, found 37\.5 MHz"
    with pytest.raises(BadInputError, match=sentence):
        require_same_grid("s.h5", off, GRID, "instrument a")


def test_a_channel_that_is_no_number_is_off_every_grid() -> None:
    """51 channels of NaN were stored."""
    with pytest.raises(BadInputError, match="channel 0: expected 30 MHz as in instrument a, found nan MHz"):
        require_same_grid("body", np.full(51, np.nan), GRID, "instrument a")


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
def test_channels_are_finite_positive_and_rising(frequency: list[float], sentence: str) -> None:
    with pytest.raises(BadInputError, match=sentence):
        require_channels("a file", np.array(frequency))
    require_channels("a file", GRID)


def test_channels_without_widths_are_as_wide_as_the_nearer_neighbour_is_away(two_stations: Spectra) -> None:
    assert two_stations.channel_widths().tolist() == [1.0] * two_stations.frequency_mhz.size
    np.testing.assert_allclose(guess_widths(np.array([10.0, 10.4, 11.4])), [0.4, 0.4, 1.0])
    assert guess_widths(np.array([78.0])).tolist() == [1.0]
