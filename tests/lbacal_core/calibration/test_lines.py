from __future__ import annotations

import numpy as np

from lbacal_core.calibration.lines import estimate_noise_levels, fit_lines
from lbacal_core.grids import Floats


def slow_lines(power: Floats, sky: Floats, model: Floats, covariances: list[Floats]) -> tuple[Floats, Floats]:
    """Generalised least squares for (s, b) of every channel with each event's full covariance written out."""
    channels = sky.shape[1]
    information = np.zeros((2 * channels, 2 * channels))
    target = np.zeros(2 * channels)
    for event in range(len(power)):
        design = np.hstack([np.diag(sky[event]), np.eye(channels)])
        covariance = model[event][:, None] * covariances[event] * model[event][None, :]
        weighted = np.linalg.solve(covariance, design)
        information += design.T @ weighted
        target += weighted.T @ power[event]
    return np.linalg.solve(information, target), information


def seeds_of(sky: Floats, slope: Floats, intercept: Floats) -> tuple[Floats, Floats]:
    """What is added behind the gains that fluctuate, and the forms of a gain behind and in front of it."""
    power = slope * sky.mean(axis=0) + intercept
    columns = np.stack([slope, np.ones_like(slope)], axis=1) / power[:, None]
    added = np.linalg.lstsq(columns, intercept / power, rcond=None)[0][1]
    behind = np.clip(np.full_like(slope, added), 0.0, power)
    return behind, np.stack([np.ones_like(slope), 1.0 - behind / power])


def shared_at(vectors: Floats, seeds: Floats, behind: Floats, model: Floats) -> Floats:
    """What an event of a power shares, from what one of the mean power does: a gain in front acts on what is there."""
    size = np.linalg.norm(seeds, axis=1, keepdims=True)
    ridge = np.vstack([(seeds / size).T, 1e-2 * np.eye(2)])
    amount = np.linalg.lstsq(ridge, np.vstack([vectors.T, np.zeros((2, len(vectors)))]), rcond=None)[0] / size
    return vectors + amount[1][:, None] * ((1.0 - behind / model) - seeds[1])


def test_lines_and_information_equal_the_dense_generalised_least_squares(scene):
    _, sky, power = scene.draw(np.random.default_rng(3), paths=2, events=200)
    relative_variance = np.ones(power.shape[:2])
    relative_variance[0, ::3] = 2.0
    relative_variance[1, :7] = np.inf
    lines = fit_lines(power, sky, relative_variance)
    channels = sky.shape[1]
    for path in range(2):
        kept = np.isfinite(relative_variance[path])
        # the weights come from unweighted lines: the oracle draws its own
        slope, intercept = np.stack(
            [np.polyfit(x, y, 1) for x, y in zip(sky[kept].T, power[path][kept].T, strict=True)], axis=1
        )
        model = slope * sky + intercept
        behind, seeds = seeds_of(sky, slope, intercept)
        of_path = slice(path, path + 1)
        padded = np.vstack([seeds, np.zeros(channels)])[None]
        residual = (power[path] / model - 1.0)[None]
        levels = estimate_noise_levels(residual, relative_variance[of_path], 2, padded)
        model = model[kept]
        vectors = [shared_at(levels.vectors[0], seeds, behind, at) for at in model]
        diagonal = np.diag(levels.radiometer[0] ** 2)
        covariances = [k * diagonal + v.T @ v for k, v in zip(relative_variance[path][kept], vectors, strict=True)]
        expected, information = slow_lines(power[path][kept], sky[kept], model, covariances)
        np.testing.assert_allclose(lines.slope[path], expected[:channels], rtol=1e-9)
        np.testing.assert_allclose(lines.intercept[path], expected[channels:], rtol=1e-8)
        scale = np.sqrt(np.diag(information))
        np.testing.assert_allclose(
            lines.information[path] / np.outer(scale, scale), information / np.outer(scale, scale), atol=1e-9
        )


def test_noise_levels_are_those_of_the_simulation(scene):
    _, sky, power = scene.draw(np.random.default_rng(4), paths=24, events=800)
    levels = fit_lines(power, sky, np.ones(power.shape[:2])).levels
    # 24 x 800 x 26 radiometer draws: 0.1 %; the common 2 % is the same 800 draws for all paths: 2.5 %
    np.testing.assert_allclose(np.mean(levels.radiometer), 0.045, rtol=0.005)
    np.testing.assert_allclose(np.mean(levels.event_gain), np.hypot(0.03, 0.02), rtol=0.05)


def test_spectra_of_fewer_blocks_are_noisier_and_levels_refer_to_the_typical(scene):
    rng = np.random.default_rng(5)
    _, sky, _ = scene.draw(rng, paths=1, events=600)
    relative_variance = np.where(np.arange(600) % 2, 4.0, 1.0)[None, :].repeat(12, 0)
    power = scene.mean_power(sky) * (
        1 + 0.02 * np.sqrt(relative_variance)[:, :, None] * rng.standard_normal((12, 600, 26))
    )
    levels = fit_lines(power, sky, relative_variance).levels
    np.testing.assert_allclose(np.mean(levels.radiometer), 0.02, rtol=0.01)
    assert np.all(levels.event_gain < 0.003)


def test_a_path_does_not_depend_on_those_fitted_beside_it(scene):
    _, sky, power = scene.draw(np.random.default_rng(6), paths=6, events=150)
    together = fit_lines(power, sky, np.ones(power.shape[:2]))
    alone = fit_lines(power[3:4], sky, np.ones((1, 150)))
    np.testing.assert_allclose(together.slope[3], alone.slope[0], rtol=1e-12)


def test_absent_spectra_count_for_nothing_whatever_stands_in_their_place(scene):
    _, sky, power = scene.draw(np.random.default_rng(7), paths=1, events=200)
    relative_variance = np.ones((1, 200))
    relative_variance[0, 150:] = np.inf
    spoiled = power.copy()
    spoiled[0, 150:] = 1e6
    np.testing.assert_allclose(
        fit_lines(spoiled, sky, relative_variance).slope, fit_lines(power, sky, relative_variance).slope, rtol=1e-12
    )
