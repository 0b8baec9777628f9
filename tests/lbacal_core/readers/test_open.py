from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lbacal_core.errors import BadInputError, UnreadableFileError
from lbacal_core.instrument.instrument import Instrument
from lbacal_core.readers.open import choose_channels, open_source
from lbacal_core.readers.source import Source


@pytest.fixture
def source() -> Source:
    """Sixteen channels of 0.25 MHz from 40 MHz, of which nothing is read."""
    frequency = np.arange(40.0, 44.0, 0.25)
    return Source(
        "made", frequency, np.full(16, 0.25), np.array(["A"]), np.array([0]), np.array(["X"]), lambda: iter(())
    )


def test_channels_of_one_width_lie_at_its_multiples_and_within_the_band(source: Source) -> None:
    assert choose_channels(source, width_mhz=1.0).frequency_mhz.tolist() == [41.0, 42.0, 43.0]
    assert choose_channels(source, width_mhz=1.0, band_mhz=(42, 60)).frequency_mhz.tolist() == [42.0, 43.0]
    with pytest.raises(BadInputError, match=r"some between 40 and 43.75 MHz"):
        choose_channels(source, band_mhz=(60, 70))


def test_channels_of_an_instrument_are_its_own(source: Source, low_band: Instrument) -> None:
    assert choose_channels(source, low_band).frequency_mhz.tolist() == low_band.frequency_mhz.tolist()


def test_folder_without_data_says_what_could_be_in_it(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="sst_rcuNNN"):
        open_source(tmp_path)


def test_file_of_an_unknown_kind_says_what_is_known(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("1 2 3")
    with pytest.raises(BadInputError, match=r"uvh5.*a file \.txt"):
        open_source(tmp_path / "a.txt")
    with pytest.raises(UnreadableFileError, match="no such file"):
        open_source(tmp_path / "b.uvh5")
