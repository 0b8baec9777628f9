from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.errors import BadInputError
from lbacal_core.readers.source import Source


@pytest.mark.parametrize(
    ("antennas", "dipoles", "message"),
    [([], [], "at least one path"), ([1], ["?"], "a letter or name"), ([1, 1], ["X", "X"], "A antenna 1 X twice")],
)
def test_paths_that_no_spectra_file_could_hold_are_refused(
    antennas: list[int], dipoles: list[str], message: str
) -> None:
    frequency = np.array([40.0, 41.0])
    with pytest.raises(BadInputError, match=message):
        Source(
            "made", frequency, np.ones(2), np.array(["A"] * len(antennas)), np.array(antennas), np.array(dipoles),
            lambda: iter(()),
        )  # fmt: skip
