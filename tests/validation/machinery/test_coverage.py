from __future__ import annotations

import numpy as np

from validation.machinery.claims import REFUTED, SHOWN, UNDECIDED, Asked, decide
from validation.machinery.coverage import count_within, coverage

WITHIN = {"c_1": Asked("68 %", 0.60, 0.76), "c_2": Asked("95 %", 0.91, 0.98)}


def test_shares_count_the_numbers_within_one_and_two_sigma() -> None:
    assert count_within("c", np.array([0.5, -1.5, 2.5, -0.1])) == {"c_1": 0.5, "c_2": 0.75}


def test_normal_pulls_are_shown_and_wide_ones_refuted() -> None:
    rng = np.random.default_rng(1)
    good = [count_within("c", rng.standard_normal(40)) for _ in range(200)]
    wide = [count_within("c", 2.0 * rng.standard_normal(40)) for _ in range(200)]
    assert [claim.verdict for claim in decide(coverage(good, "c"), WITHIN)] == [SHOWN, SHOWN]
    assert [claim.verdict for claim in decide(coverage(wide, "c"), WITHIN)] == [REFUTED, REFUTED]


def test_forty_of_forty_leave_room_for_a_few_outside() -> None:
    # the interval of a mean of 40 ones has no width, and refuted 95 %
    within_1, within_2 = decide(coverage([count_within("c", np.array([0.3])) for _ in range(40)], "c"), WITHIN)
    assert within_1.verdict == REFUTED
    assert within_2.verdict == UNDECIDED
    assert 0.89 < within_2.interval[0] < within_2.interval[1] == 1.0
