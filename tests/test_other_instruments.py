"""The page on other instruments says what their data say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lbacal_core.audit.antennas import compare_paths
from lbacal_core.audit.station import split_stations, spread
from validation.scripts.draw_other_instruments import PAGE, make_tables, read_eda2, read_hera

DECIBEL = 10 / np.log(10)


@pytest.mark.shared
@pytest.mark.filterwarnings("ignore")  # pyuvdata's own, about the header of the file
@pytest.mark.long
def test_the_tables_of_the_page_are_those_of_the_data(shared: Path) -> None:
    page = PAGE.read_text()
    for name, table in make_tables(shared / "data").items():
        assert "\n".join([f"<!-- {name} -->", *table, f"<!-- end of {name} -->"]) in page


@pytest.mark.shared
@pytest.mark.filterwarnings("ignore")  # pyuvdata's own, about the header of the file
def test_the_levels_that_the_page_quotes_are_those_of_the_data(shared: Path) -> None:
    page = PAGE.read_text()
    for read, scatter, quoted in (
        (read_hera, {1: "1.1"}, {(90, 1): "4.6"}),
        (read_eda2, {0: "1.8", 1: "1.2"}, {(133, 0): "8.8", (81, 1): "7.6"}),
    ):
        station = next(split_stations(*read(shared / "data")))
        level = DECIBEL * compare_paths(station).level
        for dipole, words in scatter.items():
            assert f"{spread(level)[dipole]:.1f}" == words
            assert f"{words} dB" in page
        for (antenna, dipole), words in quoted.items():
            assert f"{-level[np.searchsorted(station.antennas, antenna), dipole]:.1f}" == words
            assert f"{words} dB low" in page
