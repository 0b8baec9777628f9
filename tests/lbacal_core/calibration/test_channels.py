from __future__ import annotations

import numpy as np

from lbacal_core.calibration.channels import flag_channels, solve_without_interference
from lbacal_core.calibration.separable import solve_separable
from lbacal_core.chain.intercepts import three_constants

CHANNELS = 20
TERMS = three_constants(np.linspace(1.0, 2.0, CHANNELS) ** 2)


def lines_of(rng, paths=40, error=0.01):
    """Measured lines of paths that obey the chain, and their information."""
    slope = rng.uniform(1.0, 3.0, (paths, CHANNELS))
    intercept = 0.4 * slope + TERMS.design @ [0.3, 0.5]
    measured = rng.normal(np.concatenate([slope, intercept], axis=1), error)
    information = np.tile(np.eye(2 * CHANNELS) / error**2, (paths, 1, 1))
    return measured[:, :CHANNELS], measured[:, CHANNELS:], information


def test_of_800_clean_channels_none_stands_out_and_the_solution_is_that_of_the_plain_solver():
    slope, intercept, information = lines_of(np.random.default_rng(1))
    solution, is_free = solve_without_interference(slope, intercept, information, TERMS)
    assert not is_free.any()
    np.testing.assert_array_equal(solution.x, solve_separable(slope, intercept, information, TERMS).x)


def test_interference_in_two_channels_is_freed_and_the_rest_is_fitted_as_if_they_were_not_there():
    slope, intercept, information = lines_of(np.random.default_rng(2))
    clean = solve_separable(slope, intercept, information, TERMS)
    intercept[5, [3, 11]] += [0.2, 0.3]
    solution, is_free = solve_without_interference(slope, intercept, information, TERMS)
    assert np.argwhere(is_free).tolist() == [[5, 3], [5, 11]]
    sigma = np.sqrt(np.einsum("pii->pi", clean.covariance))[5, :CHANNELS]
    others = np.delete(np.arange(CHANNELS), [3, 11])
    assert np.max(np.abs(solution.x[5] - clean.x[5])[others] / sigma[others]) < 1.5
    np.testing.assert_array_equal(np.delete(solution.x, 5, 0), np.delete(clean.x, 5, 0))


def test_a_channel_that_is_too_quiet_is_no_interference():
    slope, intercept, information = lines_of(np.random.default_rng(3))
    intercept[:, 7] -= 0.3
    assert not solve_without_interference(slope, intercept, information, TERMS)[1][:, 7].any()


def test_where_the_chain_is_wrong_everywhere_no_channel_is_accused():
    slope, intercept, information = lines_of(np.random.default_rng(4))
    intercept += 0.2 * np.sin(np.arange(CHANNELS))
    assert not solve_without_interference(slope, intercept, information, TERMS)[1].any()


def test_flags_say_what_is_wrong_with_a_channel():
    error = np.array([[0.01, 0.12, 0.14, 0.49, 0.51, np.nan, 0.02, 0.02]])
    scatter = np.array([[1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.6, 1.0]])
    steady = np.zeros(error.shape, dtype=bool)
    steady[0, 1] = True
    expected = ["ok", "interference", "uncertain", "uncertain", "outside", "outside", "interference", "ok"]
    assert flag_channels(error, scatter, steady)[0].tolist() == expected
