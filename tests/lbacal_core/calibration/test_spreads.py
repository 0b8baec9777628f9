from __future__ import annotations

import numpy as np
import pytest

from lbacal_core.calibration.spreads import SinglePaths, fit_random_effect, join_paths, measure_spreads

CHANNELS = 5
LOSS = {"50": np.linspace(0.5, 0.4, CHANNELS), "80": np.linspace(0.3, 0.2, CHANNELS)}


def draw_paths(rng, *, paths=400, spread=0.05, noise=0.03, offset=0.0, stations=("CS002",), between=0.0):
    """Paths alternating between two cables; those with 80 m gain `offset` more power."""
    cables = np.where(np.arange(paths) % 2 == 0, "50", "80")
    names = np.array(stations)[np.arange(paths) // 2 % len(stations)]
    of_station = dict(zip(stations, between * rng.standard_normal(len(stations)), strict=True))
    loss = np.array([LOSS[cable] for cable in cables])
    departure = spread * rng.standard_normal((paths, 1)) + offset * (cables == "80")[:, None]
    departure = departure + np.array([of_station[name] for name in names])[:, None]
    sigma = noise * loss
    slope = loss * (1 + departure) + sigma * rng.standard_normal(loss.shape)
    return SinglePaths(names, cables, slope, sigma, loss)


def measure(paths):
    mean_loss = paths.loss.mean(axis=0)
    return measure_spreads(paths, mean_loss, mean_loss)


def test_offset_and_spread_by_cable_are_those_planted_and_noise_is_not_counted() -> None:
    # 200 paths a cable: the spread is known to 5 % and a little more because of the noise
    found = measure(draw_paths(np.random.default_rng(1), offset=0.1, noise=0.05))
    assert set(found.by_cable) == {"50", "80"}
    for cable, offset in (("50", 0.0), ("80", 0.1)):
        assert found.by_cable[cable].paths == 200
        np.testing.assert_allclose(found.by_cable[cable].offset, offset, atol=0.02)
        np.testing.assert_allclose(found.by_cable[cable].spread, 0.05, rtol=0.3)
    np.testing.assert_allclose(found.all_paths.spread, np.hypot(0.05, 0.05), rtol=0.2)


def test_a_channel_without_sight_of_the_spread_has_that_of_the_band() -> None:
    paths = draw_paths(np.random.default_rng(2))
    sigma = paths.sigma.copy()
    sigma[:, -1] *= 100.0
    blind = SinglePaths(paths.stations, paths.cables, paths.slope, sigma, paths.loss)
    found = measure(blind).all_paths.spread
    assert found[-1] == pytest.approx(found[0], rel=0.3)
    assert np.all(found > 0.03)


def test_two_paths_say_nothing_and_a_cable_with_two_has_the_spread_of_all() -> None:
    rng = np.random.default_rng(3)
    assert measure(draw_paths(rng, paths=2)) is None
    few = measure(draw_paths(rng, paths=4))
    assert few.by_cable == {}
    assert few.all_paths.paths == 4


def test_a_channel_that_was_not_determined_counts_for_nothing() -> None:
    paths = draw_paths(np.random.default_rng(4))
    slope = paths.slope.copy()
    slope[::4] = np.nan
    found = measure(SinglePaths(paths.stations, paths.cables, slope, paths.sigma, paths.loss)).all_paths
    np.testing.assert_allclose(found.spread, 0.05, rtol=0.3)


def test_stations_that_differ_are_seen_to_differ() -> None:
    names = tuple(f"CS{k:03d}" for k in range(40))
    alike = measure(draw_paths(np.random.default_rng(5), stations=names, paths=1600))
    unlike = measure(draw_paths(np.random.default_rng(5), stations=names, paths=1600, between=0.06))
    assert (alike.stations, unlike.stations) == (40, 40)
    # 40 stations know their spread to 11 %
    np.testing.assert_allclose(unlike.between_stations, 0.06, rtol=0.35)
    assert np.all(alike.between_stations < 0.01)
    assert measure(draw_paths(np.random.default_rng(5))).between_stations is None


def test_stations_of_few_paths_that_are_alike_do_not_seem_to_differ() -> None:
    """The mean of four paths is off by 3 % by the spread of single paths alone."""
    names = tuple(f"CS{k:03d}" for k in range(100))
    alike = measure(draw_paths(np.random.default_rng(8), stations=names, paths=400))
    # 100 stations leave 1 % of it.
    assert np.all(alike.between_stations < 0.02)


def test_joined_fits_are_one() -> None:
    rng = np.random.default_rng(6)
    first, second = draw_paths(rng, paths=10), draw_paths(rng, paths=6)
    joined = join_paths([first, second])
    assert (joined.slope.shape, joined.cables[10], joined.stations.size) == ((16, CHANNELS), "50", 16)


@pytest.mark.parametrize("noise", [0.0001, 0.05, 1.0])
def test_a_random_effect_solves_its_equation(noise: float) -> None:
    rng = np.random.default_rng(7)
    sigma = noise * rng.uniform(0.5, 2.0, (12, 3))
    values = 0.05 * rng.standard_normal((12, 3)) + sigma * rng.standard_normal((12, 3))
    found = fit_random_effect(values, sigma)
    left = np.sum((values - found.mean) ** 2 / (found.variance + sigma**2), axis=0)
    assert np.all((np.abs(left - 11) < 1e-6) | ((found.variance == 0) & (left < 11)))
