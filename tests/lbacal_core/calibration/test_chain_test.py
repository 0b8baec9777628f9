import numpy as np
import pytest
from scipy.stats import chi2 as chi2_distribution
from scipy.stats import kstest

from lbacal_core.calibration.chain_test import FittedPaths, is_improbable
from lbacal_core.calibration.lines import fit_lines
from lbacal_core.calibration.separable import solve_separable
from lbacal_core.instrument.chain import three_constants
from lbacal_core.simulation.prior import Mistake, SkyPrior


def run_test(scene, paths, events, seed, freedom=None, change=None):
    """The chain test of clean paths whose sky departs by `change` (lst in hours to ln P_sky, shape (event, freq))."""
    rng = np.random.default_rng(seed)
    lst = rng.uniform(0.0, 24.0, events)
    sky = scene.sky_power.at("X", lst)
    true = sky if change is None else sky * np.exp(change(lst))
    gain = 1 + 0.02 * rng.standard_normal((1, events, 1)) + 0.03 * rng.standard_normal((paths, events, 1))
    power = scene.mean_power(true) * gain * rng.gamma(0.045**-2, 0.045**2, (paths, events, sky.shape[1]))
    variance = np.ones(power.shape[:2])
    lines = fit_lines(power, sky, variance)
    terms = three_constants(scene.instrument.receiver_gain)
    solution = solve_separable(lines.slope, lines.intercept, lines.information, terms)
    is_free = np.zeros(lines.slope.shape, dtype=bool)
    return FittedPaths(power, sky, variance, lst, lines, solution.n, solution.x, terms, is_free, freedom, "X").test()


def hotter(scene, lst):
    """The change of ln P_sky by another antenna: a level of up to e, and 15 % along LST."""
    level = np.linspace(0.0, 1.0, scene.instrument.frequency_mhz.size)
    return level * (1.0 + 0.15 * np.sin(2 * np.pi * (lst[:, None] - 3.0) / 24.0))


def compare_hotter(scene, size, events=600, seed=8):
    """Ln of the probability of the hotter sky over the sky that is believed; `size` times its change is true."""
    rng = np.random.default_rng(seed)
    lst = rng.uniform(0.0, 24.0, events)
    sky = scene.sky_power.at("X", lst)
    power = scene.mean_power(sky * np.exp(size * hotter(scene, lst))) * rng.gamma(500.0, 0.002, (1, *sky.shape))
    terms, variance = three_constants(scene.instrument.receiver_gain), np.ones((1, events))
    fits = []
    for one in (sky, sky * np.exp(hotter(scene, lst))):
        lines = fit_lines(power, one, variance)
        solution = solve_separable(lines.slope, lines.intercept, lines.information, terms)
        slope = solution.x[0]
        behind = solution.q[0] @ terms.behind
        fits.append((lines, solution, slope * one + terms.before(solution.n[0]) * slope + behind))
    (lines, solution, own), (*_, other) = fits
    is_free, freedom = np.zeros(lines.slope.shape, dtype=bool), SkyPrior({"X": tilt(scene, 0.05)[None]}, "")
    fitted = FittedPaths(power, sky, variance, lst, lines, solution.n, solution.x, terms, is_free, freedom, "X")
    return fitted.compare(np.array([own, other]))


def test_another_model_is_compared_by_what_it_predicts_however_far_it_is(scene):
    """A level of e is no small change: linearised, an antenna 0.1 m lower passed for the one that it was."""
    own, other = compare_hotter(scene, 0.0)
    assert own == pytest.approx(0.0, abs=1.0)
    assert other < -50.0
    own, other = compare_hotter(scene, 1.0)
    assert other - own > 50.0


def tilt(scene, size):
    """A change of the sky's level along frequency, shape (lst, freq)."""
    return np.tile(size * np.linspace(-1.0, 1.0, scene.instrument.frequency_mhz.size), (48, 1))


@pytest.mark.parametrize("events", [80, 400])
def test_clean_paths_follow_the_chi2_distribution(scene, events):
    found = [run_test(scene, 10, events, seed) for seed in range(20)]
    chi2, dof = np.concatenate([f.chi2 for f in found]), np.concatenate([f.dof for f in found])
    # 23 of the intercepts, and 12 or 18 of the harmonics: the lines absorb what P_sky itself has
    assert set(dof.tolist()) <= {35.0, 38.0, 41.0}
    # 200 paths know the mean to 0.015; paths of a campaign share the gains of its events
    assert np.mean(chi2 / dof) == pytest.approx(1.0, abs=0.08)
    assert kstest(chi2_distribution.sf(chi2, dof), "uniform").pvalue > 1e-4
    assert not any(f.is_misfit.any() for f in found)


def test_a_sky_within_its_freedom_is_no_misfit_and_one_taken_at_its_word_is(scene):
    size = 0.3
    freedom = SkyPrior({"X": tilt(scene, size)[None]}, "")

    def tilted(lst):
        return np.tile(tilt(scene, size)[0], (lst.size, 1))

    strict = run_test(scene, 10, 900, 3, None, tilted)
    free = run_test(scene, 10, 900, 3, freedom, tilted)
    assert np.mean(strict.per_dof) > np.mean(free.per_dof) + 1.0
    assert strict.is_misfit.mean() > 0.5
    assert not free.is_misfit.any()
    assert free.dof[0] == pytest.approx(strict.dof[0] - 1.0, abs=0.05)
    assert np.mean(free.per_dof) == pytest.approx(1.0, abs=0.2)


def test_freedom_costs_clean_paths_nothing(scene):
    freedom = SkyPrior({"X": tilt(scene, 0.15)[None]}, "")
    found = run_test(scene, 10, 400, 5, freedom)
    assert np.mean(found.per_dof) == pytest.approx(1.0, abs=0.25)


def late(lst):
    """What follows the sidereal day alike in all 26 channels."""
    return np.outer(0.05 * np.sin(2 * np.pi * (lst - 3.0) / 24.0), np.ones(26))


def test_what_follows_the_sidereal_day_beside_the_lines_is_a_misfit(scene):
    assert run_test(scene, 10, 900, 4, None, late).is_misfit.mean() > 0.5


def test_a_mistake_gains_where_it_was_made_and_loses_where_it_was_not(scene):
    """Where nothing is wrong, a gain of g has a probability of at most exp(-g)."""
    change = late(np.arange(48) / 2.0)
    waves = np.stack(
        [0.01 * np.tile(f(2 * np.pi * np.arange(48) / 48.0)[:, None], change.shape[1]) for f in (np.cos, np.sin)]
    )
    freedom = SkyPrior({"X": waves}, "", (Mistake("late", {"X": change}),))
    clean, wrong = (run_test(scene, 10, 900, 4, freedom, one) for one in (None, late))
    assert clean.gain.shape == (10, 1)
    assert clean.gain.max() < 0.0
    assert wrong.gain.min() > 3.0
    assert wrong.gain == pytest.approx(-clean.gain, rel=0.8)


def test_a_misfit_is_less_probable_than_one_in_a_million():
    limit = chi2_distribution.isf(1e-6, 48)
    assert is_improbable(np.array([limit * 0.999, limit * 1.001]), np.array([48.0, 48.0])).tolist() == [False, True]
