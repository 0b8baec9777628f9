from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.causes.catalogue import CAUSES
from lbacal_core.causes.cause import Template, signature, spectral_signature
from lbacal_core.causes.grammar import Sentence, sentence
from lbacal_core.discovery.baseline import fit_baseline
from lbacal_core.discovery.hypothesis import Hypothesis, list_targets
from lbacal_core.discovery.noise import split_residuals
from lbacal_core.discovery.project import LinearModel
from lbacal_core.discovery.refit import act_together, fit_chain, held_out_fold
from lbacal_core.discovery.scan import group_templates, scan, score_families
from lbacal_core.discovery.station import gather_stations, model_modes
from lbacal_core.sky.differences import DifferenceModels, compute_model_differences
from lbacal_twin.campaign import simulate_campaign
from lbacal_twin.nuisances import Nuisances
from lbacal_twin.settings import TwinSettings

NU = np.arange(30.0, 81.0)
CHOSEN = ("gain_step", "lst_offset", "rfi_line", "gain_temperature", "cable_temperature")


@pytest.fixture(scope="module")
def model(chain, sky, simulation):
    """A small station with gaps and a dead antenna."""
    settings = TwinSettings(stations=("CS002",), antennas=6, events_per_year=90)
    rough = Nuisances(missing=0.05, dead_antennas=1)
    spectra = simulate_campaign(settings, chain, sky, np.random.default_rng(5), nuisances=rough).spectra
    return fit_chain(gather_stations(spectra, simulation)[0]).linear


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


def covariance_of(levels, c):
    """Noise of one path of a class, shape (freq, freq)."""
    return (
        levels.path_channel**2 * np.eye(levels.vectors.shape[1])
        + levels.vectors.T @ levels.path_shared[0, c] @ levels.vectors
    )


def free_vectors_of(view):
    rows, events, channels = view.slope.shape
    own = np.zeros((rows * channels, rows, events, channels))
    for r in range(rows):
        for f in range(channels):
            own[r * channels + f, r, :, f] = view.slope[r, :, f]
    return np.concatenate([own, view.constants])


def test_inner_products_beside_a_free_sky_equal_those_of_all_its_vectors_written_out(chain, model):
    """Waves along LST are kept as profiles and spectra; here every one is a vector of its own, with its prior."""
    modes = model_modes(model.station, compute_model_differences(chain, DifferenceModels(("lfsm",), ("inverted-v",))))
    view = replace(model, modes=modes).common
    share = replace(model, modes=modes)._seen_in_mean(np.ones((1, 1, 1, 1)))[0].mean(axis=1)
    waves = [modes.waves[0].changes[:, None] * share[:, None]]
    waves += [modes.waves[1].changes[:, None] * (share * (np.arange(2) == d)[:, None])[:, None] for d in (0, 1)]
    absorbed = np.concatenate([free_vectors_of(view), *waves])
    prior = np.zeros(len(absorbed))
    prior[2 * NU.size : 2 * NU.size + len(view.prior)] = view.prior
    prior[-sum(map(len, waves)) :] = 1.0
    templates = np.random.default_rng(2).standard_normal((2, *view.slope.shape))
    weighed = view.see(templates).weighed
    along = np.einsum("vref,kref->kv", absorbed, weighed, optimize=True)
    gram = np.einsum("vref,wref->vw", absorbed, view.see(absorbed).weighed, optimize=True) + np.diag(prior)
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    inverse = np.linalg.pinv(gram / np.outer(size, size), rcond=1e-10, hermitian=True) / np.outer(size, size)
    slow = np.einsum("kref,jref->kj", templates, weighed, optimize=True) - along @ inverse @ along.T
    np.testing.assert_allclose(view.gram(view.see(templates))[0], slow, rtol=1e-6, atol=1e-6 * slow[0, 0])
    left = templates - np.tensordot(along @ inverse, absorbed, axes=1)
    np.testing.assert_allclose(view.clean(templates), left, atol=1e-6)


def test_scores_of_paths_equal_those_of_a_dense_covariance(model):
    data, levels = model.station, model.residuals.levels
    channels = data.power.shape[2]
    targets = [target for target in list_targets(data) if target.scope == "path"]
    score = next(s for s in scan(model, CAUSES, targets) if s.cause.identifier == "gain_step")
    values = signature(score.cause, model.terms, data.conditions, score.template)
    mean = model.mean_of(values, score.target.is_member)
    k = int(np.flatnonzero(score.target.is_member)[0])
    c = int(data.class_of[k])
    d = int(model.polarisation_of[c])
    own = covariance_of(levels, c) * levels.path_scale[k] ** 2
    full = np.full((data.power.shape[1], channels, channels), np.inf)
    full[data.is_present[k]] = own
    absorbed = free_vectors_of(model.paths[c])[:, 0]
    observed = model.residuals.deviation[k]
    s = slow_product(full, absorbed, values[c], observed)
    f = slow_product(full, absorbed, values[c], values[c])
    f *= 1.0 - model.paths_in_mean[d] * model.share_of_mean(score.target.is_member)[c] ** 2  # what the mean takes
    s_mean, f_mean = slow_mean(model, mean)
    np.testing.assert_allclose(score.z, (s + s_mean) / np.sqrt(f + f_mean), rtol=1e-6)


def slow_mean(model, mean):
    """Score and information of a vector of the mean, with a dense covariance."""
    levels, spread = model.residuals.levels, model.residuals.spread
    letters, events, channels = mean.shape
    covariance = np.empty((events, letters * channels, letters * channels))
    for e in range(events):
        vectors = levels.vectors
        common = np.mean(levels.common_channel**2) + levels.path_channel**2 * spread[:, e].mean()
        joint = spread[:, e].mean() * levels.mean_path_shared[0] + common * np.eye(len(vectors))
        plus, minus = levels.common_sum[0] + joint, levels.common_difference[0] + joint
        blocks = [[(plus + minus) / 2 if i == j else (plus - minus) / 2 for j in range(2)] for i in range(2)]
        matrix = np.block([[vectors.T @ b @ vectors for b in row] for row in blocks])
        for i in range(letters):
            at = slice(i * channels, (i + 1) * channels)
            own = levels.common_channel[i] ** 2 + levels.path_channel**2 * spread[i, e]
            matrix[at, at] += own * (np.eye(channels) - vectors.T @ vectors)
        covariance[e] = matrix

    def lay(values):
        return np.moveaxis(values, -3, -2).reshape(*values.shape[:-3], events, letters * channels)

    absorbed = lay(free_vectors_of(model.common))
    return tuple(slow_product(covariance, absorbed, lay(mean), lay(other)) for other in (model.residuals.mean, mean))


def test_scores_of_the_station_equal_those_of_a_dense_covariance(model):
    targets = [target for target in list_targets(model.station) if target.scope == "station"]
    found = scan(model, [cause for cause in CAUSES if cause.identifier in CHOSEN], targets)
    assert {score.cause.identifier for score in found} == set(CHOSEN)
    for score in found:
        values = signature(score.cause, model.terms, model.station.conditions, score.template)
        mean = model.mean_of(values, score.target.is_member)
        s, f = slow_mean(model, mean)
        np.testing.assert_allclose(np.sum(mean * model.common.weighted_residual[0]), s, rtol=1e-6)
        np.testing.assert_allclose(model.common.gram(model.common.see(mean[None]))[0, 0, 0], f, rtol=1e-6)
        # What the cables' classes say against each other comes on top; the scan leaves it out where it is little.
        own_score, own_information = model.products([values], [score.target])
        np.testing.assert_allclose(score.z, own_score[0] / np.sqrt(own_information[0, 0]), rtol=5e-3)


def test_what_the_fit_leaves_free_has_no_information(model):
    gain = model.terms.front * (model.terms.sky + model.terms.n_lna) / model.terms.power()
    wave = np.cos(np.linspace(0, 9, gain.shape[2]))
    (target,) = [target for target in list_targets(model.station) if target.scope == "station"]
    _, information = model.products([gain * wave, gain], [target, target])
    _, of_step = model.products([gain * (np.arange(gain.shape[1]) > 40)[:, None]], [target])
    assert np.all(np.abs(information) < 1e-6 * of_step)


def test_a_path_outside_the_mean_shows_the_noise_of_both(station):
    rng = np.random.default_rng(6)
    variance = station.relative_variance.copy()
    few = station.antenna < 3  # three of eight are in the mean: its noise is a third of theirs
    variance[(station.antenna >= 3), 200:] = np.inf
    damaged = replace(station, relative_variance=variance)
    noise = 0.05 * rng.standard_normal(station.power.shape) * damaged.is_present[:, :, None]
    model = LinearModel(damaged, split_residuals(damaged, noise, np.ones((1, 51))), fit_baseline(station).terms, None)
    assert np.array_equal(model.residuals.in_mean, few)
    outside = model.residuals.deviation[~few, :200]
    np.testing.assert_allclose(np.std(outside), 0.05 * (4 / 3) ** 0.5, rtol=0.01)
    np.testing.assert_allclose(model.weight[~few, :200], 3 / 4, rtol=1e-9)
    levels = model.residuals.levels
    whitened = outside * np.sqrt(model.weight[~few, :200, None]) / levels.path_channel
    # 0.2 % from 10 paths, the median of 6 levels, and the two numbers that a fit would have taken from each path.
    assert abs(np.std(whitened) - 1.0) < 0.02


def test_a_path_that_is_silent_from_a_date_on_shows_no_step_after_it(station):
    variance = station.relative_variance.copy()
    dead = station.antenna == 2
    variance[dead, 292:] = np.inf
    damaged = replace(station, relative_variance=variance)
    plain = fit_chain(damaged)
    assert np.all(plain.linear.residuals.in_mean), "it died too late to leave the mean"
    (cause,) = (one for one in CAUSES if one.identifier == "gain_step")
    times = np.sort(damaged.conditions.time_unix)
    found = cause.finer_templates(damaged.conditions, Template({"date_unix": float(times[292])}))
    targets = [target for target in list_targets(damaged) if target.label == "antenna 2"]
    silent = [one for one in found if one.parameters["date_unix"] >= times[292]]
    for _, z, size in score_families(plain.linear, group_templates(damaged.conditions, cause, silent), targets):
        assert np.all(z == 0)
        assert np.all(size == 0)


def test_inner_products_of_profiles_equal_those_of_the_vectors_they_make(model):
    rng = np.random.default_rng(4)
    view = model.common
    profiles = rng.standard_normal((3, view.slope.shape[1]))
    templates = rng.standard_normal((2, *view.slope.shape))
    vectors = np.einsum("ne,kref->knref", profiles, templates).reshape(-1, *view.slope.shape)
    seen = view.see(templates)
    direct = view.gram(view.see(vectors))
    np.testing.assert_allclose(view.products([seen], [profiles]), direct, rtol=1e-6, atol=1e-6 * direct.max())
    families = [view.see(templates[:1]), view.see(templates[1:])], [profiles, profiles]
    np.testing.assert_allclose(view.products(*families), direct, rtol=1e-6, atol=1e-6 * direct.max())
    left, whole = view.inner(view.see(templates[:, None]), profiles)
    np.testing.assert_allclose(left[:, 0, 0, 0].ravel(), np.diag(direct[0]), rtol=1e-6)
    assert np.all(left < whole)


@pytest.mark.parametrize("scope", ["station", "cable", "antenna", "path"])
def test_folds_add_up_to_the_score_and_the_information_of_the_whole(model, scope):
    conditions = model.station.conditions
    causes = {cause.identifier: cause for cause in CAUSES}
    target = next(target for target in list_targets(model.station) if target.scope == scope)
    fold = held_out_fold(model.station)
    for name in ("gain_drift", "gain_step"):
        cause = causes[name]
        chosen = cause.templates(conditions)[::20]
        profiles = np.stack([cause.time_profile(conditions, one)[:, 0] for one in chosen])
        spectral = spectral_signature(cause, model.terms, conditions, chosen[0])
        score, information, whole = model.by_fold(spectral, profiles, target, fold)
        for k, one in enumerate(chosen):
            product, square = model.products([signature(cause, model.terms, conditions, one)], [target])
            scale = square[0, 0] ** 0.5
            assert whole[:, k].sum() > square[0, 0]
            np.testing.assert_allclose(score[:, k].sum(), product[0], rtol=1e-6, atol=1e-6 * scale)
            np.testing.assert_allclose(information[:, k].sum(), square[0, 0], rtol=1e-6)


def test_the_information_of_a_fold_is_that_of_its_events_of_the_cleaned_template(model):
    rng = np.random.default_rng(8)
    view, fold = model.common, held_out_fold(model.station)
    template = rng.standard_normal((1, *view.slope.shape))
    clean = view.clean(template)
    weighed = view.see(clean).weighed
    information, whole, fitted = view.inner_by_fold(view.see(template), np.ones((1, fold.size)), fold, 0)
    score = view.score_by_fold(view.see(template), np.ones((1, fold.size)), fold, 0, fitted)
    for k in range(fold.max() + 1):
        own = np.sum((clean * weighed)[0][:, fold == k])
        np.testing.assert_allclose(information[k, 0, 0], own, rtol=1e-6)
        assert information[k, 0, 0] < whole[k, 0]
        own = np.sum((clean[0] * view.weighted_residual[0])[:, fold == k])
        np.testing.assert_allclose(score[k, 0], own, rtol=1e-6, atol=1e-6)


def test_events_that_are_left_out_count_for_nothing(model):
    """A model on some events is that of a station which never recorded the others."""
    station = model.station
    is_known = np.arange(station.power.shape[1]) % 7 != 3
    some = model.on_events(is_known)
    assert not np.any(some.weight[:, ~is_known])
    spoilt = replace(model.residuals, mean=model.residuals.mean + 5.0 * ~is_known[:, None])
    again = replace(model, residuals=spoilt).on_events(is_known)
    drift = next(cause for cause in CAUSES if cause.identifier == "gain_drift")
    values = signature(drift, model.terms, station.conditions, Template())
    target = list_targets(station)[-1]
    for one, other in zip(some.products([values], [target]), again.products([values], [target]), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9)
    assert model.on_events(np.ones_like(is_known)) is model


def test_what_moves_the_share_of_the_sky_in_most_paths_keeps_information(chain, sky, simulation):
    """Noise that grew behind five cables of six had less than none: the deviations lost more than they have."""
    settings = TwinSettings(stations=("CS002",), antennas=12, events_per_year=90)
    spectra = simulate_campaign(settings, chain, sky, np.random.default_rng(5)).spectra
    whole = gather_stations(spectra, simulation)[0]
    cables = np.array(whole.conditions.cables)[whole.class_of]
    one, other = np.unique(cables)[:2]
    kept = [*np.unique(whole.antenna[cables == one]), whole.antenna[cables == other][0]]
    station = gather_stations(spectra.select(np.flatnonzero(np.isin(spectra.antenna, kept))), simulation)[0]
    target = next(target for target in list_targets(station) if target.label == f"cable {one}")
    modes = model_modes(station, compute_model_differences(chain, DifferenceModels(("lfsm",), ("inverted-v",))))
    fitted = fit_chain(station, modes)
    grows = sentence("antenna", ("flat",), ("ramp", "2014-07-01T00:00:00Z"))
    hypothesis = Hypothesis(Sentence(), grows, target, 0.2)
    model = replace(fitted.linear, terms=act_together(station, fitted.baseline.terms, [hypothesis]))
    template = signature(Sentence(), fitted.baseline.terms, station.conditions, grows, 0.2)
    _, information = model.products([template], [target])
    assert information.item() > 0.0
