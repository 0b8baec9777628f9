from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2 as chi2_distribution
from scipy.stats import kstest

from lbacal_core.calibration.chain_test import (
    SKY_HARMONICS,
    SkyFreedom,
    _harmonics,
    _move_lines,
    _Path,
    is_improbable,
    run_chain_test,
)
from lbacal_core.calibration.lines import fit_lines
from lbacal_core.calibration.mistakes import Mistake
from lbacal_core.calibration.paths import chain_forms
from lbacal_core.calibration.separable import solve_separable
from lbacal_core.intercepts import three_constants


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
    return run_chain_test(power, sky, variance, lst, lines, solution.n, solution.x, terms, is_free, freedom, "X")


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
    freedom = SkyFreedom({"X": tilt(scene, size)[None]}, "")

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
    freedom = SkyFreedom({"X": tilt(scene, 0.15)[None]}, "")
    found = run_test(scene, 10, 400, 5, freedom)
    assert np.mean(found.per_dof) == pytest.approx(1.0, abs=0.25)


def test_what_follows_the_sidereal_day_beside_the_lines_is_a_misfit(scene):
    def late(lst):
        return np.outer(0.05 * np.sin(2 * np.pi * (lst - 3.0) / 24.0), np.ones(scene.instrument.frequency_mhz.size))

    assert run_test(scene, 10, 900, 4, None, late).is_misfit.mean() > 0.5


def test_a_mistake_gains_where_it_was_made_and_loses_where_it_was_not(scene):
    """Where nothing is wrong, a gain of g has a probability of at most exp(-g)."""

    def late(lst):
        return np.outer(0.05 * np.sin(2 * np.pi * (lst - 3.0) / 24.0), np.ones(scene.instrument.frequency_mhz.size))

    change = late(np.arange(48) / 2.0)
    waves = np.stack(
        [0.01 * np.tile(f(2 * np.pi * np.arange(48) / 48.0)[:, None], change.shape[1]) for f in (np.cos, np.sin)]
    )
    freedom = SkyFreedom({"X": waves}, "", (Mistake("late", {"X": change}),))
    clean, wrong = (run_test(scene, 10, 900, 4, freedom, one) for one in (None, late))
    assert clean.gain.shape == (10, 1)
    assert clean.gain.max() < 0.0
    assert wrong.gain.min() > 3.0
    assert wrong.gain == pytest.approx(-clean.gain, rel=0.8)


def test_the_freedom_of_the_sky_moves_the_lines_as_a_fit_with_shared_noise_does(scene):
    """The covariance of an event was a gain that is flat in frequency; now it has a few vectors."""
    rng = np.random.default_rng(6)
    lst = rng.uniform(0.0, 24.0, 500)
    sky = scene.sky_power.at("X", lst)
    forms = chain_forms(scene.instrument)
    front = 1 + 0.05 * rng.standard_normal((1, 500, 1)) * forms.antenna_slope / np.max(np.abs(forms.antenna_slope))
    clean = scene.mean_power(sky) * (1 + 0.03 * rng.standard_normal((1, 500, 1))) * front
    power = clean * rng.gamma(0.045**-2, 0.045**2, clean.shape)
    variance = rng.uniform(0.5, 2.0, power.shape[:2])
    lines = fit_lines(power, sky, variance, forms)
    assert np.count_nonzero(np.any(lines.levels.vectors[0] != 0, axis=1)) >= 2
    change = 0.01 * np.linspace(-1.0, 1.0, sky.shape[1])[None] * np.cos(2 * np.pi * (np.arange(48)[:, None] - 9) / 48)
    series = SkyFreedom({"X": change[None]}, "").series("X")
    basis = _harmonics(lst, SKY_HARMONICS)
    path = _Path.of(power[0], sky, variance[0], lines.select(np.array([0])))
    moved = _move_lines(path, sky / lines.power(sky)[0], 1.0 / lines.power(sky)[0], basis, series)[0]
    added = lines.slope[:, None] * sky * (basis @ series[0])
    up, down = (fit_lines(power + sign * added, sky, variance, forms) for sign in (1.0, -1.0))
    refitted = np.concatenate([up.slope - down.slope, up.intercept - down.intercept], axis=1)[0] / 2.0
    scale = np.repeat([np.max(np.abs(half)) for half in np.split(refitted, 2)], sky.shape[1])
    # weights follow the lines that are fitted first, which the change moves too
    assert moved / scale == pytest.approx(refitted / scale, abs=0.05)


def test_a_misfit_is_less_probable_than_one_in_a_million():
    limit = chi2_distribution.isf(1e-6, 48)
    assert is_improbable(np.array([limit * 0.999, limit * 1.001]), np.array([48.0, 48.0])).tolist() == [False, True]
