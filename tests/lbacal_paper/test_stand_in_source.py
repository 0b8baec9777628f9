from __future__ import annotations

import numpy as np

from lbacal_paper.stand_in_source import SCALED_M, stand_in_tables, true_field

FREQUENCY = np.arange(30.0, 81.0)


def test_both_laboratories_miss_the_true_field_and_each_other() -> None:
    chamber, cell = stand_in_tables(FREQUENCY)
    truth = true_field(FREQUENCY)
    assert chamber.distance_m == cell.distance_m == SCALED_M
    assert "stand-in" in chamber.name
    assert "stand-in" in cell.name
    # within the stated error, but not alike in shape
    for one in (chamber, cell):
        assert np.all(np.abs(np.log(one.field / truth)) < 2 * one.sigma)
    assert np.ptp(np.log(chamber.field / cell.field)) > 0.1
