from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.causes.terms import signature
from lbacal_core.discovery.scan import equivalent_trials, p_of, scan, sigma_of
from lbacal_core.discovery.targets import find_nuisance, list_targets, mean_over_paths
from lbacal_core.discovery.whitening import split_residuals


@pytest.fixture(scope="module")
def parts(station, baseline):
    residuals = split_residuals(station, baseline.residual)
    nuisance = find_nuisance(station, residuals, baseline.terms, None)
    chosen = [c for c in CAUSES if c.identifier in ("gain_step", "lst_offset", "rfi_line", "gain_temperature")]
    targets = list_targets(station)
    return residuals, nuisance, chosen, targets, scan(station, residuals, nuisance, baseline.terms, chosen, targets)


def slow_score(station, baseline, residuals, nuisance, score):
    """Whiten signature and residuals, take out what the fit absorbs, and multiply."""
    values = signature(score.cause, baseline.terms, station.conditions, score.law)
    if score.target.scope == "station":
        vector = nuisance.clean_mean(residuals.whiten_mean(mean_over_paths(station, residuals, values)))
        observed = nuisance.clean_mean(residuals.whiten_mean(residuals.mean))
        return vector @ observed / np.linalg.norm(vector)
    total, square = 0.0, 0.0
    for k in np.flatnonzero(score.target.is_member):
        index = int(station.class_of[k])
        vector = nuisance.clean_path(residuals.whiten_path(values[index]), index)
        observed = nuisance.clean_path(residuals.whiten_path(residuals.deviation[k]), index)
        scale = residuals.levels.path_scale[k]
        total += vector @ observed / scale**2
        share = 1 - 1 / np.sum(station.dipole == station.dipole[k])
        square += share * vector @ vector * residuals.presence[k] / scale**2
    return total / np.sqrt(square)


def test_scores_equal_the_slow_ones_lines_included(station, baseline, parts):
    residuals, nuisance, chosen, _, found = parts
    assert {score.cause.identifier for score in found.best} == {cause.identifier for cause in chosen}
    for score in found.best:
        if score.target.scope in ("station", "path", "antenna"):
            slow = slow_score(station, baseline, residuals, nuisance, score)
            np.testing.assert_allclose(score.z, slow, rtol=1e-3, atol=1e-3)  # signatures are kept in single precision


def test_scores_of_a_clean_station_are_not_significant(parts):
    *_, found = parts
    assert p_of(max(abs(score.z) for score in found.best), found.trials) > 0.003


def test_independent_scores_count_each_and_equal_ones_count_once():
    trials = equivalent_trials(np.eye(50), [0] * 50, [1.0], seed=1)
    assert 40 < trials[0] < 62  # the 90 % quantile of 4000 draws: 5 % of 10 %
    same = equivalent_trials(np.ones((50, 50)), [0] * 50, [1.0], seed=1)
    assert same[0] < 1.3


def test_probability_and_sigma_are_each_others_inverse():
    np.testing.assert_allclose(p_of(5.0, 1.0), 2 * norm.sf(5.0), rtol=1e-6)
    np.testing.assert_allclose(sigma_of(p_of(4.2, 1.0)), 4.2, rtol=1e-5)  # 1e-5 is what erfcinv keeps of p
