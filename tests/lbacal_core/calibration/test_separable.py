import numpy as np
import pytest
from scipy.optimize import least_squares

from lbacal_core.calibration.channels import describe_merged, flag_channels, solve_without_interference
from lbacal_core.calibration.separable import solve_separable
from lbacal_core.instrument.chain import Intercepts, three_constants


def problem(rng, size=12):
    terms = three_constants(1.2 - 0.9 * np.linspace(0, 1, size) ** 3)
    x = 50 * np.exp(-((np.linspace(-1.5, 1, size)) ** 2) * 2)
    y = 0.3 * x + terms.design @ [4.0, 2.5]
    root = rng.standard_normal((2 * size, 2 * size)) * 0.01 + np.diag(np.r_[0.02 * x, 0.03 * y])
    covariance = root @ root.T
    noise = root @ rng.standard_normal(2 * size)
    return x + noise[:size], y + noise[size:], np.linalg.inv(covariance), terms


def with_one_constant(size):
    both = three_constants(np.ones(size))
    return Intercepts(
        both.names[:2], both.front, both.behind[:1], both.known, both.mean, both.precision, both.units[:2]
    )


def test_solution_and_covariance_equal_a_general_least_squares_solver():
    rng = np.random.default_rng(1)
    x, y, information, terms = problem(rng)
    root = np.linalg.cholesky(information).T
    size = x.size

    def residual(parameters):
        free, n, q = parameters[:size], parameters[size], parameters[size + 1 :]
        return root @ np.concatenate([x - free, y - n * free - terms.design @ q])

    start = np.concatenate([x, [0.1, 1.0, 1.0]])
    expected = least_squares(residual, start, jac="3-point", xtol=1e-14, ftol=1e-14, gtol=1e-12, x_scale=start)
    solution = solve_separable(x[None], y[None], information[None], terms)
    assert solution.is_converged[0]
    assert solution.is_identifiable[0]
    found = np.concatenate([solution.x[0], solution.n[0], solution.q[0]])
    np.testing.assert_allclose(found, expected.x, rtol=1e-5)
    np.testing.assert_allclose(solution.chi2[0], 2 * expected.cost, rtol=1e-6)
    sigma = np.sqrt(np.diag(solution.covariance[0]))
    np.testing.assert_allclose(sigma, np.sqrt(np.diag(np.linalg.inv(expected.jac.T @ expected.jac))), rtol=1e-4)


def test_problems_that_stand_still_wait_for_others_and_are_solved_as_if_alone():
    """Bit by bit, the easy ones after few steps, and one whose line is far from its start after many."""
    rng = np.random.default_rng(5)
    problems = [problem(rng) for _ in range(4)]
    x, y, information, _ = problems[1]
    problems[1] = (x * (1 + 0.5 * rng.standard_normal(x.size)), y, information, problems[1][3])
    together = solve_separable(*(np.stack(part) for part in list(zip(*problems, strict=True))[:3]), problems[0][3])
    for k, (x, y, information, terms) in enumerate(problems):
        alone = solve_separable(x[None], y[None], information[None], terms)
        for name, values in vars(alone).items():
            np.testing.assert_array_equal(getattr(together, name)[k], values[0], name)


def test_units_do_not_matter():
    x, y, information, terms = problem(np.random.default_rng(2))
    plain = solve_separable(x[None], y[None], information[None], terms)
    unit = np.r_[np.full(x.size, 1e14), np.full(x.size, 1e-3)]
    scaled = solve_separable((x * 1e14)[None], (y * 1e-3)[None], (information / np.outer(unit, unit))[None], terms)
    np.testing.assert_allclose(scaled.n * 1e17, plain.n, rtol=1e-9)
    np.testing.assert_allclose(scaled.q * 1e3, plain.q, rtol=1e-9)
    np.testing.assert_allclose(scaled.chi2, plain.chi2, rtol=1e-9)


def test_equal_columns_are_merged_and_leave_x_and_their_sum_as_with_one_column():
    x, y, information, _ = problem(np.random.default_rng(3))
    flat = solve_separable(x[None], y[None], information[None], three_constants(np.ones(x.size)))
    one = solve_separable(x[None], y[None], information[None], with_one_constant(x.size))
    assert flat.is_merged.tolist() == [[False, True, True]]
    assert not one.is_merged.any()
    size = x.size
    error = np.sqrt(np.diag(one.covariance[0]))
    # the prior pulls a sum that is known to 1 % of the mean by a hundredth of its error
    assert np.max(np.abs(flat.x[0] - one.x[0]) / error[:size]) < 0.02
    assert abs(flat.q[0].sum() - one.q[0, 0]) < 0.02 * error[-1]
    of_sum = flat.covariance[0][size + 1 :, size + 1 :].sum()
    assert np.sqrt(of_sum) == pytest.approx(error[-1], rel=0.01)
    np.testing.assert_allclose(np.sqrt(np.diag(flat.covariance[0]))[:size], error[:size], rtol=0.01)


def test_an_amount_far_below_zero_with_a_small_error_is_left_for_those_that_the_data_allow():
    """The errors of x and y are correlated along y = -P x, so that chi^2 has a narrow valley at n = -P."""
    rng = np.random.default_rng(17)
    problems, size, abscissa, n, q = 60, 40, 0.15, 0.1, 0.9
    terms = with_one_constant(size)
    x = 1.0 + 0.05 * np.sin(np.arange(size))
    of_x, along = 0.05 * rng.standard_normal((problems, size)), 0.002 * rng.standard_normal((problems, size))
    derivative = np.block([[np.eye(size), np.zeros((size, size))], [-abscissa * np.eye(size), np.eye(size)]])
    covariance = derivative @ np.diag(np.r_[np.full(size, 0.05**2), np.full(size, 0.002**2)]) @ derivative.T
    information = np.tile(np.linalg.inv(covariance), (problems, 1, 1))
    found = solve_separable(x + of_x, n * x + q - abscissa * of_x + along, information, terms)
    sigma = np.sqrt(np.einsum("pii->pi", found.covariance))
    pulls = {
        "n": (found.n[:, 0] - n) / sigma[:, size],
        "q": (found.q[:, 0] - q) / sigma[:, size + 1],
        "x": np.mean(found.x - x, axis=1) / sigma[:, :size].mean(axis=1),
    }
    assert found.is_converged.all()
    assert np.all(found.n >= 0.0)
    assert {name: np.mean(np.abs(pull) < 2.0) >= 0.9 for name, pull in pulls.items()} == dict.fromkeys(pulls, True)
    assert max(np.abs(pull).max() for pull in pulls.values()) < 4.0


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
    disturbed = np.zeros(error.shape, dtype=bool)
    disturbed[0, [1, 6]] = True
    expected = ["ok", "interference", "uncertain", "uncertain", "outside", "outside", "interference", "ok"]
    assert flag_channels(error, disturbed)[0].tolist() == expected
