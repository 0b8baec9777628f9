from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.causes.terms import Law, signature
from lbacal_core.discovery.baseline import fit_baseline, gather_stations
from lbacal_core.discovery.evidence import Evidence
from lbacal_core.discovery.extend import Effect, Extension, by_event, fit_plain
from lbacal_core.discovery.scan import group_laws, scan, score_shapes
from lbacal_core.discovery.targets import list_targets
from lbacal_core.discovery.whitening import split_residuals
from lbacal_core.twin.campaign import simulate_campaign
from lbacal_core.twin.nuisances import Nuisances
from lbacal_core.twin.settings import TwinSettings

CHOSEN = ("gain_step", "lst_offset", "rfi_line", "gain_temperature", "cable_temperature")


@pytest.fixture(scope="module")
def evidence(chain, sky):
    """A small station with gaps and a dead antenna."""
    settings = TwinSettings(stations=("CS002",), antennas=6, events_per_year=90)
    rough = Nuisances(missing=0.05, dead_antennas=1)
    spectra = simulate_campaign(settings, chain, sky, np.random.default_rng(5), nuisances=rough).spectra
    return fit_plain(gather_stations(spectra, chain, sky)[0]).evidence


def slow_product(covariance, absorbed, left, right):
    """left . C^-1 . right with the absorbed vectors projected out of both, by a dense covariance event by event.

    Vectors have shape (event, n), absorbed ones (vector, event, n), the covariance (event, n, n), infinite = absent.
    """
    inverse = np.zeros_like(covariance)
    for e, matrix in enumerate(covariance):
        if np.all(np.isfinite(matrix)):
            inverse[e] = np.linalg.inv(matrix)
    size = np.sqrt(np.einsum("ken,enm,kem->k", absorbed, inverse, absorbed, optimize=True))
    scaled = absorbed[size > 0] / size[size > 0, None, None]
    gram = np.einsum("ken,enm,lem->kl", scaled, inverse, scaled, optimize=True)
    of_left, of_right = (np.einsum("ken,enm,em->k", scaled, inverse, v, optimize=True) for v in (left, right))
    whole = np.einsum("en,enm,em->", left, inverse, right, optimize=True)
    return whole - of_left @ np.linalg.pinv(gram, rcond=1e-10, hermitian=True) @ of_right


def covariance_of(channel, band, channels):
    """Noise that is flat and noise that is not, of one path: shape (freq, freq)."""
    flat = np.ones((channels, channels)) / channels
    return channel**2 * (np.eye(channels) - flat) + band**2 * channels * flat


def absorbed_of(space):
    rows, events, channels = space.front.shape
    own = np.zeros((rows * channels, rows, events, channels))
    for r in range(rows):
        for f in range(channels):
            own[r * channels + f, r, :, f] = space.front[r, :, f]
    return np.concatenate([own, space.dense])


def test_scores_of_paths_equal_those_of_a_dense_covariance(evidence):
    data, levels = evidence.data, evidence.residuals.levels
    channels = data.power.shape[2]
    targets = [target for target in list_targets(data) if target.scope == "path"]
    score = next(s for s in scan(evidence, CAUSES, targets) if s.cause.identifier == "gain_step")
    values = signature(score.cause, evidence.terms, data.conditions, score.law)
    mean = evidence.mean_of(values, score.target.is_member)
    k = int(np.flatnonzero(score.target.is_member)[0])
    c = int(data.class_of[k])
    d = int(evidence.letter_of[c])
    own = covariance_of(levels.path_channel, levels.path_band, channels) * levels.path_scale[k] ** 2
    full = np.full((data.power.shape[1], channels, channels), np.inf)
    full[data.is_present[k]] = own
    absorbed = absorbed_of(evidence.path_spaces[c])[:, 0]
    observed = evidence.residuals.deviation[k]
    s = slow_product(full, absorbed, values[c], observed)
    f = slow_product(full, absorbed, values[c], values[c])
    members = evidence.members[c]
    typical = []
    for other in members:
        full = np.full((data.power.shape[1], channels, channels), np.inf)
        full[data.is_present[other]] = covariance_of(levels.path_channel, levels.path_band, channels)
        full *= levels.path_scale[other] ** 2
        typical.append(slow_product(full, absorbed, values[c], values[c]))
    f -= evidence.paths_of[d] * evidence.share_of_mean(score.target.is_member)[c] ** 2 * np.mean(typical)
    s_mean, f_mean = slow_mean(evidence, mean)
    np.testing.assert_allclose(score.z, (s + s_mean) / np.sqrt(f + f_mean), rtol=1e-6)


def slow_mean(evidence, mean):
    """Score and information of a vector of the mean, with a dense covariance."""
    levels, spread = evidence.residuals.levels, evidence.residuals.spread
    letters, events, channels = mean.shape
    covariance = np.empty((events, letters * channels, letters * channels))
    for e in range(events):
        joint = spread[:, e].mean() * levels.path_band**2
        plus, minus = levels.common_sum**2 + joint, levels.common_difference**2 + joint
        flat = np.ones((channels, channels)) / channels
        blocks = [[(plus + minus) / 2 if i == j else (plus - minus) / 2 for j in range(2)] for i in range(2)]
        matrix = np.block([[b * channels * flat for b in row] for row in blocks])
        for i in range(letters):
            at = slice(i * channels, (i + 1) * channels)
            own = levels.common_channel[i] ** 2 + levels.path_channel**2 * spread[i, e]
            matrix[at, at] += own * (np.eye(channels) - flat)
        covariance[e] = matrix

    def lay(values):
        return np.moveaxis(values, -3, -2).reshape(*values.shape[:-3], events, letters * channels)

    absorbed = lay(absorbed_of(evidence.mean_space))
    return tuple(slow_product(covariance, absorbed, lay(mean), lay(other)) for other in (evidence.residuals.mean, mean))


def test_scores_of_the_station_equal_those_of_a_dense_covariance(evidence):
    targets = [target for target in list_targets(evidence.data) if target.scope == "station"]
    found = scan(evidence, [cause for cause in CAUSES if cause.identifier in CHOSEN], targets)
    assert {score.cause.identifier for score in found} == set(CHOSEN)
    for score in found:
        values = signature(score.cause, evidence.terms, evidence.data.conditions, score.law)
        mean = evidence.mean_of(values, score.target.is_member)
        s, f = slow_mean(evidence, mean)
        np.testing.assert_allclose(np.sum(mean * evidence.mean_dual), s, rtol=1e-6)
        np.testing.assert_allclose(evidence.mean_information(mean[None])[0, 0], f, rtol=1e-6)
        # What the cables' classes say against each other comes on top; the scan leaves it out where it is little.
        own_score, own_information = evidence.products([values], [score.target])
        np.testing.assert_allclose(score.z, own_score[0] / np.sqrt(own_information[0, 0]), rtol=5e-3)


def test_what_the_fit_absorbs_has_no_information(evidence):
    gain = evidence.terms.front * (evidence.terms.sky + evidence.terms.n_lna) / evidence.terms.power()
    wave = np.cos(np.linspace(0, 9, gain.shape[2]))
    (target,) = [target for target in list_targets(evidence.data) if target.scope == "station"]
    _, information = evidence.products([gain * wave, gain], [target, target])
    _, of_step = evidence.products([gain * (np.arange(gain.shape[1]) > 40)[:, None]], [target])
    assert np.all(np.abs(information) < 1e-6 * of_step)


def test_a_path_outside_the_mean_shows_the_noise_of_both(station):
    rng = np.random.default_rng(6)
    excess = station.excess.copy()
    few = station.antenna < 3  # three of eight are in the mean: its noise is a third of theirs
    excess[(station.antenna >= 3), 200:] = np.inf
    damaged = replace(station, excess=excess)
    noise = 0.05 * rng.standard_normal(station.power.shape) * damaged.is_present[:, :, None]
    evidence = Evidence(damaged, split_residuals(damaged, noise), fit_baseline(station).terms, None)
    assert np.array_equal(evidence.residuals.in_mean, few)
    outside = evidence.residuals.deviation[~few, :200]
    np.testing.assert_allclose(np.std(outside), 0.05 * (4 / 3) ** 0.5, rtol=0.01)
    np.testing.assert_allclose(evidence.weight[~few, :200], 3 / 4, rtol=1e-9)
    levels = evidence.residuals.levels
    whitened = outside * np.sqrt(evidence.weight[~few, :200, None]) / levels.path_channel
    # 0.2 % from 10 paths, the median of 6 levels, and the two numbers that a fit would have taken from each path.
    assert abs(np.std(whitened) - 1.0) < 0.02


def test_a_path_that_is_silent_from_a_date_on_shows_no_step_after_it(station):
    excess = station.excess.copy()
    dead = station.antenna == 2
    excess[dead, 292:] = np.inf
    damaged = replace(station, excess=excess)
    plain = fit_plain(damaged)
    assert np.all(plain.residuals.in_mean), "it died too late to leave the mean"
    (cause,) = (one for one in CAUSES if one.identifier == "gain_step")
    law = cause.finer_laws(damaged.conditions, Law({"date_unix": float(np.sort(damaged.conditions.time_unix)[292])}))
    targets = [target for target in list_targets(damaged) if target.label == "antenna 2"]
    times = np.sort(damaged.conditions.time_unix)
    silent = [one for one in law if one.parameters["date_unix"] >= times[292]]
    for _, z, size in score_shapes(plain.evidence, group_laws(damaged.conditions, cause, silent), targets):
        assert np.all(z == 0)
        assert np.all(size == 0)


def test_chi_squared_of_noise_is_its_degrees_of_freedom(evidence):
    chi2, dof = evidence.chi_squared()
    assert abs(chi2 / dof - 1) < 0.05  # the levels come from the same data


def test_products_of_functions_equal_those_of_the_vectors_they_make(evidence):
    rng = np.random.default_rng(4)
    space = evidence.mean_space
    rows, events, channels = space.front.shape
    courses, smooth = rng.standard_normal((3, events)), rng.standard_normal((2, channels))
    signs, weight = np.array([[1.0, 1.0], [1.0, -1.0]]), rng.uniform(0, 1, events)
    vectors = np.einsum("he,lf,sr->shlref", courses, smooth, signs).reshape(-1, rows, events, channels)
    weighed = space.weigh(vectors) * weight[:, None]
    absorbed, gram = space.products_of(courses, smooth, signs, weight)
    np.testing.assert_allclose(absorbed, space.absorbed_of(weighed).sum(axis=-2), rtol=1e-8, atol=1e-6)
    np.testing.assert_allclose(gram, np.einsum("aref,bref->ab", vectors, weighed), rtol=1e-8, atol=1e-6)


@pytest.mark.parametrize("scope", ["station", "cable", "antenna"])
def test_events_add_up_to_the_score_and_the_information_of_the_whole(evidence, scope):
    plain = Extension([], fit_baseline(evidence.data), evidence, is_converged=True)
    drift = next(cause for cause in CAUSES if cause.identifier == "gain_drift")
    target = next(target for target in list_targets(evidence.data) if target.scope == scope)
    score, information = by_event(plain, Effect(drift, Law(), target, 0.0))
    values = signature(drift, evidence.terms, evidence.data.conditions, Law())
    whole, square = evidence.products([values], [target])
    np.testing.assert_allclose(score.sum(), whole[0], rtol=1e-6, atol=1e-6 * square[0, 0] ** 0.5)
    np.testing.assert_allclose(information.sum(), square[0, 0], rtol=1e-6)
