from __future__ import annotations

import numpy as np

from lbacal_core.calibration.channels import describe_merged
from lbacal_core.calibration.separable import solve_separable
from lbacal_core.chain.intercepts import three_constants


def lines(terms):
    slope = 50 * np.exp(-(np.linspace(-1.5, 1, 12) ** 2) * 2)
    error = np.r_[0.02 * slope, np.full(12, 0.1)]
    return slope, 0.3 * slope + terms.design @ [4.0, 2.5], np.diag(error**-2)


def test_merged_constants_are_named_with_what_they_add_together_and_why():
    terms = three_constants(np.ones(12))
    slope, intercept, information = lines(terms)
    merged = describe_merged(solve_separable(slope[None], intercept[None], information[None], terms), 0, terms)
    assert merged.constants == ("n_rcu", "n_adc")
    assert abs(merged.value - 6.5) < merged.sigma < 0.2
    assert merged.reason.startswith("N_RCU, N_ADC cannot be told apart: the chain behind them is flat")


def test_constants_that_the_data_tell_apart_are_not_merged():
    terms = three_constants(1.2 - 0.9 * np.linspace(0, 1, 12) ** 3)
    slope, intercept, information = lines(terms)
    assert describe_merged(solve_separable(slope[None], intercept[None], information[None], terms), 0, terms) is None
