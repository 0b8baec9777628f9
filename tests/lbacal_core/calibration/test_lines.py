from dataclasses import replace

import numpy as np
import pytest

from lbacal_core.calibration.lines import PathLines, fit_lines, is_disturbed, move_lines, move_lines_by
from lbacal_core.calibration.paths import paths_of_scope, radiometer_limit, require_one_cable_each
from lbacal_core.calibration.singles import chain_forms
from lbacal_core.grids import Floats
from lbacal_core.simulation.prior import SKY_HARMONICS, SkyPrior
from lbacal_core.sky.table import harmonics_at


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


def slow_levels(residual: Floats, relative_variance: Floats, seeds: Floats) -> tuple[Floats, Floats]:
    """Radiometer noise of a path and what its events share within the forms of a gain: estimated by turns, from its
    residuals in the events that are there.
    """
    events, channels = residual.shape
    covariance = sum(np.outer(one, one) / k for one, k in zip(residual, relative_variance, strict=True)) / (events - 2)
    variance = np.diag(covariance)
    for _ in range(3):
        sigma = np.sqrt(variance)
        white = covariance / np.outer(sigma, sigma)
        basis = np.linalg.svd((seeds / sigma).T, full_matrices=False)[0]
        outside = np.eye(channels) - basis @ basis.T
        variance = variance * np.diag(outside @ white @ outside) / np.diag(outside)
    values, turned = np.linalg.eigh(basis.T @ white @ basis - np.eye(2))
    size = np.sqrt(np.where(values > 4.0 * np.sqrt(2.0 / events), values, 0.0) / np.mean(1.0 / relative_variance))
    return sigma, (basis @ turned).T * size[:, None] * sigma


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
        model = model[kept]
        own = relative_variance[path][kept]
        radiometer, shared = slow_levels(power[path][kept] / model - 1.0, own, seeds)
        vectors = [shared_at(shared, seeds, behind, at) for at in model]
        covariances = [k * np.diag(radiometer**2) + v.T @ v for k, v in zip(own, vectors, strict=True)]
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
    shared = np.sqrt(np.sum(levels.vectors**2, axis=1).mean(axis=-1))
    np.testing.assert_allclose(np.mean(shared), np.hypot(0.03, 0.02), rtol=0.05)


def test_spectra_of_fewer_blocks_are_noisier_and_levels_refer_to_the_typical(scene):
    rng = np.random.default_rng(5)
    _, sky, _ = scene.draw(rng, paths=1, events=600)
    relative_variance = np.where(np.arange(600) % 2, 4.0, 1.0)[None, :].repeat(12, 0)
    power = scene.mean_power(sky) * (
        1 + 0.02 * np.sqrt(relative_variance)[:, :, None] * rng.standard_normal((12, 600, 26))
    )
    levels = fit_lines(power, sky, relative_variance).levels
    np.testing.assert_allclose(np.mean(levels.radiometer), 0.02, rtol=0.01)
    assert np.all(np.sum(levels.vectors**2, axis=1).mean(axis=-1) < 0.003**2)


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
    series = SkyPrior({"X": change[None]}, "").series("X")
    basis = harmonics_at(lst, SKY_HARMONICS)
    path = PathLines.of(power[0], sky, variance[0], lines.select(np.array([0])))
    moved = move_lines(path, path.slope, basis, series)[0]
    added = lines.slope[:, None] * sky * (basis @ series[0])
    up, down = (fit_lines(power + sign * added, sky, variance, forms) for sign in (1.0, -1.0))
    refitted = np.concatenate([up.slope - down.slope, up.intercept - down.intercept], axis=1)[0] / 2.0
    scale = np.repeat([np.max(np.abs(half)) for half in np.split(refitted, 2)], sky.shape[1])
    # weights follow the lines that are fitted first, which the change moves too
    assert moved / scale == pytest.approx(refitted / scale, abs=0.05)
    by_event = move_lines_by(path, (added / lines.power(sky))[:1])[0]
    assert by_event / scale == pytest.approx(moved / scale, abs=1e-9)


def test_an_event_that_one_antenna_of_four_recorded_has_the_noise_of_its_power_and_not_of_four(scene, spectra):
    one_station = spectra.select((spectra.station == "CS002") & (spectra.dipole == "X"))
    is_lonely = np.isin(one_station.event_id, np.unique(one_station.event_id)[::4])
    some = one_station.select(~is_lonely | (one_station.antenna == 0))
    cables = require_one_cable_each(some, scene.instrument)
    (read,) = paths_of_scope(some, scene.simulation, "station", cables)
    mean = read()
    level = np.array([np.mean(one_station.power[one_station.antenna == antenna]) for antenna in range(4)])
    # of equal cables it would be 4; 1 % because the level is that of noisy spectra
    assert mean.relative_variance[0, 0::4] == pytest.approx(level.sum() ** 2 / np.sum(level**2), rel=0.01)
    assert np.delete(mean.relative_variance[0], np.s_[0::4]) == pytest.approx(1.0)


def test_radiometer_noise_is_that_of_the_samples_of_a_channel(spectra):
    # 100 blocks of 1024 samples at 160 MHz or faster are 640 microseconds or less: 1280 samples of 2 MHz
    assert radiometer_limit(spectra) == pytest.approx(1280**-0.5)
    known = replace(spectra, duration_s=np.full(len(spectra), 0.0005))
    assert radiometer_limit(known) == pytest.approx(1000**-0.5)


def test_a_mean_knows_the_scatter_of_the_single_spectra(scene, spectra):
    cables = require_one_cable_each(spectra, scene.instrument)
    for read in paths_of_scope(spectra, scene.simulation, "station", cables):
        paths = read()
        assert paths.scatter == pytest.approx(0.045, rel=0.03)
        assert paths.smallest_scatter == pytest.approx(1280**-0.5)


@pytest.mark.parametrize(
    ("scatter", "power", "slope", "expected"),
    [
        (1.6, 1.0, 1.0, True),
        (1.0, 4.0, 1.0, True),
        (1.0, 4.0, 4.0, False),
        (1.0, 1.0, 0.2, False),
        (1.0, 4.0, -0.1, True),
    ],
    ids=["comes and goes", "carrier", "resonance", "filter", "carrier without a slope"],
)
def test_a_channel_is_disturbed_by_its_scatter_or_by_power_that_its_slope_has_not(scatter, power, slope, expected):
    channel = np.arange(12) == 6
    levels = (np.where(channel, value, 1.0)[None] for value in (scatter, power, slope))
    assert np.flatnonzero(is_disturbed(*levels)).tolist() == [6] * expected
